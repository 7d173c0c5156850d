"""`gatar bench daemon`: memory, load and start of one daemon among twelve neighbours, and its growth over a day."""

from __future__ import annotations

import contextlib
import json
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from gatar_edge.commands._options import FiniteRange, anchored
from gatar_edge.errors import LinkError

if TYPE_CHECKING:
    from gatar_edge.surroundings import Surroundings, Turns

START_LIMIT_S = 120.0  # on a machine with far too much to do
SETTLE_S = 5.0
STATUS_S = 1.5  # the daemon tells one a second
SOAK_HELP = "Simulated, for the growth after the warm-up."


@click.command("daemon")
@click.option("--allocator", default="gatar", show_default=True)
@click.option("--neighbors", type=click.IntRange(0, 63), default=12, show_default=True, help="All hear each other.")
@click.option("--seconds", type=FiniteRange(1), default=20.0, show_default=True, help="Of each measured load.")
@click.option("--flood", type=click.IntRange(0), default=1000, show_default=True, help="Hostile datagrams a second.")
@click.option("--hours", type=FiniteRange(0), default=1.0, show_default=True, help=SOAK_HELP)
@click.option("--warm-up-hours", type=FiniteRange(0.2), default=2.0, show_default=True, help="Simulated, before.")
@click.option("--json", "as_json", is_flag=True, help="Print for machines.")
def command(
    allocator: str, neighbors: int, seconds: float, flood: int, hours: float, warm_up_hours: float, as_json: bool
) -> None:
    """Run `gatar vehicle` as its own process with a simulated autopilot, and read its load from the system.

    \b
    start_s            from starting the process (a second time: bytecode is written) to its first decision
    start_cpu_s        the processor time of that, which other load of the machine hardly changes
    cpu_percent        of one core, all threads and the kernel's share; 5 Hz is what it should be, and ticks_per_s
                       what it was: on a machine that is too busy it skips ticks, and cpu_ms_per_tick tells more
    flood_cpu_percent  what --flood forged, spoofed and replayed datagrams a second add to that
    flood_status       what the daemon says of itself at the end of the flood
    rss_mb             resident memory after both loads
    growth_mb          what the same loop grew by, in this process and in accelerated time, in simulated hours
                       growth_from_h to growth_to_h: a new map every ten minutes, the log on

    \b
    Example:
      gatar bench daemon --json
      gatar bench daemon --hours 22 --json
    """
    from gatar_edge.allocators.registry import make

    make(allocator)  # a daemon that refuses to start would be waited for
    figures = measured_process(allocator, neighbors, seconds, flood)
    if hours:
        figures |= _growth(allocator, neighbors, hours, warm_up_hours)
    if as_json:
        click.echo(json.dumps(figures))
        return
    for name, value in figures.items():
        click.echo(f"{name:<18} {value}")


def measured_process(allocator: str, neighbors: int, seconds: float, flood: int) -> dict[str, Any]:
    """Start a daemon among its neighbours and measure it for `seconds` of each load."""
    from gatar_edge.sim_sitl.realtime import UdpSocket
    from gatar_edge.soak import resident_mb

    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        vehicles, peer = (stack.enter_context(closing(UdpSocket("127.0.0.1:0"))) for _ in range(2))
        notify = stack.enter_context(closing(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)))
        notify.bind(str(folder / "notify"))
        notify.settimeout(START_LIMIT_S)
        ports = _free_ports(2)
        surroundings = _configured(folder, allocator, neighbors, (vehicles.port, peer.port), ports)
        turns = stack.enter_context(closing(surroundings.turns(vehicles, peer, ports)))
        with _daemon(folder):
            _first_decision(notify)
        for state in folder.glob("state-*"):  # one that goes on with a task first waits for its eyes
            state.unlink()
        start_s = time.monotonic()
        process = stack.enter_context(_daemon(folder))
        _first_decision(notify)
        figures: dict[str, Any] = {
            "allocator": allocator,
            "neighbors": neighbors,
            "measured_s": seconds,
            "start_s": round(time.monotonic() - start_s, 2),
            "start_cpu_s": round(_cpu_s(process.pid), 2),
        }
        turns.spend(SETTLE_S)
        quiet = _load(process.pid, turns, seconds)
        figures |= {"cpu_percent": round(quiet.cpu_percent, 2), "cpu_ms_per_tick": round(quiet.cpu_ms_per_tick, 2)}
        figures["ticks_per_s"] = round(quiet.ticks_per_s, 2)
        if flood:
            turns.flood_per_s = flood
            flooded = _load(process.pid, turns, seconds)
            figures["flood_per_s"] = flood
            figures["flood_cpu_percent"] = round(flooded.cpu_percent - quiet.cpu_percent, 2)
            _last_status(notify)
            turns.spend(STATUS_S)
            figures["flood_status"] = _last_status(notify)
        figures["rss_mb"] = round(resident_mb(process.pid), 1)
        return figures


