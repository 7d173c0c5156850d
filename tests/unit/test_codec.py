"""The codec: never raises on what a peer sends, and writes what another implementation reads."""

from __future__ import annotations

import math
import random

import pytest
from bridge_fake_vehicle import mav
from hypothesis import given
from hypothesis import strategies as st

from gatar_edge.bridge import wire
from gatar_edge.bridge.codec import _BUILDERS, MAX_PARSE_BYTES, Codec, message_id, strip_signature
from gatar_edge.bridge.signing import Signing

VEHICLE = (7, 1)
ITEM = wire.MissionItem(6, 16, (0.0, 0.0, 0.0, 0.0), 470000000, -80000000, 20.0)
SENDABLE = [
    wire.Heartbeat(18, 8, 0, 0, 4),
    wire.CommandLong(VEHICLE, 400, (1, 0, 0, 0, 0, 0, 0)),
    wire.CommandInt(VEHICLE, 6, 192, (-1, 1, 0, math.nan), 470000000, -80000000, 20.0),
    wire.SetPositionTarget(VEHICLE, 6, 0x0DF8, 470000000, -80000000, 20.0),
    wire.MissionCount(VEHICLE, 3),
    wire.MissionRequest(VEHICLE, 2),
    wire.MissionItemAt(VEHICLE, 1, ITEM),
    wire.MissionAck(VEHICLE, 0),
    wire.MissionRequestList(VEHICLE),
    wire.MissionClearAll(VEHICLE),
    wire.MissionSetCurrent(VEHICLE, 1),
    wire.ParamRead(VEHICLE, "FS_GCS_ENABLE"),
    wire.SetGlobalOrigin(7, 470000000, -80000000, 488_000),
    wire.TimeSync(0, 123_456_789),
]
NAMES = [
    "HEARTBEAT",
    "COMMAND_LONG",
    "COMMAND_INT",
    "SET_POSITION_TARGET_GLOBAL_INT",
    "MISSION_COUNT",
    "MISSION_REQUEST_INT",
    "MISSION_ITEM_INT",
    "MISSION_ACK",
    "MISSION_REQUEST_LIST",
    "MISSION_CLEAR_ALL",
    "MISSION_SET_CURRENT",
    "PARAM_REQUEST_READ",
    "SET_GPS_GLOBAL_ORIGIN",
    "TIMESYNC",
]


@pytest.mark.parametrize("message", SENDABLE, ids=NAMES)
def test_a_frame_is_byte_for_byte_what_pymavlink_packs(message: wire.Message) -> None:
    peer = mav.MAVLink(None, 7, 191)
    peer.seq = 1  # the second frame
    codec = Codec(7, 191)
    codec.encode(message)
    assert codec.encode(message) == _BUILDERS[type(message)](message).pack(peer)


@given(st.binary(max_size=600))
def test_any_bytes_are_parsed_without_an_error(data: bytes) -> None:
    codec = Codec(7, 191)
    for piece in (data[:100], data[100:], data):
        codec.parse(piece)


def test_mutated_frames_are_parsed_without_an_error_and_good_ones_follow() -> None:
    rng = random.Random(5)
    good = b"".join(Codec(*VEHICLE).encode(m) for m in SENDABLE)
    codec = Codec(7, 191)
    for _ in range(2000):
        data = bytearray(good)
        for _ in range(rng.randrange(1, 8)):
            data[rng.randrange(len(data))] = rng.randrange(256)
        codec.parse(bytes(data[rng.randrange(20) :]))
    codec.parse(bytes(600))  # ends whatever length a broken header announced
    assert any(r.message == SENDABLE[0] for r in codec.parse(good + good))
    assert codec.bad_bytes > 0


def test_more_bytes_than_any_read_returns_are_cut_and_counted() -> None:
    codec = Codec(7, 191)
    codec.parse(bytes(MAX_PARSE_BYTES + 10))
    assert codec.bad_bytes >= MAX_PARSE_BYTES


