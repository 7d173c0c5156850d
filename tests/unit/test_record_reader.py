"""Reading logs however they ended, and saving what can be read."""

from __future__ import annotations

import contextlib
import os
import random
import signal
from pathlib import Path

import pytest
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.writer import Writer
from missions import record_mission

from gatar_edge import channels as ch
from gatar_edge.errors import LogError
from gatar_edge.foxglove import Level
from gatar_edge.record import Recorder
from gatar_edge.review.container import Container
from gatar_edge.review.info import read_figures
from gatar_edge.review.reader import LogReader
from gatar_edge.review.recover import recover
from gatar_edge.review.summary import summarize
from gatar_edge.types import NS_PER_S


@pytest.fixture(scope="module")
def mission(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("log") / "mission.mcap"
    record_mission(path)
    return path.read_bytes()


def put(folder: Path, content: bytes) -> Path:
    path = folder / "x.mcap"
    path.write_bytes(content)
    return path


def read_all(path: Path) -> int:
    return sum(1 for _ in LogReader(path).messages())


def foreign(folder: Path, profile: str) -> Path:
    path = folder / "foreign.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile, "somebody else")
        writer.finish()
    return path


def test_figures_agree_with_what_was_flown(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    flown = record_mission(path)
    log = LogReader(path)
    summary = summarize(read_figures(log), log.damage, path.stat().st_size)
    result = summary["result"]
    assert result["localized"] == len(flown.visited_at)
    assert result["retasks"] == flown.retasks
    assert result["steps_100"] == (flown.steps if not flown.open_targets else None)
    assert result["decisions"] == flown.steps * len(flown.agents)
    assert summary["finished"]
    assert summary["health"]["ok"]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "is empty"),
        (b"\x89MCAP0\r\n", "no header"),
        (b"hello, this is a text file", "no MCAP file"),
        (b"\x89MCAP1\r\n" + bytes(50), "version 1"),
        (b"\x89MCAP0\r\n\x01\xff\xff\xff\xff\xff\xff\xff\xff", "corrupt"),
    ],
)
def test_what_is_no_log_is_refused_in_one_line(tmp_path: Path, content: bytes, words: str) -> None:
    with pytest.raises(LogError, match=words) as error:
        read_all(put(tmp_path, content))
    assert "\n" not in str(error.value)


def test_logs_of_others_and_of_later_formats_are_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="written by somebody else"):
        LogReader(foreign(tmp_path, "ros2"))
    with pytest.raises(LogError, match=f"format {ch.FORMAT + 1}.*update"):
        LogReader(foreign(tmp_path, f"{ch.PROFILE}-{ch.FORMAT + 1}"))


def test_a_folder_and_a_missing_file_are_refused(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "none.mcap"):
        with pytest.raises(LogError, match="cannot be read"):
            LogReader(path)


def test_a_cut_at_any_place_is_refused_or_read_to_its_end_but_never_anything_else(
    tmp_path: Path, mission: bytes
) -> None:
    rng = random.Random(5)
    for _ in range(60):
        path = put(tmp_path, mission[: rng.randrange(len(mission) - 1)])
        with contextlib.suppress(LogError):
            read_all(path)


def test_flipped_bytes_are_refused_or_harmless_but_never_anything_else(tmp_path: Path, mission: bytes) -> None:
    rng = random.Random(6)
    refused = 0
    for _ in range(80):
        content = bytearray(mission)
        content[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
        try:
            log = LogReader(put(tmp_path, bytes(content)))
            summarize(read_figures(log), log.damage, 1)
        except LogError:
            refused += 1
    assert refused > 15  # not more: half of the bytes are indices that nobody needs


def test_recovery_skips_a_damaged_chunk_and_keeps_the_rest(tmp_path: Path, mission: bytes) -> None:
    chunks = [at for at, opcode, _ in Container(put(tmp_path, mission)).records() if opcode == Opcode.CHUNK]
    content = bytearray(mission)
    content[chunks[len(chunks) // 2] + 200] ^= 0xFF
    damaged, saved = put(tmp_path, bytes(content)), tmp_path / "saved.mcap"
    with pytest.raises(LogError, match="gatar log recover"):
        read_all(damaged)
    result = recover(damaged, saved).to_json()
    whole = read_all(put(tmp_path, mission))
    assert 0.5 * whole < result["recovered"] < whole
    assert read_all(saved) == result["recovered"]
    assert 0 < result["lost_s"] < 5
    with saved.open("rb") as stream:
        summary = make_reader(stream, validate_crcs=True).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == result["recovered"]
    assert len(LogReader(saved).attachments()) == 1


def test_recovery_finds_the_next_chunk_after_a_wrong_length(tmp_path: Path, mission: bytes) -> None:
    first = mission.index(b"\x04\x00\x00\x00zstd") - 37  # a chunk's record starts so long before
    content = bytearray(mission)
    content[first + 1 : first + 9] = b"\xff" * 8
    result = recover(put(tmp_path, bytes(content)), tmp_path / "saved.mcap").to_json()
    assert result["recovered"] > 100


def test_recovering_a_sound_log_loses_nothing(tmp_path: Path, mission: bytes) -> None:
    source, saved = put(tmp_path, mission), tmp_path / "saved.mcap"
    result = recover(source, saved).to_json()
    assert (result["lost_s"], result["damage"]) == (0.0, [])
    assert [e.data for e in LogReader(source).messages()] == [e.data for e in LogReader(saved).messages()]


def test_recovery_does_not_write_over_its_source(tmp_path: Path, mission: bytes) -> None:
    path = put(tmp_path, mission)
    with pytest.raises(LogError, match="another name"):
        recover(path, path)
    assert path.read_bytes() == mission


def record_until_killed(path: Path, pipe: int) -> None:
    """Record 50 messages a second of virtual time, saying each time through `pipe` before it is recorded."""
    recorder = Recorder(path, {"robots": []}, 0)
    now_ns = 0
    while True:
        now_ns += NS_PER_S // 50
        os.write(pipe, now_ns.to_bytes(8, "little"))
        recorder.text(Level.INFO, 1, "x" * 200, now_ns)
        recorder.poll(now_ns)


@pytest.mark.slow
def test_a_kill_at_any_moment_loses_at_most_one_second(tmp_path: Path) -> None:
    rng = random.Random(7)
    for kill in range(100):
        path = tmp_path / f"{kill}.mcap"
        read, write = os.pipe()
        child = os.fork()
        if child == 0:
            try:
                os.close(read)
                record_until_killed(path, write)
            finally:
                os._exit(1)
        os.close(write)
        said = b""
        wanted = 8 * rng.randrange(60, 600)
        while len(said) < wanted:
            said += os.read(read, wanted - len(said))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        while more := os.read(read, 65536):
            said += more
        os.close(read)
        last_said_ns = int.from_bytes(said[len(said) - 8 - len(said) % 8 :][:8], "little")
        last_ns = max(entry.log_ns for entry in LogReader(path, salvage=True).messages())
        assert last_said_ns - last_ns <= NS_PER_S
        recovered = recover(path, tmp_path / "saved.mcap").to_json()
        assert recovered["lost_s"] == 1.0
        path.unlink()
