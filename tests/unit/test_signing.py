"""MAVLink signing, checked against pymavlink's own."""

from __future__ import annotations

from pathlib import Path

import pytest
from bridge_fake_vehicle import FakeVehicle, S, mav

from gatar_edge.bridge.codec import Codec
from gatar_edge.bridge.driver import VehicleDriver
from gatar_edge.bridge.settings import DriverConfig
from gatar_edge.bridge.signing import Signing, load_key, timestamp_of
from gatar_edge.bridge.wire import CommandLong, Heartbeat
from gatar_edge.errors import ConfigError
from gatar_edge.types import GridSpec, RobotKind

KEY = bytes(range(32))
BEAT = Heartbeat(18, 8, 0, 0, 4)
NOW = 30_000_000_000_000


def peer(key: bytes = KEY, timestamp: int = NOW) -> object:
    link = mav.MAVLink(None, srcSystem=7, srcComponent=1)
    link.robust_parsing = True
    link.signing.secret_key, link.signing.sign_outgoing = key, True
    link.signing.timestamp, link.signing.link_id = timestamp, 3
    return link


def beat(link: object) -> bytes:
    return bytes(mav.MAVLink_heartbeat_message(10, 3, 0, 0, 4, 3).pack(link))


def codec(timestamp: int = NOW) -> Codec:
    return Codec(7, 191, Signing(KEY, 5, timestamp))


@pytest.mark.parametrize("message", [BEAT, CommandLong((7, 1), 400, (1, 0, 0, 0, 0, 0, 0))])
def test_what_we_sign_is_accepted_by_pymavlink(message: object) -> None:
    ours, link = codec(), peer()
    for _ in range(3):
        (read,) = link.parse_buffer(ours.encode(message))  # type: ignore[attr-defined, arg-type]
        assert read.get_type() != "BAD_DATA"
        assert read.get_signed()
        assert read.get_link_id() == 5


def test_what_pymavlink_signs_is_accepted_by_us_and_our_clock_follows() -> None:
    ours = codec()
    assert len(ours.parse(beat(peer(timestamp=NOW + 6_000_000)))) == 1
    assert ours.signing is not None
    assert ours.signing.timestamp == NOW + 6_000_001


def test_a_replayed_frame_is_rejected() -> None:
    ours, frame = codec(), beat(peer())
    assert len(ours.parse(frame)) == 1
    assert ours.parse(frame) == []


@pytest.mark.parametrize(
    "frame",
    [
        beat(peer(key=bytes(32))),  # another key
        beat(peer(timestamp=NOW - 6_000_001)),  # more than a minute behind
        bytes(mav.MAVLink_heartbeat_message(10, 3, 0, 0, 4, 3).pack(mav.MAVLink(None, srcSystem=7, srcComponent=1))),
    ],
    ids=["wrong key", "too old", "unsigned"],
)
def test_what_is_not_authentic_or_not_new_is_rejected(frame: bytes) -> None:
    ours = codec()
    assert ours.parse(frame) == []
    assert ours.signing is not None
    assert ours.signing.rejected == 1


def test_a_forged_timestamp_does_not_lock_the_true_sender_out() -> None:
    ours, true = codec(), peer()
    assert len(ours.parse(beat(true))) == 1
    assert ours.parse(beat(peer(key=bytes(32), timestamp=NOW + 10**9))) == []
    assert len(ours.parse(beat(true))) == 1


def test_the_radio_needs_no_key() -> None:
    radio = mav.MAVLink(None, srcSystem=51, srcComponent=68)
    frame = mav.MAVLink_radio_status_message(1, 2, 3, 4, 5, 6, 7).pack(radio)
    assert len(codec().parse(frame)) == 1


def test_timestamps_rise_with_the_drivers_clock_and_never_fall() -> None:
    grid = GridSpec()
    signing = Signing(KEY, 1, NOW)
    driver = VehicleDriver(DriverConfig(1, RobotKind.UGV, grid, 7), 5 * S, signing)
    driver.poll(5 * S)
    driver.poll(6 * S)
    assert NOW + 100_000 <= signing.timestamp <= NOW + 100_100
    driver.poll(5 * S)
    assert signing.timestamp >= NOW + 100_000


def test_neither_key_nor_signatures_reach_log_or_text() -> None:
    signing = Signing(KEY, 1, NOW)
    assert KEY.hex() not in repr(signing)
    assert repr(KEY) not in repr(signing)
    driver = VehicleDriver(DriverConfig(1, RobotKind.UGV, GridSpec(), 7), 0, signing)
    sent = driver.poll(0)
    (record,) = driver.frames()
    assert len(record.raw) == len(sent) - 13
    assert sent[-6:] not in record.raw


def test_an_unsigned_vehicle_is_not_heard_where_a_key_is_set() -> None:
    driver = VehicleDriver(DriverConfig(1, RobotKind.UGV, GridSpec(), 7), 0, Signing(KEY, 1, NOW))
    driver.receive(FakeVehicle("ardupilot-rover", 7, 0.0, 0.0).poll(S, b""), S)
    assert driver.state(S).phase == "searching"


@pytest.mark.parametrize("content", [KEY, KEY.hex().encode(), KEY.hex().encode() + b"\n"])
def test_a_key_is_read_as_bytes_or_digits(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "key"
    path.write_bytes(content)
    path.chmod(0o600)
    assert load_key(path) == KEY


@pytest.mark.parametrize(
    ("content", "mode", "text"),
    [
        (KEY, 0o644, "chmod 600"),
        (KEY[:31], 0o600, "holds 31 bytes"),
        (b"g" * 64, 0o600, "64 hexadecimal digits"),
        (b"\xff" * 64, 0o600, "64 hexadecimal digits"),
    ],
)
def test_a_key_file_that_cannot_be_used_is_refused(tmp_path: Path, content: bytes, mode: int, text: str) -> None:
    path = tmp_path / "key"
    path.write_bytes(content)
    path.chmod(mode)
    with pytest.raises(ConfigError, match=text):
        load_key(path)


def test_a_missing_key_file_and_a_short_key_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="No such file"):
        load_key(tmp_path / "none")
    with pytest.raises(ConfigError, match="32 bytes"):
        Signing(b"short", 1, 0)


def test_timestamps_count_ten_microseconds_since_2015() -> None:
    assert timestamp_of(1_420_070_400 * S) == 0
    assert timestamp_of(1_420_070_401 * S) == 100_000
    assert timestamp_of(0) == 0
