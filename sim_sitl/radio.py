"""The radio between robots: a disc of range, and what goes wrong on the way. No sockets, no clock."""

from __future__ import annotations

import math
from collections.abc import Mapping

from gatar_edge.errors import ConfigError
from gatar_edge.sim_sitl.faults import LinkFaults
from gatar_edge.sim_sitl.lanes import InFlight, Lane

Position = tuple[float, float]


class Radio:
    """Broadcasts datagrams to all robots within `range_cells` of the sender at the time of sending."""

    def __init__(
        self,
        range_cells: float,
        faults: LinkFaults | None = None,
        seed: int = 0,
        between: Mapping[tuple[int, int], LinkFaults] | None = None,
    ) -> None:
        """`between`: exceptions from `faults` by (sender, receiver)."""
        if not range_cells >= 0:
            raise ConfigError(f"radio range is {range_cells} cells, must be 0 or more")
        self._range_cells = range_cells
        self._faults = faults or LinkFaults()
        self._between = between or {}
        self._seed = seed
        self._began_ns: int | None = None
        self._lanes: dict[tuple[int, int], Lane] = {}
        self._in_flight: InFlight[int] = InFlight()
        self._positions: dict[int, Position] = {}
        self._near: dict[int, list[int]] = {}  # who is in range of whom at `_positions`
        self._perfect = self._faults.none and not self._between
        self.sent = self.delivered = self.sent_bytes = 0

    def begin(self, now_ns: int) -> None:
        """The mission has begun: blackouts count from here."""
        self._began_ns = now_ns
        for lane in self._lanes.values():
            lane.begin(now_ns)

    def send(self, now_ns: int, sender: int, datagram: bytes, positions: Mapping[int, Position]) -> None:
        """Broadcast: `positions` holds the cells of all robots that exist now, the sender among them."""
        self.sent += 1
        self.sent_bytes += len(datagram)
        receivers = self._in_range(sender, positions)
        if self._perfect:
            self._in_flight.add_all(now_ns, receivers, (datagram,))
            return
        for receiver in receivers:
            for due_ns, arriving in self._lane(sender, receiver).carry(now_ns, datagram):
                self._in_flight.add(due_ns, receiver, arriving)

    def deliver(self, now_ns: int) -> list[tuple[int, bytes]]:
        """(receiver, datagram) for all that has arrived by now."""
        arrived = self._in_flight.take(now_ns)
        self.delivered += len(arrived)
        return arrived

    def _in_range(self, sender: int, positions: Mapping[int, Position]) -> list[int]:
        """Who hears the sender: worked out once for all that is sent while nobody moves."""
        if positions != self._positions:
            self._positions, self._near = dict(positions), {}
        near = self._near.get(sender)
        if near is None:
            x, y = positions[sender]
            near = self._near[sender] = [
                receiver
                for receiver, there in sorted(positions.items())
                if receiver != sender and math.hypot(there[0] - x, there[1] - y) <= self._range_cells
            ]
        return near

    def _lane(self, sender: int, receiver: int) -> Lane:
        lane = self._lanes.get((sender, receiver))
        if lane is None:
            faults = self._between.get((sender, receiver), self._faults)
            lane = Lane(faults, f"radio/{self._seed}/{sender}/{receiver}", self._began_ns)
            self._lanes[sender, receiver] = lane
        return lane
