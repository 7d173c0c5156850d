"""Daemons as separate processes on simulated vehicles, by the wall clock: started, killed, stopped, and replayed."""

from __future__ import annotations

import contextlib
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from gatar_edge.allocators.greedy import Greedy
from gatar_edge.commands._sim import fleet_config
from gatar_edge.commands.init import configuration, make_key
from gatar_edge.review.reader import LogReader
from gatar_edge.review.replay import Replay
from gatar_edge.sim_sitl.fleet_config import FleetConfig
from gatar_edge.sim_sitl.realtime import UdpSocket, paced
from gatar_edge.sim_sitl.yard import Sockets, Yard

SPEED = 4.0  # times real time: the daemons then tick every 0.8 simulated seconds
LIMIT_S = 120.0
HOST = "127.0.0.1"


class Minds:
    """The daemons of a yard: one process each."""

    def __init__(self, config: FleetConfig, folder: Path, vehicles: UdpSocket, radio: UdpSocket) -> None:
        self._folder = folder
        self._running: dict[int, subprocess.Popen[bytes]] = {}
        ids = config.world.team.ids
        ports = free_ports(2 * len(ids))
        self.ears = {robot_id: (HOST, ports.pop()) for robot_id in ids}
        self.eyes = {robot_id: (HOST, ports.pop()) for robot_id in ids}
        make_key(folder / "team.key")
        for robot_id, kind in zip(ids, config.world.team.kinds, strict=True):
            options: dict[str, object] = {
                "robot_id": robot_id,
                "kind": kind.name,
                "speed_m_s": config.speed_m_s,
                "cell_m": config.agent.grid.cell_m,
                "r_sense": config.agent.r_sense,
                "r_comm": config.agent.r_comm,
                "altitude_m": 15.0 + 2 * robot_id,
                "allocator": "greedy",
                "url": f"udpout:{HOST}:{vehicles.port}",
                "listen": "{}:{}".format(*self.ears[robot_id]),
                "peers": [f"{HOST}:{radio.port}"],
                "perception": "{}:{}".format(*self.eyes[robot_id]),
                "launch": "auto",
                "http": "",
            }
            grid = config.agent.grid
            corner, sides = (grid.origin_lat_deg, grid.origin_lon_deg), (grid.width, grid.height)
            (folder / f"robot{robot_id}.toml").write_text(configuration("r", corner, sides, "team.key", options))

    def start(self, robot_id: int) -> None:
        with (self._folder / f"robot{robot_id}.txt").open("ab") as log:
            path = self._folder / f"robot{robot_id}.toml"
            command_line = [sys.executable, "-m", "gatar_edge", "vehicle", "--config", str(path)]
            self._running[robot_id] = subprocess.Popen(command_line, stderr=log)

    def send(self, robot_id: int, number: signal.Signals) -> None:
        self._running[robot_id].send_signal(number)

    def kill(self, robot_id: int) -> None:
        self.send(robot_id, signal.SIGKILL)
        self._running.pop(robot_id).wait(30)

    def end(self) -> list[int]:
        """SIGTERM to all; their exit codes."""
        for process in self._running.values():
            process.terminate()
        return [process.wait(30) for process in self._running.values()]

    def said(self, robot_id: int) -> str:
        return (self._folder / f"robot{robot_id}.txt").read_text()

    def close(self) -> None:
        for process in self._running.values():
            process.kill()
            process.wait(30)


def free_ports(count: int) -> list[int]:
    with contextlib.ExitStack() as stack:
        sockets = [stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(count)]
        for each in sockets:
            each.bind((HOST, 0))
        return [each.getsockname()[1] for each in sockets]


@pytest.fixture
def team(tmp_path: Path) -> Iterator[Callable[..., tuple[Yard, Minds]]]:
    """Makes a yard and the minds of its robots, none of which runs yet."""
    with contextlib.ExitStack() as stack:

        def make(**mission: object) -> tuple[Yard, Minds]:
            config = fleet_config(**mission)  # type: ignore[arg-type]
            vehicles = stack.enter_context(contextlib.closing(UdpSocket(f"{HOST}:0")))
            radio = stack.enter_context(contextlib.closing(UdpSocket(f"{HOST}:0")))
            minds = stack.enter_context(contextlib.closing(Minds(config, tmp_path, vehicles, radio)))
            return Yard(config, Sockets(vehicles, radio, minds.eyes, minds.ears)), minds

        yield make


def fly(yard: Yard, times: Iterator[int], until: Callable[[], bool]) -> None:
    for now_ns in times:
        yard.advance(now_ns)
        if until():
            return
        assert now_ns < LIMIT_S * SPEED * 1e9, f"{yard.tally.left} targets are left"


@pytest.mark.slow
def test_a_team_of_processes_finishes_although_one_is_killed_one_stopped_and_one_late(
    team: Callable[..., tuple[Yard, Minds]], tmp_path: Path
) -> None:
    yard, minds = team(team="2A2G", seed=2, targets=16, stack="mixed", loss=0.2)
    times = paced(0.05, SPEED)
    everybody = yard.tally.left
    for robot_id in (1, 2, 3):
        minds.start(robot_id)
    fly(yard, times, until=lambda: yard.tally.left <= everybody - 3)
    minds.kill(1)
    minds.start(1)
    minds.start(4)
    minds.send(2, signal.SIGSTOP)
    fly(yard, times, until=lambda: yard.tally.left <= everybody - 8)
    minds.send(2, signal.SIGCONT)
    fly(yard, times, until=lambda: yard.over)
    assert yard.tally.left == 0
    assert minds.end() == [0, 0, 0, 0]
    assert "outcome=loaded" in minds.said(1)
    assert "stood still" in minds.said(2)
    logs = sorted((tmp_path / "logs").glob("*.mcap"))
    assert len(logs) == 5
    for log in logs:
        result = Replay(lambda _: Greedy()).run(LogReader(log))
        assert result.decisions > 0
        assert result.equal == result.decisions, (log.name, result.differences[:1])
