"""Uploads to the simulated mission servers through a lossy link, by the simplest uploader that can work.

What it takes stands in the measured row "Loss": COUNT again until asked, every request answered, INVALID_SEQUENCE and
ERROR never final, ACCEPTED believed only when every item was asked for.
"""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from gatar_edge.sim_sitl.autopilot import AutopilotConfig, SimAutopilot
from gatar_edge.sim_sitl.faults import LinkFaults
from gatar_edge.sim_sitl.faulty_link import End, FaultyLink
from gatar_edge.sim_sitl.mission_items import Ack
from gatar_edge.sim_sitl.testing import HOME, ROVER, px4_rover
from gatar_edge.sim_sitl.wire import Message, mavlink

MS, S = 1_000_000, 1_000_000_000
COUNT = 6
FAULTS = LinkFaults(loss=0.3, duplicate=0.1, reorder=1.0, delay_max_ns=400 * MS)


class Uploader:
    """Sends COUNT until it is asked, then answers each request for ever."""

    def __init__(self, target: int) -> None:
        self._target = target
        self._codec = mavlink.MAVLink(None, 255, 190)
        self._parser = mavlink.MAVLink(None)
        self._asked: set[int] = set()
        self._retry_ns = 0
        self.done = False

    def step(self, now_ns: int) -> bytes:
        """COUNT, each second until the first request and after a cancelled upload."""
        if self._asked or now_ns < self._retry_ns:
            return b""
        self._retry_ns = now_ns + S
        return bytes(mavlink.MAVLink_mission_count_message(self._target, 1, COUNT).pack(self._codec))

    def receive(self, data: bytes, now_ns: int) -> Iterator[bytes]:
        """Answers."""
        for message in self._parser.parse_buffer(data) or []:
            yield from self._answer(message, now_ns)

    def _answer(self, message: Message, now_ns: int) -> Iterator[bytes]:
        name = message.get_type()
        if name in ("MISSION_REQUEST", "MISSION_REQUEST_INT") and message.seq < COUNT:
            self._asked.add(message.seq)
            fields = (3, 16, 0, 1, 0, 0, 0, 0, round(HOME[0] * 1e7) + message.seq, round(HOME[1] * 1e7), 0)
            item = mavlink.MAVLink_mission_item_int_message(self._target, 1, message.seq, *fields)
            yield bytes(item.pack(self._codec))
        elif name == "MISSION_ACK" and message.type == Ack.ACCEPTED and len(self._asked) == COUNT:
            self.done = True
        elif self._given_up(message):
            self._asked.clear()

    @staticmethod
    def _given_up(message: Message) -> bool:
        """ArduPilot says so by an ACK, PX4 by a text."""
        cancelled = message.get_type() == "MISSION_ACK" and message.type == Ack.OPERATION_CANCELLED
        return cancelled or getattr(message, "text", "") == "Operation timeout"


@pytest.mark.parametrize("config", [ROVER, px4_rover()], ids=lambda c: c.stack)
@pytest.mark.parametrize("seed", range(15))
def test_a_request_driven_upload_through_a_lossy_link_ends_whole_on_board(config: AutopilotConfig, seed: int) -> None:
    vehicle, uploader = SimAutopilot(config, 0), Uploader(config.sysid)
    link = FaultyLink(FAULTS, FAULTS, seed)
    now_ns = 0
    while not uploader.done and now_ns < 60 * S:
        now_ns += 50 * MS
        vehicle.step(now_ns)
        link.send(now_ns, End.VEHICLE, vehicle.take())
        link.send(now_ns, End.COMPANION, uploader.step(now_ns))
        for end, frame in link.deliver(now_ns):
            if end is End.VEHICLE:
                vehicle.receive(frame, now_ns)
            else:
                for answer in uploader.receive(frame, now_ns):
                    link.send(now_ns, End.COMPANION, answer)
    # Where the last ACK was lost the uploader cannot know, but the mission is whole all the same.
    assert [item.x - round(HOME[0] * 1e7) for item in vehicle.mission] == list(range(COUNT))
