"""The robots of a replay: real agents, whose allocators miss the deadlines that the recorded ones missed."""

from __future__ import annotations

from dataclasses import dataclass, field

from gatar_edge.agent import Agent
from gatar_edge.allocators.base import Allocation, Allocator, Negotiator
from gatar_edge.errors import DeadlineError
from gatar_edge.view import View


class Prompted:
    """An allocator that is late when the recorded one was."""

    def __init__(self, allocator: Allocator) -> None:
        self._allocator = allocator
        self.late = ""

    @property
    def name(self) -> str:
        """The allocator's name."""
        return self._allocator.name

    def allocate(self, view: View) -> Allocation:
        """See `allocators.base.Allocator`."""
        if self.late:
            raise DeadlineError(self.late)
        return self._allocator.allocate(view)


class PromptedNegotiator(Prompted):
    """The same for an allocator that talks."""

    def __init__(self, allocator: Negotiator) -> None:
        super().__init__(allocator)
        self._negotiator = allocator

    def bid(self, view: View) -> tuple[bytes, ...]:
        """See `allocators.base.Negotiator`."""
        return self._negotiator.bid(view)

    def heard(self, payload: bytes, now_ns: int) -> None:
        """See `allocators.base.Negotiator`."""
        self._negotiator.heard(payload, now_ns)


@dataclass(slots=True)
class Ghost:
    """One robot of the replay."""

    agent: Agent
    allocator: Prompted
    first_seq: int
    talks: list[bytes] = field(default_factory=list)  # that it composed, and the log has not shown yet
