"""A log in several files: each complete, none overwritten, and a full disk at the turn ends only the log."""

from __future__ import annotations

from pathlib import Path

import pytest
from mcap.reader import make_reader

from gatar_edge.agent import Identity
from gatar_edge.config import AgentConfig
from gatar_edge.errors import LogError
from gatar_edge.foxglove import Level
from gatar_edge.record import Recorder
from gatar_edge.rotate import RotatingLog
from gatar_edge.runinfo import describe_run
from gatar_edge.types import NS_PER_S, RobotKind

INFO = describe_run(AgentConfig(), [Identity(1, RobotKind.UAV, 1.0)], "greedy")


def lines(path: Path) -> int:
    with path.open("rb") as file:
        return sum(1 for _ in make_reader(file).iter_messages(topics=["/log"]))


def test_each_period_has_a_complete_file_and_no_line_is_lost(tmp_path: Path) -> None:
    def open_file(now_ns: int) -> Recorder:
        return Recorder(tmp_path / f"{now_ns // NS_PER_S:04d}.mcap", INFO, now_ns)

    log = RotatingLog(open_file, 60 * NS_PER_S, 0)
    for second in range(150):
        log.text(Level.INFO, 1, f"second {second}", second * NS_PER_S)
        log.poll(second * NS_PER_S)
    log.close()
    files = sorted(tmp_path.iterdir())
    assert [file.name for file in files] == ["0000.mcap", "0060.mcap", "0120.mcap"]
    assert sum(lines(file) for file in files) == 150


def test_a_file_that_cannot_be_opened_ends_the_log_and_says_so(tmp_path: Path) -> None:
    def open_file(now_ns: int) -> Recorder:
        if now_ns:
            raise LogError("log x cannot be written: No space left on device")
        return Recorder(tmp_path / "first.mcap", INFO, now_ns)

    log = RotatingLog(open_file, 60 * NS_PER_S, 0)
    log.poll(61 * NS_PER_S)
    assert "No space left" in log.stopped
    log.text(Level.INFO, 1, "unheard", 62 * NS_PER_S)
    log.poll(200 * NS_PER_S)
    log.close()
    assert lines(tmp_path / "first.mcap") == 0


def test_the_first_file_must_open(tmp_path: Path) -> None:
    with pytest.raises(LogError):
        RotatingLog(lambda now_ns: Recorder(tmp_path / "no" / "such" / "folder" / "f", INFO, now_ns), 1, 0)
