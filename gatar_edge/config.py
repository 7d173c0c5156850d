"""Parameters of the robot runtime: frozen and strict, unknown fields are errors that name their path."""

from __future__ import annotations

import hashlib

import msgspec

from gatar_edge.types import GridSpec


class AgentConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What all robots of a team must agree on, so that each can rebuild what the others know."""

    grid: GridSpec = msgspec.field(default_factory=GridSpec)
    r_sense: float = 4.0  # cells
    r_comm: float = 6.0  # cells; robots nearer than this are neighbours in the graph
    hop_limit: int = 2  # K: how often a message is passed on, and the levels of the graph
    max_age_s: float = 3.0  # a neighbour not heard for this long leaves the graph
    perception_max_age_s: float = 3.0  # an own observation older than this stops the robot
    # The paper's two stages: a task is not reconsidered before it ends. Following the allocator at every tick instead
    # saves 2 to 4 % of the steps of ideal vehicles (`gatar eval missions --follow`); with vehicles that must brake and
    # turn round it saves none and doubles the retasks. A steady allocator (the field model) weighs what robots do
    # itself and is followed either way: there the setting has no effect, but where the fallback decides.
    keep_task: bool = True
    max_neighbors: int = 63
    max_candidates: int = 64

    def digest(self) -> int:
        """32 bits that travel in each message: robots of another configuration are not listened to."""
        return int.from_bytes(hashlib.blake2b(msgspec.json.encode(self), digest_size=4).digest(), "big")
