"""The cable or telemetry radio between a companion and its autopilot, with its faults. No sockets, no clock."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from enum import IntEnum

from gatar_edge.sim_sitl.faults import LinkFaults
from gatar_edge.sim_sitl.lanes import InFlight, Lane

_STX_V1, _STX_V2 = 0xFE, 0xFD
_OVERHEAD_V1, _OVERHEAD_V2, _SIGNATURE = 8, 12, 13


class End(IntEnum):
    """The two ends of a link."""

    COMPANION = 0
    VEHICLE = 1


_ENDS = tuple(End)


def split_frames(data: bytes) -> list[bytes]:
    """MAVLink frames one by one, since each is a datagram of its own; what is no frame stays in one piece."""
    frames = []
    start = 0
    while start < len(data):
        length = len(data) - start
        if length >= 3 and data[start] == _STX_V2:
            length = min(length, _OVERHEAD_V2 + data[start + 1] + (_SIGNATURE if data[start + 2] & 1 else 0))
        elif length >= 2 and data[start] == _STX_V1:
            length = min(length, _OVERHEAD_V1 + data[start + 1])
        frames.append(data[start : start + length])
        start += length
    return frames


class FaultyLink:
    """Carries whole frames both ways; each direction has its own faults."""

    def __init__(self, to_vehicle: LinkFaults, to_companion: LinkFaults, seed: int = 0, name: str = "") -> None:
        self._lanes = (  # by the end that sends
            Lane(to_vehicle, f"link/{seed}/{name}/to_vehicle"),
            Lane(to_companion, f"link/{seed}/{name}/to_companion"),
        )
        self._in_flight: InFlight[End] = InFlight()
        self._perfect = all(lane.perfect for lane in self._lanes)
        self._arrived: list[tuple[End, bytes]] = []  # what a perfect link holds until the next delivery
        self.tap: Callable[[End, bytes], None] | None = None  # is shown what is sent, before anything happens to it

    def begin(self, now_ns: int) -> None:
        """The mission has begun: blackouts count from here."""
        for lane in self._lanes:
            lane.begin(now_ns)

    def send(self, now_ns: int, sender: End, data: bytes) -> None:
        """Send frames from one end."""
        if data:
            self.send_frames(now_ns, sender, split_frames(data))

    def send_frames(self, now_ns: int, sender: End, frames: Sequence[bytes]) -> None:
        """The same for frames that are apart already."""
        if self.tap is not None:
            self.tap(sender, b"".join(frames))
        lane, receiver = self._lanes[sender], _ENDS[1 - sender]
        if self._perfect:
            self._arrived += [(receiver, frame) for frame in frames]
            return
        for frame in frames:
            for due_ns, arriving in lane.carry(now_ns, frame):
                self._in_flight.add(due_ns, receiver, arriving)

    def deliver(self, now_ns: int) -> list[tuple[End, bytes]]:
        """(receiving end, frame) for all that has arrived by now."""
        if self._perfect:
            arrived, self._arrived = self._arrived, []
            return arrived
        return self._in_flight.take(now_ns)
