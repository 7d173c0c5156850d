"""The message format: its golden bytes, its limits, and one clear sentence for each way to be wrong."""

from __future__ import annotations

import hashlib
import math
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from gatar_edge.errors import ConfigError, MessageCause, MessageError
from gatar_edge.keys import DEMO_KEY
from gatar_edge.message import (
    MAX_COST,
    MAX_MESSAGES_PER_S,
    MAX_SPEED_CELLS_S,
    MESSAGE_BYTES,
    NeighborMessage,
    decode,
    encode,
    first_seq,
    open_envelope,
    wire_cost,
    wire_speed,
    with_hops,
)
from gatar_edge.types import NS_PER_S, RobotKind, TaskKind

MESSAGE = NeighborMessage(
    robot_id=0x1234,
    kind=RobotKind.UGV,
    seq=0x01020304,
    t_ms=0x0A0B0C0D0E0F,
    cell=(7, -3),
    speed_cells_s=0.5,
    task=TaskKind.TARGET,
    task_cell=(-300, 400),
    cost=12.25,
    window_origin=(0, -10),
    window=(np.arange(225, dtype=np.uint8) % 5).reshape(15, 15),
    config_digest=0xDEADBEEF,
    hops=1,
)
GOLDEN = bytes.fromhex(
    "01"  # version
    "05"  # UGV, TARGET
    "01"  # hops
    "1234"
    "01020304"
    "0a0b0c0d0e0f"
    "0007fffd"
    "08"  # 0.5 cell/s
    "fed40190"
    "00c4"  # 12.25 cells
    "0000fff6"
    "deadbeef"
    "4a29a594524a29a594524a29a594524a29a594524a29a594524a29a518638c31c618638c31c618638c31c618638c31c61863"
    "8c31c618638c4108218410420821841042082184104208218410420821841042082104"
    "f78da4f599f35270"
)
YEAR_2027_NS = 1_798_761_600 * NS_PER_S


def signed(body: bytes) -> bytes:
    """`body` as a holder of the key would sign it, written without the module under test."""
    return body + hashlib.blake2b(body, digest_size=8, key=DEMO_KEY, person=b"gatar-v1").digest()


def changed(at: int, value: int) -> bytes:
    """The golden message with another byte at `at`, rightly signed."""
    body = bytearray(GOLDEN[:-8])
    body[at] = value
    return signed(bytes(body))


def test_the_bytes_of_a_message_never_change_within_a_version() -> None:
    assert encode(MESSAGE, DEMO_KEY) == GOLDEN


def test_the_golden_bytes_read_back_as_the_message() -> None:
    assert decode(GOLDEN, DEMO_KEY) == MESSAGE


def test_a_message_fits_a_mavlink_tunnel() -> None:
    assert len(GOLDEN) == MESSAGE_BYTES <= 128


def test_the_window_is_indexed_x_first_from_its_origin() -> None:
    window = np.zeros((15, 15), np.uint8)
    window[1, 0] = 1
    planes = encode(replace(MESSAGE, window=window), DEMO_KEY)[34:119]
    assert int.from_bytes(planes, "little") == 1 << 15


def test_a_decoded_window_cannot_be_written() -> None:
    with pytest.raises(ValueError, match="read-only"):
        decode(GOLDEN, DEMO_KEY).window[0, 0] = 1


def test_messages_differ_when_only_their_windows_do() -> None:
    assert replace(MESSAGE, window=np.zeros((15, 15), np.uint8)) != MESSAGE


@pytest.mark.parametrize(
    ("data", "cause", "text"),
    [
        (b"", MessageCause.MALFORMED, "an empty datagram is not a message"),
        (GOLDEN[:-1], MessageCause.MALFORMED, "message has 126 bytes, version 1 has 127"),
        (GOLDEN + b"\0", MessageCause.MALFORMED, "message has 128 bytes, version 1 has 127"),
        (b"\2" + GOLDEN[1:], MessageCause.VERSION, "message version is 2, this robot reads 1"),
        (b"\2", MessageCause.VERSION, "message version is 2, this robot reads 1"),
        (GOLDEN[:-1] + b"\0", MessageCause.FORGED, "message is signed with another key, or was changed on the way"),
        (changed(1, 0b0110), MessageCause.MALFORMED, "robot kind is 2, known are 0..1"),
        (changed(1, 0b1101), MessageCause.MALFORMED, "task kind with reserved bits is 3, known are 0..2"),
        (changed(1, 0b10101), MessageCause.MALFORMED, "task kind with reserved bits is 5, known are 0..2"),
        (changed(118, 0x08), MessageCause.MALFORMED, "the bits behind the window are not zero"),
        (changed(118, 0x80), MessageCause.MALFORMED, "the bits behind the window are not zero"),
        # the last cell is code 4: its high bit is bit 2 of byte 118; its low bit is bit 224 (byte 62, bit 0)
        (changed(62, GOLDEN[62] | 1), MessageCause.MALFORMED, "window holds a cell code of 5..7, known are 0..4"),
    ],
)
def test_each_fault_has_its_cause_and_its_sentence(data: bytes, cause: MessageCause, text: str) -> None:
    with pytest.raises(MessageError) as caught:
        decode(data, DEMO_KEY)
    assert (caught.value.cause, str(caught.value)) == (cause, text)


