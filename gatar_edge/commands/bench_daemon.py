"""`gatar bench daemon`: memory, load and start of one daemon among twelve neighbours, and its growth over a day."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import Any

import click

START_LIMIT_S = 30.0
SETTLE_S = 5.0


@click.command("daemon")
@click.option("--allocator", default="gatar", show_default=True)
@click.option("--neighbors", type=click.IntRange(0, 63), default=12, show_default=True, help="All hear each other.")
@click.option("--seconds", type=click.FloatRange(1), default=20.0, show_default=True, help="Of measured load.")
@click.option("--flood", type=click.IntRange(0), default=0, show_default=True, help="Forged datagrams a second.")
@click.option("--hours", type=click.FloatRange(0), default=1.0, show_default=True, help="Simulated, for the growth.")
@click.option("--json", "as_json", is_flag=True, help="Print for machines.")
def command(allocator: str, neighbors: int, seconds: float, flood: int, hours: float, as_json: bool) -> None:
    """Run `gatar vehicle` as its own process with a simulated autopilot, and read its load from the system.

    start_s is from starting the process to its first decision, cpu_percent of one core, growth_mb what the process grew
    by from the first tenth to the end of the simulated hours (same loop in accelerated time, in this process).

    \b
    Example:
      gatar bench daemon --json
      gatar bench daemon --hours 24
    """
    figures: dict[str, Any] = measured_process(allocator, neighbors, seconds, flood)
    if hours:
        from gatar_edge.soak import growth_mb

        figures["growth_mb"] = round(growth_mb(allocator, neighbors, hours), 2)
        figures["growth_hours"] = hours
    if as_json:
        click.echo(json.dumps(figures))
        return
    for name, value in figures.items():
        click.echo(f"{name:<16} {value}")


def measured_process(allocator: str, neighbors: int, seconds: float, flood: int) -> dict[str, Any]:
    """Start a daemon among its neighbours and measure it for `seconds`."""
    from gatar_edge.sim_sitl.realtime import UdpSocket

    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        vehicles = stack.enter_context(closing(UdpSocket("127.0.0.1:0")))
        notify = stack.enter_context(closing(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)))
        notify.bind(str(folder / "notify"))
        ports = _free_ports(2)
        surroundings = _configured(folder, allocator, neighbors, vehicles, ports)
        turns = surroundings.turns(vehicles, ports, flood)
        start_s = time.monotonic()
        process = stack.enter_context(_daemon(folder))
        notify.settimeout(START_LIMIT_S)
        while b"READY=1" not in notify.recv(4096):
            pass
        ready_s = time.monotonic() - start_s
        _spend(turns, SETTLE_S)
        before_s = _cpu_s(process.pid)
        _spend(turns, seconds)
        used_s = _cpu_s(process.pid) - before_s
        return {
            "allocator": allocator,
            "neighbors": neighbors,
            "flood_per_s": flood,
            "start_s": round(ready_s, 2),
            "cpu_percent": round(100 * used_s / seconds, 2),
            "rss_mb": round(resident_mb(process.pid), 1),
        }


def resident_mb(pid: int | str = "self") -> float:
    """Resident memory of a process, MiB."""
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("VmRSS:"):
            return int(line.split()[1]) / 1024
    raise RuntimeError(f"process {pid} has no resident memory: it has ended")


def _configured(folder: Path, allocator: str, neighbors: int, vehicles: Any, ports: list[int]) -> Any:
    from gatar_edge.commands.init import configuration, make_key
    from gatar_edge.keys import read_key
    from gatar_edge.soak import GRID, Surroundings

    options: dict[str, object] = {
        "robot_id": 1,
        "kind": "UAV",
        "speed_m_s": 5.0,
        "cell_m": GRID.cell_m,
        "r_sense": 4.0,
        "r_comm": 6.0,
        "altitude_m": 20.0,
        "allocator": allocator,
        "url": f"udpout:127.0.0.1:{vehicles.port}",
        "listen": f"127.0.0.1:{ports[0]}",
        "peers": ["127.0.0.1:9"],  # discard
        "perception": f"127.0.0.1:{ports[1]}",
        "launch": "auto",
        "http": "",
    }
    corner, sides = (GRID.origin_lat_deg, GRID.origin_lon_deg), (GRID.width, GRID.height)
    (folder / "vehicle.toml").write_text(configuration("vehicle.toml", corner, sides, "team.key", options))
    make_key(folder / "team.key")
    return Surroundings(neighbors, read_key(folder / "team.key"))


@contextmanager
def _daemon(folder: Path) -> Iterator[subprocess.Popen[bytes]]:
    command_line = [sys.executable, "-m", "gatar_edge", "vehicle", "--config", str(folder / "vehicle.toml")]
    environment = {**os.environ, "NOTIFY_SOCKET": str(folder / "notify")}
    with (folder / "log.txt").open("wb") as log, subprocess.Popen(command_line, env=environment, stderr=log) as process:
        try:
            yield process
        finally:
            process.kill()


def _spend(turns: Iterator[None], seconds: float) -> None:
    """Play the surroundings in real time."""
    start_s = time.monotonic()
    for _ in turns:
        if time.monotonic() - start_s >= seconds:
            return


def _cpu_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _free_ports(count: int) -> list[int]:
    with ExitStack() as stack:
        sockets = [stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(count)]
        for each in sockets:
            each.bind(("127.0.0.1", 0))
        return [each.getsockname()[1] for each in sockets]
