"""The team as a listener hears it: who, where, what for, how old, how far, and how much is lost. Sends nothing."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import msgspec

from gatar_edge.errors import MessageError
from gatar_edge.message import NeighborMessage, open_envelope, unpack
from gatar_edge.types import NS_PER_S

MAX_ROBOTS = 1024
WINDOW = 50  # messages over which loss and rate are taken


class TeamRow(msgspec.Struct, frozen=True):
    """One robot; `loss` is the share of its last messages that did not arrive, on any way."""

    robot_id: int
    kind: str
    cell: tuple[int, int]
    task: str
    task_cell: tuple[int, int]
    cost: float
    moves: bool  # false: it stands still for want of perception or vehicle
    age_s: float
    hops: int
    loss: float
    rate_hz: float
    team: str  # digest of its configuration: robots of one team show the same


@dataclass(slots=True)
class _Author:
    message: NeighborMessage
    heard_ns: int
    hops: int
    arrivals: deque[tuple[int, int]] = field(default_factory=lambda: deque(maxlen=WINDOW))  # (sequence, time)


class TeamView:
    """Takes datagrams in and gives rows; bounded, without a clock of its own."""

    def __init__(self, key: bytes) -> None:
        self._key = key
        self._authors: dict[int, _Author] = {}
        self.refused = 0  # not signed with the team's key, or no messages at all
        self.repeated = 0

    def hear(self, data: bytes, now_ns: int) -> None:
        """Take in one datagram; whatever is wrong with it is counted."""
        try:
            envelope = open_envelope(data, self._key)
            known = self._authors.get(envelope.robot_id)
            if known is not None and envelope.seq <= known.message.seq:
                self.repeated += 1
                if envelope.seq == known.message.seq:
                    known.hops = min(known.hops, envelope.hops)
                return
            message = unpack(data)
        except MessageError:
            self.refused += 1
            return
        if known is None and len(self._authors) >= MAX_ROBOTS:
            return
        author = known or _Author(message, now_ns, envelope.hops)
        author.message, author.heard_ns, author.hops = message, now_ns, envelope.hops
        author.arrivals.append((message.seq, now_ns))
        self._authors[envelope.robot_id] = author

    def rows(self, now_ns: int) -> list[TeamRow]:
        """All robots ever heard, by id."""
        return [_row(author, now_ns) for _, author in sorted(self._authors.items())]


def _row(author: _Author, now_ns: int) -> TeamRow:
    message = author.message
    (first_seq, first_ns), (last_seq, last_ns) = author.arrivals[0], author.arrivals[-1]
    expected = last_seq - first_seq + 1
    return TeamRow(
        robot_id=message.robot_id,
        kind=message.kind.name,
        cell=message.cell,
        task=message.task.name,
        task_cell=message.task_cell,
        cost=message.cost,
        moves=message.speed_cells_s > 0,
        age_s=(now_ns - author.heard_ns) / NS_PER_S,
        hops=author.hops,
        loss=1 - len(author.arrivals) / expected,
        rate_hz=(len(author.arrivals) - 1) * NS_PER_S / (last_ns - first_ns) if last_ns > first_ns else 0.0,
        team=f"{message.config_digest:08x}",
    )