def test_another_teams_key_reads_nothing() -> None:
    with pytest.raises(MessageError) as caught:
        decode(GOLDEN, bytes(32))
    assert caught.value.cause is MessageCause.FORGED


def test_each_signed_byte_counts() -> None:
    for at in range(1, len(GOLDEN)):
        data = bytearray(GOLDEN)
        data[at] ^= 0x40
        with pytest.raises(MessageError) as caught:
            open_envelope(bytes(data), DEMO_KEY)
        assert caught.value.cause is MessageCause.FORGED


def test_the_envelope_is_the_head_of_the_message() -> None:
    assert open_envelope(GOLDEN, DEMO_KEY) == (0x1234, 0x01020304, 1, 0xDEADBEEF)


def test_a_relay_changes_the_hops_and_nothing_else() -> None:
    assert decode(with_hops(GOLDEN, 7, DEMO_KEY), DEMO_KEY) == replace(MESSAGE, hops=7)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"robot_id": 65536}, "robot_id is 65536, must be of whole numbers 0..65535"),
        ({"robot_id": 1.0}, "robot_id is 1.0, must be of whole numbers 0..65535"),
        ({"seq": -1}, "seq is -1, must be of whole numbers 0..4294967295"),
        ({"t_ms": 1 << 48}, "t_ms is 281474976710656, must be of whole numbers 0..281474976710655"),
        ({"t_ms": 0.5}, "t_ms is 0.5, must be"),
        ({"cell": (0, 40000)}, "cell is (0, 40000), must be of whole numbers -32768..32767"),
        ({"cell": (0, 0, 0)}, "a cell of the message does not have two coordinates"),
        ({"hops": 256}, "hops is 256, must be of whole numbers 0..255"),
        ({"kind": 2}, "kind 2 or task 1 is unknown"),
        ({"task": 3}, "kind 1 or task 3 is unknown"),
        ({"cost": math.nan}, "cost is nan, must be a number >= 0"),
        ({"speed_cells_s": -1.0}, "speed_cells_s is -1.0, must be a number >= 0"),
        ({"window": np.zeros((15, 14), np.uint8)}, "window is uint8 (15, 14), must be uint8 (15, 15)"),
        ({"window": np.zeros((15, 15), np.int32)}, "window is int32 (15, 15), must be uint8 (15, 15)"),
        ({"window": np.full((15, 15), 5, np.uint8)}, "window holds cell code 5, known are 0..4"),
    ],
)
def test_what_does_not_fit_is_not_sent_and_named(changes: dict[str, Any], text: str) -> None:
    with pytest.raises(MessageError) as caught:
        encode(replace(MESSAGE, **changes), DEMO_KEY)
    assert str(caught.value).startswith(text)


def test_numbers_of_numpy_are_sent_like_those_of_python() -> None:
    numbers: dict[str, Any] = {
        "robot_id": np.int64(0x1234),
        "cell": tuple(np.array([7, -3], np.int16)),
        "cost": np.float32(12.25),
    }
    assert encode(replace(MESSAGE, **numbers), DEMO_KEY) == GOLDEN


def test_a_window_that_is_a_view_is_sent_as_it_reads() -> None:
    assert encode(replace(MESSAGE, window=MESSAGE.window.copy("F")), DEMO_KEY) == GOLDEN


@pytest.mark.parametrize(
    ("cost", "sent"), [(0.0, 0.0), (3.03, 3.0), (3.04, 3.0625), (5000.0, MAX_COST), (math.inf, MAX_COST)]
)
def test_costs_travel_in_sixteenths_and_saturate(cost: float, sent: float) -> None:
    assert wire_cost(cost) == sent == decode(encode(replace(MESSAGE, cost=cost), DEMO_KEY), DEMO_KEY).cost


@pytest.mark.parametrize(("speed", "sent"), [(1.0, 1.0), (0.1, 0.125), (99.0, MAX_SPEED_CELLS_S)])
def test_speeds_travel_in_sixteenths_and_saturate(speed: float, sent: float) -> None:
    assert wire_speed(speed) == sent
    assert decode(encode(replace(MESSAGE, speed_cells_s=speed), DEMO_KEY), DEMO_KEY).speed_cells_s == sent


def test_a_restarted_sender_starts_above_all_that_it_used() -> None:
    run_s = 3600
    last_used = first_seq(YEAR_2027_NS) + run_s * MAX_MESSAGES_PER_S - 1
    assert first_seq(YEAR_2027_NS + run_s * NS_PER_S) > last_used


def test_a_stored_sequence_heals_a_clock_that_went_back() -> None:
    used = first_seq(YEAR_2027_NS)
    assert first_seq(YEAR_2027_NS - 3600 * NS_PER_S, last_used=used) == used + 1
    assert first_seq(0, last_used=used) == used + 1


def test_a_robot_without_the_time_is_told_to_set_its_clock() -> None:
    with pytest.raises(ConfigError, match="before 2026: set it"):
        first_seq(0)


@pytest.mark.parametrize(("day_unix_s", "fits"), [(2_196_633_600, True), (2_196_806_400, False)])
def test_sequences_last_until_august_2039(day_unix_s: int, fits: bool) -> None:
    if fits:
        assert first_seq(day_unix_s * NS_PER_S) < 1 << 32
    else:
        with pytest.raises(ConfigError, match="correct the clock"):
            first_seq(day_unix_s * NS_PER_S)
