"""Neighbour messages in MAVLink TUNNELs: they arrive whole, and nothing else on the link gets in the way."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from gatar_edge.transports.mavlink_tunnel import FRAME_BYTES, PAYLOAD_TYPE, MavlinkTunnel


def pair() -> tuple[MavlinkTunnel, MavlinkTunnel, list[bytes]]:
    """Two ends, and what the first puts on the wire."""
    wire: list[bytes] = []
    return MavlinkTunnel(wire.append, lambda: -1, 1), MavlinkTunnel(wire.append, lambda: -1, 2), wire


@given(st.binary(min_size=1, max_size=128))
def test_a_datagram_arrives_as_it_was_sent_also_with_zeros_at_its_end(data: bytes) -> None:
    one, two, wire = pair()
    one.send(data)
    assert len(wire[0]) <= FRAME_BYTES
    two.feed(wire[0])
    assert two.receive() == [data]
    assert two.receive() == []


def test_frames_arrive_from_a_stream_in_pieces_between_other_messages_and_noise() -> None:
    one, two, wire = pair()
    heartbeat = mavlink.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3).pack(mavlink.MAVLink(None, 1, 1))
    for number in range(5):
        one.send(bytes([number]) * 127)
    stream = b"\xfd\x00noise" + b"".join(heartbeat + frame for frame in wire)
    for start in range(0, len(stream), 7):
        two.feed(stream[start : start + 7])
    assert [data[0] for data in two.receive()][-4:] == [1, 2, 3, 4]


def test_own_frames_and_other_peoples_tunnels_are_ignored() -> None:
    one, two, wire = pair()
    one.send(b"mine")
    one.feed(wire[0])
    assert one.receive() == []
    mav = mavlink.MAVLink(None, 9, 9)
    two.feed(mavlink.MAVLink_tunnel_message(0, 0, PAYLOAD_TYPE + 1, 4, [1] * 128).pack(mav))
    two.feed(mavlink.MAVLink_tunnel_message(0, 0, PAYLOAD_TYPE, 200, [1] * 128).pack(mav))
    assert two.receive() == []
    assert two.counters.too_long == 1


@given(st.lists(st.binary(max_size=300), max_size=5))
def test_no_bytes_on_the_link_raise(pieces: list[bytes]) -> None:
    _, two, _ = pair()
    for piece in pieces:
        two.feed(piece)


@pytest.mark.parametrize("size", [129, 256])
def test_what_does_not_fit_is_counted_and_not_sent(size: int) -> None:
    one, _, wire = pair()
    one.send(b"x" * size)
    assert (wire, one.counters.send_errors) == ([], 1)