@pytest.mark.parametrize(("message", "name"), list(zip(SENDABLE, NAMES, strict=True)), ids=NAMES)
def test_each_message_is_read_by_another_parser_under_its_name(message: wire.Message, name: str) -> None:
    frame = Codec(7, 191).encode(message)
    parser = mav.MAVLink(None)
    (read,) = parser.parse_buffer(frame)
    assert read.get_type() == name
    assert (read.get_srcSystem(), read.get_srcComponent()) == (7, 191)
    assert frame[0] == 0xFD
    assert getattr(read, "target_system", 7) == 7
    assert message_id(frame) == read.get_msgId()


def test_every_sendable_message_is_covered_here_and_none_of_the_deprecated_ones() -> None:
    assert {type(m) for m in SENDABLE} == set(_BUILDERS)
    assert not {"MISSION_ITEM", "MISSION_REQUEST"} & set(NAMES)


def test_both_kinds_of_requests_read_alike() -> None:
    peer = mav.MAVLink(None, srcSystem=7, srcComponent=1)
    old = mav.MAVLink_mission_request_message(7, 191, 4, 0).pack(peer)
    new = mav.MAVLink_mission_request_int_message(7, 191, 4, 0).pack(peer)
    a, b = Codec(7, 191).parse(old + new)
    assert a.message == b.message == wire.MissionRequest((7, 191), 4)
    assert (a.message_id, b.message_id) == (40, 51)


def test_the_sequence_number_counts_frames() -> None:
    codec = Codec(7, 191)
    assert [codec.encode(SENDABLE[0])[4] for _ in range(258)] == [*range(256), 0, 1]


def test_frames_in_pieces_are_put_together() -> None:
    frame = Codec(*VEHICLE).encode(SENDABLE[4])
    codec = Codec(7, 191)
    assert codec.parse(frame[:5]) == []
    assert [r.message for r in codec.parse(frame[5:])] == [SENDABLE[4]]


def test_frames_of_all_kinds_in_one_piece_come_out_in_order_and_as_one_by_one() -> None:
    sender = Codec(*VEHICLE)
    text = mav.MAVLink_statustext_message(4, b"PreArm").pack(mav.MAVLink(None, *VEHICLE))  # has an array
    pieces = [sender.encode(SENDABLE[0]), sender.encode(SENDABLE[4]), text, b"noise", sender.encode(SENDABLE[0])]
    together, one_by_one = Codec(7, 191), Codec(7, 191)
    received = together.parse(b"".join(pieces) + text[:7])
    assert received == [r for piece in pieces for r in one_by_one.parse(piece)]
    assert [r.raw for r in received] == [piece for piece in pieces if piece != b"noise"]
    assert together.bad_bytes == one_by_one.bad_bytes == 5
    assert [r.raw for r in together.parse(text[7:] + pieces[0])] == [text, pieces[0]]


def test_a_signature_is_cut_off_for_the_log() -> None:
    signing = mav.MAVLink(None, srcSystem=7, srcComponent=1)
    signing.signing.secret_key, signing.signing.sign_outgoing = b"k" * 32, True
    frame = mav.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3).pack(signing)
    (received,) = Codec(7, 191).parse(frame)
    assert received.raw == strip_signature(frame)
    assert len(received.raw) == len(frame) - 13
    (again,) = Codec(7, 191).parse(received.raw)  # a reader of the log can parse it
    assert again.message == received.message


@pytest.mark.parametrize("bits", [0, 0xFFB3B4C0, 0x7F800001, 5])
def test_the_bits_of_a_parameter_survive_also_those_of_a_signalling_nan(bits: int) -> None:
    frame = mav.MAVLink_param_value_message(b"N", 1.5, 6, 1, 0).pack(mav.MAVLink(None, 7, 1))
    changed = frame[:10] + bits.to_bytes(4, "little") + frame[14:-2]
    extra = mav.mavlink_map[22].crc_extra
    changed += mav.x25crc(changed[1:] + bytes([extra])).crc.to_bytes(2, "little")
    (read,) = Codec(7, 191).parse(changed)
    assert read.message == wire.ParamValue("N", bits.to_bytes(4, "little"), 6)


def test_a_signed_frame_is_told_from_one_that_is_not() -> None:
    signed = Codec(7, 1, Signing(bytes(32), 1, 100)).encode(wire.TimeSync(0, 1))
    plain = Codec(7, 1).encode(wire.TimeSync(0, 1))
    assert [r.signed for r in Codec(7, 191).parse(signed + plain)] == [True, False]
