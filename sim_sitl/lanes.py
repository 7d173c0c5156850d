"""How datagrams get through a bad link: the draws, from seeds of their own, and what is under way."""

from __future__ import annotations

import heapq
import random
from collections.abc import Iterable
from typing import Generic, TypeVar

from gatar_edge.sim_sitl.faults import Burst, LinkFaults
from gatar_edge.types import NS_PER_S

_WAITING_MAX = 100_000
_QUEUE_NS = NS_PER_S  # what a link without room holds back before it loses

Arrival = tuple[int, bytes]  # when, and what of it


class Lane:
    """One direction of one link: decides when a datagram arrives, how often, and whether whole."""

    __slots__ = ("_bad", "_began_ns", "_faults", "_free_ns", "_last_ns", "_more", "_rng", "perfect")

    def __init__(self, faults: LinkFaults, key: str, began_ns: int | None = None) -> None:
        self._faults = faults
        self.perfect = faults.none  # everything arrives at once and whole
        self._rng = random.Random(key)  # of its own: traffic elsewhere changes nothing here
        self._more = random.Random(f"{key}/more")  # so that rarer faults do not shift the common ones
        self._began_ns = began_ns
        self._bad = False
        self._last_ns = self._free_ns = 0

    def begin(self, now_ns: int) -> None:
        """The mission has begun: blackouts count from here."""
        self._began_ns = now_ns

    def carry(self, now_ns: int, datagram: bytes) -> list[Arrival]:
        """When a datagram sent now arrives, and as what: never, once or several times."""
        if self.perfect:
            return [(now_ns, datagram)]
        faults, rng = self._faults, self._rng
        # Always the same number of draws, so that one fault does not shift all later ones.
        lost, twice = rng.random() < faults.loss, rng.random() < faults.duplicate
        wait_ns = self._queue(now_ns, len(datagram)) if faults.bandwidth_bytes_s else 0
        times = [self._due(now_ns + wait_ns), self._due(now_ns + wait_ns)]
        if faults.burst is not None:
            lost |= self._in_burst(faults.burst)
        if faults.corrupt and self._more.random() < faults.corrupt:
            datagram = self._damaged(datagram)
        again = faults.replay > 0 and self._more.random() < faults.replay
        if lost or wait_ns > _QUEUE_NS or self._dark(now_ns):
            return []
        self._last_ns = max(self._last_ns, times[0])
        arrivals = [(due_ns, datagram) for due_ns in (times if twice else times[:1])]
        return [*arrivals, (now_ns + faults.replay_after_ns, datagram)] if again else arrivals

    def _due(self, now_ns: int) -> int:
        faults, rng = self._faults, self._rng
        due = now_ns + rng.randint(faults.delay_min_ns, faults.delay_max_ns)
        return due if rng.random() < faults.reorder else max(due, self._last_ns)

    def _queue(self, now_ns: int, size: int) -> int:
        """How long it takes until the last byte is through; what is lost in the queue takes no room."""
        start_ns = max(now_ns, self._free_ns)
        done_ns = start_ns + size * NS_PER_S // self._faults.bandwidth_bytes_s
        if done_ns - now_ns <= _QUEUE_NS:
            self._free_ns = done_ns
        return done_ns - now_ns

    def _in_burst(self, burst: Burst) -> bool:
        turn, loss = self._more.random(), self._more.random()
        self._bad = turn >= burst.leave if self._bad else turn < burst.enter
        return self._bad and loss < burst.loss

    def _damaged(self, datagram: bytes) -> bytes:
        if not datagram:
            return datagram
        damaged = bytearray(datagram)
        damaged[self._more.randrange(len(damaged))] ^= self._more.randint(1, 255)
        return bytes(damaged)

    def _dark(self, now_ns: int) -> bool:
        if self._began_ns is None:
            return False
        at_ns = now_ns - self._began_ns
        return any(start_ns <= at_ns < end_ns for start_ns, end_ns in self._faults.blackouts_ns)


Receiver = TypeVar("Receiver")


class InFlight(Generic[Receiver]):
    """Datagrams under way, in order of arrival, then of sending."""

    def __init__(self) -> None:
        self._arriving: dict[int, list[tuple[Receiver, bytes]]] = {}  # by time, in order of sending
        self._times: list[int] = []  # of these, as a heap: many datagrams share one
        self._waiting = 0

    def __len__(self) -> int:
        return self._waiting

    def add(self, due_ns: int, receiver: Receiver, datagram: bytes) -> None:
        """Put a datagram under way; with 100 000 waiting, more are lost."""
        if self._waiting < _WAITING_MAX:
            self._waiting += 1
            self._at(due_ns).append((receiver, datagram))

    def add_all(self, due_ns: int, receivers: Iterable[Receiver], datagrams: Iterable[bytes]) -> None:
        """The same for all of `datagrams`, to all of `receivers` at one time."""
        arriving = self._at(due_ns)
        before = len(arriving)
        arriving += [(receiver, datagram) for datagram in datagrams for receiver in receivers]
        del arriving[before + _WAITING_MAX - self._waiting :]
        self._waiting += len(arriving) - before

    def take(self, now_ns: int) -> list[tuple[Receiver, bytes]]:
        """All that has arrived by now."""
        times = self._times
        arrived: list[tuple[Receiver, bytes]] = []
        while times and times[0] <= now_ns:
            arrived += self._arriving.pop(heapq.heappop(times))
        self._waiting -= len(arrived)
        return arrived

    def _at(self, due_ns: int) -> list[tuple[Receiver, bytes]]:
        arriving = self._arriving.get(due_ns)
        if arriving is None:
            arriving = self._arriving[due_ns] = []
            heapq.heappush(self._times, due_ns)
        return arriving
