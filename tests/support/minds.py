"""The daemons of a yard, one process each, on this machine or each in a network namespace of its own."""

from __future__ import annotations

import contextlib
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from gatar_edge.commands.init import configuration, make_key
from gatar_edge.sim_sitl.fleet import FleetConfig
from gatar_edge.sim_sitl.realtime import UdpSocket
from gatar_edge.sim_sitl.yard import Sockets, Yard

HOST = "127.0.0.1"


@dataclass(frozen=True)
class Place:
    """Where one daemon runs."""

    host: str
    ear: int
    eye: int
    within: Sequence[str] = field(default=())  # the command that runs another one there


class Minds:
    """Start, stop and kill daemons by robot id. `yard_host` is where the yard's sockets listen."""

    def __init__(
        self, config: FleetConfig, folder: Path, places: dict[int, Place], yard_host: str, yard_ports: tuple[int, int]
    ) -> None:
        self._folder = folder
        self._places = places
        self._running: dict[int, subprocess.Popen[bytes]] = {}
        make_key(folder / "team.key")
        for robot_id, kind in zip(config.world.team.ids, config.world.team.kinds, strict=True):
            place, grid = places[robot_id], config.agent.grid
            options: dict[str, object] = {
                "robot_id": robot_id,
                "kind": kind.name,
                "speed_m_s": config.speed_m_s,
                "cell_m": grid.cell_m,
                "r_sense": config.agent.r_sense,
                "r_comm": config.agent.r_comm,
                "altitude_m": 15.0 + 2 * robot_id,
                "allocator": "greedy",
                "url": f"udpout:{yard_host}:{yard_ports[0]}",
                "listen": f"{place.host}:{place.ear}",
                "peers": [f"{yard_host}:{yard_ports[1]}"],
                "perception": f"{place.host}:{place.eye}",
                "launch": "auto",
                "http": "",
            }
            corner, sides = (grid.origin_lat_deg, grid.origin_lon_deg), (grid.width, grid.height)
            text = configuration("r", corner, sides, "team.key", options)
            if place.host != HOST:
                text = text.replace("[perception]", "[perception]\nallow_remote = true")
            (folder / f"robot{robot_id}.toml").write_text(text)

    def start(self, robot_id: int) -> None:
        with (self._folder / f"robot{robot_id}.txt").open("ab") as log:
            path = self._folder / f"robot{robot_id}.toml"
            command_line = [sys.executable, "-m", "gatar_edge", "vehicle", "--config", str(path)]
            within = self._places[robot_id].within
            self._running[robot_id] = subprocess.Popen([*within, *command_line], stderr=log)

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


def yard_of(config: FleetConfig, places: dict[int, Place], vehicles: UdpSocket, radio: UdpSocket) -> Yard:
    """The simulator's side of daemons at `places`."""
    eyes = {robot_id: (place.host, place.eye) for robot_id, place in places.items()}
    ears = {robot_id: (place.host, place.ear) for robot_id, place in places.items()}
    return Yard(config, Sockets(vehicles, radio, eyes, ears))


def fly(yard: Yard, times: Iterator[int], limit_s: float, until: Callable[[], bool]) -> None:
    """Let the world go on until something is so; no longer than `limit_s` of its own time."""
    for now_ns in times:
        yard.advance(now_ns)
        if until():
            return
        assert now_ns < limit_s * 1e9, f"{yard.tally.left} targets are left"


def free_ports(count: int) -> list[int]:
    """Ports that nobody listens on."""
    with contextlib.ExitStack() as stack:
        sockets = [stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(count)]
        for each in sockets:
            each.bind((HOST, 0))
        return [each.getsockname()[1] for each in sockets]
