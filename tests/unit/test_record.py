"""The recorder: what it writes, in which form, and what it survives."""

from __future__ import annotations

import errno
import json
import os
from itertools import pairwise
from pathlib import Path

import pytest
from mcap.reader import make_reader
from missions import record_mission
from pymavlink.dialects.v20 import common as mavlink

from gatar_edge import channels as ch
from gatar_edge.errors import LogError
from gatar_edge.foxglove import MESSAGES, Level
from gatar_edge.mavlink_frame import without_secrets
from gatar_edge.record import Recorder
from gatar_edge.review.reader import LogReader, json_object
from gatar_edge.types import NS_PER_S, VehicleState

INFO = {"robots": [{"robot_id": 1, "kind": 0, "speed_cells_s": 1.0}]}


def all_messages(path: Path) -> list[tuple[str, str, str, bytes, int]]:
    """(topic, encoding, schema, data, log time) by mcap's own reader."""
    with path.open("rb") as stream:
        return [
            (channel.topic, channel.message_encoding, schema.name if schema else "", message.data, message.log_time)
            for schema, channel, message in make_reader(stream, validate_crcs=True).iter_messages()
        ]


@pytest.fixture(scope="module")
def mission(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("log") / "mission.mcap"
    record_mission(path)
    return path


def signed_frame(message: mavlink.MAVLink_message) -> bytes:
    link = mavlink.MAVLink(None, srcSystem=7, srcComponent=1)
    link.signing.secret_key = bytes(range(32))
    link.signing.sign_outgoing = True
    link.signing.timestamp = 1
    return bytes(message.pack(link))


def test_everything_written_is_in_the_table(mission: Path) -> None:
    for topic, encoding, schema, data, _ in all_messages(mission):
        known = ch.parse_topic(topic)
        assert known is not None, topic
        assert (encoding, schema) == (known[0].encoding.value, known[0].schema)
        if encoding == "json":
            required = ch.json_schema(known[0]).get("required", [])
            assert set(required) <= json.loads(data).keys()


def test_every_channel_has_a_schema_that_viewers_can_read() -> None:
    for channel in ch.CHANNELS:
        if channel.encoding is ch.Encoding.JSON:
            text = json.dumps(ch.json_schema(channel))
            assert ch.json_schema(channel)["type"] == "object"
            assert not {"$ref", "anyOf", "prefixItems"} & set(text.replace('"', " ").split())
        elif channel.encoding is ch.Encoding.PROTOBUF:
            assert channel.schema in MESSAGES


def test_each_topic_is_written_by_some_mission(tmp_path: Path) -> None:
    path = tmp_path / "all.mcap"
    mission = record_mission(path, close=False)
    recorder = mission.recorder
    assert recorder is not None
    now = mission.now_ns
    frame = mavlink.MAVLink_system_time_message(1, 2).pack(mavlink.MAVLink(None, 1, 1))
    recorder.mavlink(1, "rx", frame, now)
    recorder.mavlink(1, "tx", frame, now)
    recorder.vehicle(1, VehicleState(now, lat_deg=1.0, lon_deg=2.0, alt_rel_m=3.0, position_t_ns=now), now)
    recorder.text(Level.INFO, 1, "hello", now)
    recorder.fault("loss", 0, {"rate": 0.3}, now)
    recorder.result({"localized": 3}, now)
    recorder.takes_over(_state(), now)
    recorder.close()
    written = {known[0] for topic, *_ in all_messages(path) if (known := ch.parse_topic(topic)) is not None}
    assert written == set(ch.CHANNELS)


def _state() -> object:
    from gatar_edge.persist import SavedState

    return SavedState(
        robot_id=1,
        config_digest=0,
        unix_ns=0,
        next_seq=5,
        width=2,
        height=2,
        belief=bytes(4),
        task_kind=0,
        task_cell=(-1, -1),
        task_path=[],
    )


def test_log_time_never_goes_back_even_when_the_clock_does(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "a.mcap", INFO, 10 * NS_PER_S)
    recorder.text(Level.INFO, 1, "first", 12 * NS_PER_S)
    recorder.text(Level.INFO, 1, "earlier", 11 * NS_PER_S)
    recorder.poll(9 * NS_PER_S)
    recorder.close()
    times = [t for *_, t in all_messages(tmp_path / "a.mcap")]
    assert times == sorted(times)
    assert recorder.clock_steps_back == 1


def test_the_run_is_described_at_the_start_and_every_thirty_seconds(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "a.mcap", INFO, 0)
    for second in range(95):
        recorder.poll(second * NS_PER_S)
    recorder.close()
    topics = [topic for topic, *_ in all_messages(tmp_path / "a.mcap")]
    assert topics.count("/run/info") == 4
    log = LogReader(tmp_path / "a.mcap")
    (attachment,) = log.attachments()
    assert json_object(attachment.data) == log.run_info()
    assert log.metadata()[0].metadata["format"] == str(ch.FORMAT)


def test_what_viewers_latch_is_repeated_every_two_seconds(mission: Path) -> None:
    stamps = [t for topic, *_, t in all_messages(mission) if topic == "/truth/map"]
    assert max(b - a for a, b in pairwise(stamps)) <= 2 * NS_PER_S


def test_a_signature_is_taken_off_and_the_frame_stays_valid() -> None:
    message = mavlink.MAVLink_system_time_message(123456789, 42)
    kept = without_secrets(signed_frame(message))
    assert kept is not None
    (parsed,) = mavlink.MAVLink(None).parse_buffer(kept)
    assert (parsed.time_unix_usec, parsed.time_boot_ms) == (123456789, 42)
    assert not parsed.get_header().incompat_flags
    assert kept == mavlink.MAVLink_system_time_message(123456789, 42).pack(mavlink.MAVLink(None, 7, 1))


def test_the_frame_that_carries_the_key_is_never_kept(tmp_path: Path) -> None:
    secret = bytes(range(100, 132))
    frame = mavlink.MAVLink_setup_signing_message(1, 1, secret, 5).pack(mavlink.MAVLink(None, 255, 190))
    recorder = Recorder(tmp_path / "a.mcap", INFO, 0)
    recorder.mavlink(1, "tx", bytes(frame), 1)
    recorder.close()
    assert all(secret not in data for *_, data, _ in all_messages(tmp_path / "a.mcap"))
    assert all(not topic.startswith("/robot/1/mavlink") for topic, *_ in all_messages(tmp_path / "a.mcap"))


@pytest.mark.parametrize("length", [0, 1, 9, 11, 20])
def test_scraps_of_frames_are_left_out_without_complaint(length: int) -> None:
    assert without_secrets(signed_frame(mavlink.MAVLink_system_time_message(1, 2))[:length]) is None


def test_a_full_disk_stops_the_recording_and_not_the_robot(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "a.mcap"
    recorder = Recorder(path, INFO, 0)
    recorder.text(Level.INFO, 1, "before", NS_PER_S // 2)
    recorder.poll(NS_PER_S)
    write = os.write
    calls: list[int] = []

    def full(descriptor: int, data: bytes) -> int:
        calls.append(len(data))
        if len(calls) == 1:
            return write(descriptor, data[: len(data) // 2])
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("gatar_edge.logfile.os.write", full)
    for second in range(2, 30):
        recorder.text(Level.INFO, 1, "after", second * NS_PER_S)
        recorder.poll(second * NS_PER_S)
    recorder.close()
    assert "No space left on device" in recorder.stopped
    assert len([record for record in caplog.records if "stopped" in record.message]) == 1
    log = LogReader(path)
    assert [entry.channel for entry in log.messages(lambda channel, _: channel is ch.LOG)] == [ch.LOG]
    assert not log.damage.any


def test_a_place_that_cannot_be_written_is_refused_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="No such file"):
        Recorder(tmp_path / "missing" / "a.mcap", INFO, 0)


def test_datagrams_without_effect_are_counted_and_not_listed(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "a.mcap", INFO, 0)
    for _ in range(1000):
        recorder.heard(1, b"noise", "duplicate", 1)
        recorder.heard(1, b"noise", "forged", 1)
    recorder.close()
    (entry,) = LogReader(tmp_path / "a.mcap").messages(lambda channel, _: channel is ch.RADIO)
    record = json_object(entry.data)
    assert record["ignored"] == {"duplicate": 1000, "forged": 980}
    assert len(record["items"]) == 20
