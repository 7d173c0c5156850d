"""A log in several files: each complete, none overwritten, and a full disk at the turn ends only the log."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from builders import observation
from mcap.reader import make_reader

from gatar_edge.agent import Agent, Identity
from gatar_edge.allocators.base import Allocation
from gatar_edge.allocators.greedy import Greedy
from gatar_edge.config import AgentConfig
from gatar_edge.errors import ConfigError, LogError
from gatar_edge.foxglove import Level
from gatar_edge.keys import DEMO_KEY
from gatar_edge.record import Recorder
from gatar_edge.record_items import carried_state
from gatar_edge.review.reader import LogReader
from gatar_edge.review.replay import Replay
from gatar_edge.rotate import Ring, RotatingLog, make_room
from gatar_edge.runinfo import describe_run
from gatar_edge.tasks import MOST_CHANGES, to_command
from gatar_edge.types import NS_PER_S, GridSpec, RobotKind
from gatar_edge.vehicle_config import parse_config
from gatar_edge.view import View

INFO = describe_run(AgentConfig(), [Identity(1, RobotKind.UAV, 1.0)], "greedy")


def lines(path: Path) -> int:
    with path.open("rb") as file:
        return sum(1 for _ in make_reader(file).iter_messages(topics=["/log"]))


def test_each_period_has_a_complete_file_and_no_line_is_lost(tmp_path: Path) -> None:
    def open_file(now_ns: int) -> Recorder:
        return Recorder(tmp_path / f"{now_ns // NS_PER_S:04d}.mcap", INFO, now_ns)

    log = RotatingLog(open_file, Ring(60 * NS_PER_S), 0)
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

    log = RotatingLog(open_file, Ring(60 * NS_PER_S), 0)
    log.poll(61 * NS_PER_S)
    assert "No space left" in log.stopped
    log.text(Level.INFO, 1, "unheard", 62 * NS_PER_S)
    log.poll(200 * NS_PER_S)
    log.close()
    assert lines(tmp_path / "first.mcap") == 0


def test_the_first_file_must_open(tmp_path: Path) -> None:
    with pytest.raises(LogError):
        RotatingLog(lambda now_ns: Recorder(tmp_path / "no" / "such" / "folder" / "f", INFO, now_ns), Ring(1), 0)


def test_a_file_ends_when_it_is_large_enough(tmp_path: Path) -> None:
    def open_file(now_ns: int) -> Recorder:
        return Recorder(tmp_path / f"{now_ns // NS_PER_S:04d}.mcap", INFO, now_ns)

    log = RotatingLog(open_file, Ring(3600 * NS_PER_S, file_bytes=200_000), 0)
    for second in range(60):
        log.text(Level.INFO, 1, os.urandom(10_000).hex(), second * NS_PER_S)
        log.poll(second * NS_PER_S)
    log.close()
    sizes = [file.stat().st_size for file in sorted(tmp_path.iterdir())]
    assert len(sizes) >= 3
    assert max(sizes) < 300_000


def write(folder: Path, name: str, size: int, written_s: int) -> None:
    (folder / name).write_bytes(bytes(size))
    os.utime(folder / name, (written_s, written_s))


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def test_the_files_written_longest_ago_are_deleted_until_another_fits_in(tmp_path: Path) -> None:
    write(tmp_path, "uav1-20260101T000000Z.mcap", 400, 30)
    write(tmp_path, "uav1-20260102T000000Z.mcap", 400, 10)  # its clock was wrong when it began
    write(tmp_path, "uav1-20260102T000000Z-1.mcap", 400, 20)
    deleted = make_room(tmp_path, "uav1", Ring(1, file_bytes=500, total_bytes=1000))
    assert deleted == ["uav1-20260102T000000Z.mcap", "uav1-20260102T000000Z-1.mcap"]
    assert names(tmp_path) == {"uav1-20260101T000000Z.mcap"}


def test_no_more_files_are_kept_than_asked_for(tmp_path: Path) -> None:
    for day in range(1, 6):
        write(tmp_path, f"uav1-2026010{day}T000000Z.mcap", 1, day)
    make_room(tmp_path, "uav1", Ring(1, files=3))
    assert names(tmp_path) == {"uav1-20260104T000000Z.mcap", "uav1-20260105T000000Z.mcap"}


def test_only_a_robots_own_logs_are_deleted(tmp_path: Path) -> None:
    others = {"uav11-20260101T000000Z.mcap", "uav1-20260101T000000Z.recovered.mcap", "uav1-merged.mcap", "notes.txt"}
    for name in others:
        write(tmp_path, name, 1000, 1)
    write(tmp_path, "uav1-20260101T000000Z.mcap", 1000, 2)
    make_room(tmp_path, "uav1", Ring(1, file_bytes=10, total_bytes=20, files=2))
    assert names(tmp_path) == others


def test_a_later_file_replays_without_those_before_it(tmp_path: Path) -> None:
    config = AgentConfig(grid=GridSpec(width=12, height=12))
    robots = [Identity(1, RobotKind.UAV, 1.0), Identity(2, RobotKind.UGV, 0.5)]
    me, other = (Agent(robot, config, Greedy(), DEMO_KEY) for robot in robots)
    info = describe_run(config, robots[:1], "greedy")

    def open_file(now_ns: int) -> Recorder:
        return Recorder(tmp_path / f"{now_ns // NS_PER_S:04d}.mcap", info, now_ns)

    log = RotatingLog(open_file, Ring(5 * NS_PER_S), 0)
    log.carry = lambda: carried_state(me)
    for second in range(10):
        now = second * NS_PER_S
        for agent, cell in ((me, (1, second)), (other, (5, 5))):
            seen = observation(cell, targets=[(6, 6), (2, 9)], t_ns=now, robot_id=agent.identity.robot_id)
            agent.observe(seen)
            if agent is me:
                log.observation(seen)
        other.decide(now)
        if second == 4:  # the last that is heard of it: remembered beyond the turn, and known again later
            last = other.beacon(now)
            log.heard(1, last, me.hear(last, now).outcome.value, now)
        elif second == 6:
            log.heard(1, last, me.hear(last, now).outcome.value, now)
        decision = me.decide(now)
        log.decision(decision, command := to_command(RobotKind.UAV, decision.assignment), command, now)
        log.sent(1, me.beacon(now), now)
        log.poll(now)
    log.close()
    files = sorted(tmp_path.iterdir())
    assert len(files) == 2
    replayed = [Replay(lambda _: Greedy()).run(LogReader(file)) for file in files]
    assert [part.differences for part in replayed] == [[], []]
    assert all(part.decisions >= 4 and part.same for part in replayed)


class Flighty(Greedy):
    """Weighs by itself what robots are doing, and wants the one of two targets now and the other then."""

    def allocate(self, view: View) -> Allocation:
        best = int(view.now_ns // NS_PER_S % 2) if len(view.targets) == 2 else 0
        choices = np.array([best], dtype=np.int32)
        return Allocation(choices, np.zeros(view.lengths.shape, dtype=np.float32), steady=True)


def test_a_later_file_knows_how_often_the_robot_has_changed_its_mind(tmp_path: Path) -> None:
    config = AgentConfig(grid=GridSpec(width=12, height=12))
    robot = Identity(1, RobotKind.UAV, 1.0)
    me = Agent(robot, config, Flighty(), DEMO_KEY)
    info = describe_run(config, [robot], "greedy")

    def open_file(now_ns: int) -> Recorder:
        return Recorder(tmp_path / f"{now_ns // NS_PER_S:04d}.mcap", info, now_ns)

    log = RotatingLog(open_file, Ring(5 * NS_PER_S), 0)
    log.carry = lambda: carried_state(me)
    goals = []
    for second in range(10):
        now = second * NS_PER_S
        seen = observation((5, 5), targets=[(2, 5), (8, 5)], t_ns=now)  # both equally near
        me.observe(seen)
        log.observation(seen)
        decision = me.decide(now)
        goals.append(decision.assignment.cell)
        log.decision(decision, command := to_command(RobotKind.UAV, decision.assignment), command, now)
        log.sent(1, me.beacon(now), now)
        log.poll(now)
    log.close()
    assert me.task.changes >= MOST_CHANGES
    assert len(set(goals[:4])) == 2
    assert len(set(goals[4:])) == 1
    for otherwise in (False, True):
        files = sorted(tmp_path.iterdir())
        replayed = [Replay(lambda _: Flighty(), otherwise=otherwise).run(LogReader(file)) for file in files]
        assert [part.differences for part in replayed] == [[], []]


def test_the_ring_must_hold_two_files() -> None:
    text = (
        '[robot]\nid = 1\nkind = "UAV"\n[grid]\norigin_lat_deg = 1.0\norigin_lon_deg = 1.0\n[net]\nkey_file = "k"\n'
        'peers = ["a:1"]\n[vehicle]\nurl = "udpin:a:1"\n[log]\nkeep_mb = 100\nrotate_mb = 64\n'
    )
    with pytest.raises(ConfigError, match="keep_mb 100 must be at least twice rotate_mb, 64"):
        parse_config(text)
