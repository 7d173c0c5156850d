"""What goes wrong, declared beforehand and drawn from a seed."""

from __future__ import annotations

import heapq
import random
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from gatar_edge.errors import ConfigError
from gatar_edge.types import NS_PER_S

_WAITING_MAX = 100_000
_DELAY_MAX_NS = 3600 * NS_PER_S


@dataclass(frozen=True, slots=True)
class LinkFaults:
    """One direction of one link. `loss`, `duplicate` and `reorder` are probabilities, delays are drawn evenly.

    A datagram that is not reordered never overtakes one sent before it; one that is takes its own delay.
    """

    loss: float = 0.0
    duplicate: float = 0.0
    reorder: float = 0.0
    delay_min_ns: int = 0
    delay_max_ns: int = 0

    @property
    def none(self) -> bool:
        """Whether everything arrives at once."""
        return not (self.loss or self.duplicate or self.reorder or self.delay_max_ns)

    def __post_init__(self) -> None:
        """Refuse what is no probability or no delay."""
        for name in ("loss", "duplicate", "reorder"):
            value = getattr(self, name)
            if not 0.0 <= value <= 1.0:
                raise ConfigError(f"{name} is {value}, must be 0 to 1")
        if not 0 <= self.delay_min_ns <= self.delay_max_ns <= _DELAY_MAX_NS:
            raise ConfigError(
                f"delays are {self.delay_min_ns} to {self.delay_max_ns} ns, must rise from 0 to {_DELAY_MAX_NS} at most"
            )


@dataclass(frozen=True, slots=True)
class Faults:
    """All faults of a mission. `kill_ns`: robot id to the time when its companion computer dies."""

    radio: LinkFaults = LinkFaults()
    to_vehicle: LinkFaults = LinkFaults()
    to_companion: LinkFaults = LinkFaults()
    kill_ns: Mapping[int, int] = field(default_factory=dict)

    def killed(self, robot_id: int, now_ns: int) -> bool:
        """Whether the robot is dead by now."""
        at_ns = self.kill_ns.get(robot_id)
        return at_ns is not None and now_ns >= at_ns


Receiver = TypeVar("Receiver")


class Lane:
    """One direction of one link: decides when a datagram arrives, and how often."""

    __slots__ = ("_faults", "_last_ns", "_perfect", "_rng")

    def __init__(self, faults: LinkFaults, key: str) -> None:
        self._faults = faults
        self._perfect = faults.none
        self._rng = random.Random(key)  # of its own: traffic elsewhere changes nothing here
        self._last_ns = 0

    def arrivals(self, now_ns: int) -> list[int]:
        """When a datagram sent now arrives: never, once or twice."""
        if self._perfect:
            return [now_ns]
        faults, rng = self._faults, self._rng
        # Always the same number of draws, so that one fault does not shift all later ones.
        lost, twice = rng.random() < faults.loss, rng.random() < faults.duplicate
        times = [self._due(now_ns), self._due(now_ns)]
        if lost:
            return []
        self._last_ns = max(self._last_ns, times[0])
        return times if twice else times[:1]

    def _due(self, now_ns: int) -> int:
        faults, rng = self._faults, self._rng
        due = now_ns + rng.randint(faults.delay_min_ns, faults.delay_max_ns)
        return due if rng.random() < faults.reorder else max(due, self._last_ns)


class InFlight(Generic[Receiver]):
    """Datagrams under way, in order of arrival, then of sending."""

    def __init__(self) -> None:
        self._heap: list[tuple[int, int, Receiver, bytes]] = []
        self._sent = 0

    def __len__(self) -> int:
        return len(self._heap)

    def add(self, due_ns: int, receiver: Receiver, datagram: bytes) -> None:
        """Put a datagram under way; with 100 000 waiting, more are lost."""
        if len(self._heap) < _WAITING_MAX:
            self._sent += 1
            heapq.heappush(self._heap, (due_ns, self._sent, receiver, datagram))

    def take(self, now_ns: int) -> list[tuple[Receiver, bytes]]:
        """All that has arrived by now."""
        arrived = []
        while self._heap and self._heap[0][0] <= now_ns:
            _, _, receiver, datagram = heapq.heappop(self._heap)
            arrived.append((receiver, datagram))
        return arrived
