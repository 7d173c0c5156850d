"""A daemon's surroundings for measurements: a vehicle, perception, and neighbours that all hear each other.

`Surroundings.turns` plays them on sockets in real time; `growth_mb` runs the daemon's loop among them in accelerated
time and tells what it grew by.
"""

from __future__ import annotations

import gc
import socket
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from gatar_edge.agent import Agent, Identity
from gatar_edge.allocators.greedy import Greedy
from gatar_edge.allocators.registry import make
from gatar_edge.bridge.driver import VehicleDriver
from gatar_edge.bridge.settings import DriverConfig
from gatar_edge.config import AgentConfig
from gatar_edge.daemon import Daemon, Settings
from gatar_edge.journal import Journal
from gatar_edge.keys import DEMO_KEY
from gatar_edge.message import first_seq, with_hops
from gatar_edge.perception import Perception, encode_observation
from gatar_edge.ports import Ports
from gatar_edge.record import Recorder
from gatar_edge.record_items import carried_state
from gatar_edge.rotate import Ring, RotatingLog
from gatar_edge.runinfo import describe_run
from gatar_edge.sim_sitl.body import Body
from gatar_edge.sim_sitl.world import Team, observe, random_world
from gatar_edge.transports.base import LinkCounters
from gatar_edge.transports.budget import ByteBudget
from gatar_edge.types import NS_PER_S, GridSpec, RobotKind
from gatar_edge.vehicle_port import AutopilotPort

GRID = GridSpec()
TICK_NS = NS_PER_S // 5
HOUR_TICKS = 3600 * 5
SPEED_CELLS_S = 0.5


class Surroundings:
    """Robot 1's vehicle and eyes, and neighbours 2, 3, ... in a cluster round the middle that relay all they hear."""

    def __init__(self, neighbors: int, key: bytes = DEMO_KEY) -> None:
        config = AgentConfig(grid=GRID)
        self.world = random_world(Team.parse("1A0G"), 24, GRID.width, GRID.height, seed=1)
        self.body = Body(self.world, 0, GRID, "ardupilot", SPEED_CELLS_S * GRID.cell_m)
        self._key = key
        self._crowd = []
        for number in range(neighbors):
            identity = Identity(2 + number, RobotKind(number % 2), SPEED_CELLS_S)
            agent = Agent(identity, config, Greedy(), key, first_seq(time.time_ns()))
            seen = observe(self.world, 1, (5 + number % 4, 5 + number // 4), config.r_sense, 0)
            agent.observe(seen)
            self._crowd.append(agent)

    def messages(self, now_ns: int, relays: int) -> list[bytes]:
        """What reaches robot 1 in one tick: each neighbour's message from itself and `relays` times passed on."""
        own = [agent.beacon(now_ns) for agent in self._crowd]
        passed_on = [with_hops(message, 1, self._key) for message in own]
        return own + passed_on * relays

    def observation(self, now_ns: int) -> bytes:
        """What robot 1 sees."""
        return encode_observation(observe(self.world, 1, self.body.cell, 4.0, now_ns), now_ns)

    def turns(self, vehicles: Any, ports: Sequence[int], flood_per_s: int) -> Iterator[None]:
        """Play on sockets in real time, a twentieth of a second a turn. `ports`: where robot 1 hears, and looks."""
        start_s = time.monotonic()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            turn = 0
            while True:
                now_ns = turn * NS_PER_S // 20
                for data, _ in vehicles.receive():
                    self.body.autopilot.receive(data, now_ns)
                self.body.step(now_ns)
                vehicles.send(self.body.autopilot.take())
                due = [bytes(119) + turn.to_bytes(8, "big")] * (flood_per_s // 20)
                if turn % 4 == 0:
                    due += self.messages(now_ns, relays=len(self._crowd) - 1)
                    sender.sendto(self.observation(now_ns), ("127.0.0.1", ports[1]))
                for data in due:
                    sender.sendto(data, ("127.0.0.1", ports[0]))
                turn += 1
                yield
                time.sleep(max(0.0, start_s + turn / 20 - time.monotonic()))


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
        self._surroundings = Surroundings(neighbors)
        self._air, self._eyes, self._wire = _Air(), _Air(), _Wire(self._surroundings.body)
        config = AgentConfig(grid=GRID)
        identity = Identity(1, RobotKind.UAV, SPEED_CELLS_S)
        info = describe_run(config, [identity], allocator)
        self.log = RotatingLog(lambda now_ns: _replacing(folder, info, now_ns), Ring(HOUR_TICKS * TICK_NS), 0)
        driver = VehicleDriver(DriverConfig(1, RobotKind.UAV, GRID, sysid=1, speed_m_s=5.0), 0)
        vehicle = AutopilotPort(driver, self._wire, Journal(1, self.log), self.log, launch_when_armed=False)
        ports = Ports(self._air, self._eyes, vehicle, lambda: self.now_ns, self.log)
        agent = Agent(identity, config, make(allocator)(), DEMO_KEY)
        self.daemon = Daemon(agent, Perception(1, RobotKind.UAV, GRID), ByteBudget(32_768), ports, Settings(TICK_NS))
        self.log.carry = lambda: carried_state(self.daemon.agent)

    def tick(self) -> None:
        """A fifth of a second."""
        self.now_ns += TICK_NS
        self._wire.now_ns = self.now_ns
        self._surroundings.body.step(self.now_ns)
        self._air.arrived += self._surroundings.messages(self.now_ns, relays=1)
        self._eyes.arrived.append(self._surroundings.observation(self.now_ns))
        self.daemon.step(self.now_ns)


def growth_mb(allocator: str, neighbors: int, hours: float) -> float:
    """What the process grew by between the first tenth and the end of `hours` simulated hours, MiB."""
    from gatar_edge.commands.bench_daemon import resident_mb

    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        soak = Soak(allocator, neighbors, folder)
        stack.callback(soak.log.close)
        ticks = int(hours * HOUR_TICKS)
        for _ in range(ticks // 10):
            soak.tick()
        gc.collect()
        before = resident_mb()
        for _ in range(ticks - ticks // 10):
            soak.tick()
        gc.collect()
        return resident_mb() - before


def _replacing(folder: Path, info: dict[str, Any], now_ns: int) -> Recorder:
    """The next hour's log, and the last one's end: a day of logs is not what is measured."""
    for old in folder.glob("*.mcap"):
        old.unlink()
    return Recorder(folder / f"{now_ns}.mcap", info, now_ns)