def _growth(allocator: str, neighbors: int, hours: float, warm_up_hours: float) -> dict[str, Any]:
    from gatar_edge.soak import MISSIONS_PER_H, grown

    warm_up = round(warm_up_hours * MISSIONS_PER_H)
    missions = warm_up + max(1, round(hours * MISSIONS_PER_H))

    def told(done: int, size_mb: float) -> None:
        if done % MISSIONS_PER_H == 0:
            click.echo(f"{done / MISSIONS_PER_H:5.1f} of {missions / MISSIONS_PER_H:.1f} h  {size_mb:.1f} MB", err=True)

    growth = grown(allocator, neighbors, missions, warm_up, told)
    return {
        "growth_mb": round(growth.mb, 2),
        "growth_from_h": round(growth.from_h, 2),
        "growth_to_h": round(growth.to_h, 2),
        "growth_ticks": growth.ticks,
        "growth_ticks_decided": growth.decided,
        "growth_missions": growth.missions,
        "growth_cpu_s": round(growth.cpu_s),
    }


def _configured(
    folder: Path, allocator: str, neighbors: int, others: tuple[int, int], ports: list[int]
) -> Surroundings:
    """Write the daemon's configuration; `others` are the ports of its vehicle and of its peer."""
    from gatar_edge.commands.init import configuration, make_key
    from gatar_edge.keys import read_key
    from gatar_edge.surroundings import GRID, Surroundings

    options: dict[str, object] = {
        "robot_id": 1,
        "kind": "UAV",
        "speed_m_s": 5.0,
        "cell_m": GRID.cell_m,
        "r_sense": 4.0,
        "r_comm": 6.0,
        "altitude_m": 20.0,
        "allocator": anchored(allocator),
        "url": f"udpout:127.0.0.1:{others[0]}",
        "listen": f"127.0.0.1:{ports[0]}",
        "peers": [f"127.0.0.1:{others[1]}"],
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
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    environment |= {"NOTIFY_SOCKET": str(folder / "notify"), "PYTHONPYCACHEPREFIX": str(folder / "bytecode")}
    with (folder / "log.txt").open("wb") as log, subprocess.Popen(command_line, env=environment, stderr=log) as process:
        try:
            yield process
        finally:
            process.kill()


def _first_decision(notify: socket.socket) -> None:
    """Wait for it. Raises LinkError where it does not come."""
    try:
        while b"READY=1" not in notify.recv(4096):
            pass
    except TimeoutError as error:
        raise LinkError(f"the daemon decided nothing within {START_LIMIT_S:g} s: is this machine too busy?") from error


def _last_status(notify: socket.socket) -> str:
    """The latest STATUS= that waits in the socket of sd_notify, which takes a few datagrams and refuses the rest."""
    status = ""
    notify.setblocking(False)
    with contextlib.suppress(BlockingIOError):
        while True:
            for line in notify.recv(4096).decode().splitlines():
                status = line.removeprefix("STATUS=") if line.startswith("STATUS=") else status
    return status


@dataclass(frozen=True, slots=True)
class _Load:
    cpu_s: float
    ticks: int
    seconds: float

    @property
    def cpu_percent(self) -> float:
        return 100 * self.cpu_s / self.seconds

    @property
    def cpu_ms_per_tick(self) -> float:
        return 1000 * self.cpu_s / max(1, self.ticks)

    @property
    def ticks_per_s(self) -> float:
        return self.ticks / self.seconds


def _load(pid: int, turns: Turns, seconds: float) -> _Load:
    """What the process used in the next `seconds`."""
    cpu_s, ticks, start_s = _cpu_s(pid), turns.ticks, time.monotonic()
    turns.spend(seconds)
    return _Load(_cpu_s(pid) - cpu_s, turns.ticks - ticks, time.monotonic() - start_s)


def _cpu_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _free_ports(count: int) -> list[int]:
    with ExitStack() as stack:
        sockets = [stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(count)]
        for each in sockets:
            each.bind(("127.0.0.1", 0))
        return [each.getsockname()[1] for each in sockets]
