"""The daemon's loop through a day in accelerated time, among everything but sockets: does its process grow?"""

from __future__ import annotations

import gc
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gatar_edge.agent import Agent, Identity
from gatar_edge.allocators.registry import make
from gatar_edge.belief import nothing_known
from gatar_edge.bridge.driver import VehicleDriver
from gatar_edge.bridge.settings import DriverConfig
from gatar_edge.config import AgentConfig
from gatar_edge.daemon import Daemon, Settings
from gatar_edge.journal import Journal
from gatar_edge.keys import DEMO_KEY
from gatar_edge.perception import Perception
from gatar_edge.ports import Ports
from gatar_edge.record import Recorder
from gatar_edge.record_items import carried_state
from gatar_edge.rotate import Ring, RotatingLog
from gatar_edge.runinfo import describe_run
from gatar_edge.sim_sitl.body import Body
from gatar_edge.surroundings import GRID, SPEED_CELLS_S, Surroundings
from gatar_edge.transports.base import LinkCounters
from gatar_edge.transports.budget import ByteBudget
from gatar_edge.types import NS_PER_S, RobotKind
from gatar_edge.vehicle_port import AutopilotPort

TICKS_PER_S = 5
TICK_NS = NS_PER_S // TICKS_PER_S
MISSIONS_PER_H = 6  # each with a new map and targets, and a new log file
MISSION_TICKS = 3600 * TICKS_PER_S // MISSIONS_PER_H


@dataclass(frozen=True, slots=True)
class Growth:
    """How the process grew; times are simulated, and both sizes were taken just after a log file had begun."""

    mb: float  # from `from_h` to `to_h`
    from_h: float
    to_h: float
    ticks: int
    missions: int
    decided: int  # ticks in which an allocator was asked; in the rest the vehicle could not be commanded
    cpu_s: float


class _Air:
    """A `Transport` and a `ports.Source` in memory; what is sent is lost."""

    sends = 1

    def __init__(self) -> None:
        self.counters = LinkCounters()
        self.arrived: list[bytes] = []

    def send(self, data: bytes) -> None:
        self.counters.sent += 1

    def receive(self) -> list[bytes]:
        arrived, self.arrived = self.arrived, []
        return arrived

    def fileno(self) -> int:
        return -1

    def close(self) -> None:
        self.arrived.clear()


class _Wire:
    """A `vehicle_port.BytesLink` to the simulated autopilot."""

    def __init__(self, body: Body) -> None:
        self._body = body
        self.now_ns = 0

    def receive(self) -> list[bytes]:
        data = self._body.autopilot.take()
        return [data] if data else []

    def send(self, data: bytes, sysid: int | None = None) -> bool:
        self._body.autopilot.receive(data, self.now_ns)
        return True


class Soak:
    """One daemon in accelerated time, with everything that it has in flight but the sockets."""

    def __init__(self, allocator: str, neighbors: int, folder: Path) -> None:
        self.now_ns = 0
        self.ticks = 0
        self._surroundings = Surroundings(neighbors)
        self._air, self._eyes, self._wire = _Air(), _Air(), _Wire(self._surroundings.body)
        config = AgentConfig(grid=GRID)
        identity = Identity(1, RobotKind.UAV, SPEED_CELLS_S)
        info = describe_run(config, [identity], allocator)
        self.log = RotatingLog(lambda now_ns: _replacing(folder, info, now_ns), Ring(MISSION_TICKS * TICK_NS), 0)
        driver = VehicleDriver(DriverConfig(1, RobotKind.UAV, GRID, sysid=1, speed_m_s=5.0), 0)
        driver.launch()
        vehicle = AutopilotPort(driver, self._wire, Journal(1, self.log), self.log, launch_when_armed=False)
        ports = Ports(self._air, self._eyes, vehicle, lambda: self.now_ns, self.log)
        agent = Agent(identity, config, make(allocator)(), DEMO_KEY)
        self.daemon = Daemon(agent, Perception(1, RobotKind.UAV, GRID), ByteBudget(32_768), ports, Settings(TICK_NS))
        self.log.carry = lambda: carried_state(self.daemon.agent)

    def tick(self) -> None:
        """A fifth of a second; after each mission the next one."""
        if self.ticks and self.ticks % MISSION_TICKS == 0:
            self._surroundings.next_mission()
            self.daemon.agent.belief = nothing_known(GRID)
        self.ticks += 1
        self.now_ns += TICK_NS
        self._wire.now_ns = self.now_ns
        self._surroundings.body.step(self.now_ns)
        self._air.arrived += self._surroundings.messages(relays=self._surroundings.relays)
        self._eyes.arrived.append(self._surroundings.observation())
        self.daemon.step(self.now_ns)


def grown(
    allocator: str,
    neighbors: int,
    missions: int,
    warm_up: int,
    told: Callable[[int, float], None] = lambda missions, mb: None,
) -> Growth:
    """Fly missions of ten simulated minutes, and see what the process grew by after the first `warm_up` of them.

    `told` hears after each mission how many were flown, and the size of the process.
    """
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        soak = Soak(allocator, neighbors, folder)
        stack.callback(soak.log.close)
        start_s = time.process_time()
        sizes_mb = []
        for size_mb in _sizes_mb(soak, missions):
            sizes_mb.append(size_mb)
            told(len(sizes_mb), size_mb)
        counters = soak.daemon.counters
        return Growth(
            mb=sizes_mb[-1] - sizes_mb[warm_up - 1],
            from_h=warm_up / MISSIONS_PER_H,
            to_h=missions / MISSIONS_PER_H,
            ticks=counters.ticks,
            missions=missions,
            decided=counters.ticks - counters.held,
            cpu_s=time.process_time() - start_s,
        )


def resident_mb(pid: int | str = "self") -> float:
    """Resident memory of a process, MiB."""
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("VmRSS:"):
            return int(line.split()[1]) / 1024
    raise RuntimeError(f"process {pid} has no resident memory: it has ended")


def _sizes_mb(soak: Soak, missions: int) -> Iterator[float]:
    """The size of the process after each mission, in the first tick of the next log file."""
    for _ in range(missions):
        for _ in range(MISSION_TICKS):
            soak.tick()
        gc.collect()
        yield resident_mb()


def _replacing(folder: Path, info: dict[str, Any], now_ns: int) -> Recorder:
    """The next log, and the last one's end: a day of logs is not what is measured."""
    for old in folder.glob("*.mcap"):
        old.unlink()
    return Recorder(folder / f"{now_ns}.mcap", info, now_ns)
