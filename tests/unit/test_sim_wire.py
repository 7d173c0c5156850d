"""The simulated autopilot reads frames as pymavlink does, at a part of its cost."""

from __future__ import annotations

import pytest

from gatar_edge.sim_sitl.wire import Wire, mavlink

PLAIN = ["COMMAND_LONG", "COMMAND_INT", "MISSION_ITEM_INT", "MISSION_COUNT", "MISSION_SET_CURRENT", "HEARTBEAT"]


def frame_of(name: str, value: int) -> bytes:
    """A frame of the ground station 255, all of whose fields hold `value`."""
    kind = getattr(mavlink, f"MAVLink_{name.lower()}_message")
    sender = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
    sender.seq = 17
    return bytes(kind(*[value] * len(kind.fieldnames)).pack(sender))


@pytest.mark.parametrize("value", [0, 1, 100])
@pytest.mark.parametrize("name", PLAIN)
def test_a_message_without_arrays_is_what_pymavlink_makes_of_it(name: str, value: int) -> None:
    frame = frame_of(name, value)
    (message,) = Wire(1).parse(frame)
    expected = mavlink.MAVLink(None).decode(bytearray(frame))

    assert message.to_dict() == expected.to_dict()
    assert message.get_msgId() == expected.get_msgId()
    assert (message.get_srcSystem(), message.get_srcComponent(), message.get_seq()) == (255, 190, 17)


def test_a_damaged_frame_is_no_message_and_counted() -> None:
    frame = bytearray(frame_of("COMMAND_LONG", 1))
    frame[-3] ^= 1
    wire = Wire(1)

    assert wire.parse(bytes(frame)) == []
    assert wire.rejected == 1
