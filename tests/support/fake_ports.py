"""A robot's surroundings in memory: radio, perception, vehicle, clock and log that a test can play with."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import Any

from gatar_edge.agent import Agent, Identity
from gatar_edge.allocators.base import Allocator
from gatar_edge.allocators.greedy import Greedy
from gatar_edge.config import AgentConfig
from gatar_edge.daemon import Daemon, Settings
from gatar_edge.driver_memory import DriverMemory
from gatar_edge.health import Snapshot
from gatar_edge.keys import DEMO_KEY
from gatar_edge.perception import Perception
from gatar_edge.persist import SavedState
from gatar_edge.ports import Ports
from gatar_edge.transports.base import LinkCounters
from gatar_edge.transports.budget import ByteBudget
from gatar_edge.types import NS_PER_S, Cell, Goto, GridSpec, Hold, RobotKind, VehicleCommand, VehicleState

TICK_NS = NS_PER_S // 5
CONFIG = AgentConfig(grid=GridSpec(width=15, height=15))


@dataclass
class FakeRadio:
    """Datagrams in, datagrams out."""

    arrived: list[bytes] = field(default_factory=list)
    sent: list[bytes] = field(default_factory=list)
    counters: LinkCounters = field(default_factory=LinkCounters)
    sends: int = 1

    def send(self, data: bytes) -> None:
        self.sent.append(data)

    def receive(self) -> list[bytes]:
        arrived, self.arrived = self.arrived, []
        return arrived

    def fileno(self) -> int:
        return -1

    def close(self) -> None:
        pass


@dataclass
class FakeVehicle:
    """Obeys at once; `connected`, `ready` and `position_age_ns` are the test's to set."""

    connected: bool = True
    ready: bool = True
    position_age_ns: int = 0
    commands: list[VehicleCommand] = field(default_factory=list)
    is_critical: bool = False
    polls: int = 0
    timer_ns: int = 0
    refuses: Cell | None = None
    sent_home: bool = False

    def receive(self, now_ns: int) -> None:
        pass

    def command(self, wanted: VehicleCommand, now_ns: int) -> VehicleCommand:
        self.commands.append(wanted)
        return wanted

    def poll(self, now_ns: int) -> None:
        self.polls += 1

    def due_ns(self, now_ns: int) -> int:
        return self.timer_ns

    def state(self, now_ns: int) -> VehicleState:
        return VehicleState(
            now_ns,
            connected=self.connected,
            ready=self.ready,
            position_t_ns=now_ns - self.position_age_ns,
            phase="ready" if self.ready else "pilot",
            cell=(0, 0),
        )

    def cell(self) -> Cell | None:
        return (0, 0)

    def critical(self, critical: bool) -> None:
        self.is_critical = critical

    def failed(self) -> bool:
        return self.refuses is not None and bool(self.commands) and self.commands[-1] == Goto(self.refuses)

    def neighbors(self, positions: tuple[Any, ...]) -> None:
        pass

    def memory(self) -> DriverMemory:
        return DriverMemory()

    def return_home(self, now_ns: int) -> bool:
        self.sent_home = True
        return True

    def holding(self, now_ns: int) -> bool:
        return bool(self.commands) and isinstance(self.commands[-1], Hold)


@dataclass
class FakeSaver:
    """Keeps states in memory."""

    states: list[SavedState] = field(default_factory=list)
    failed: int = 0
    last_error: str = ""

    def save_soon(self, state: SavedState) -> None:
        self.states.append(state)


class FakeLog:
    """Remembers each call as (method, arguments)."""

    stopped = ""

    def __init__(self) -> None:
        self.calls: list[tuple[str, tuple[Any, ...]]] = []

    def __getattr__(self, name: str) -> Any:
        return lambda *arguments: self.calls.append((name, arguments))

    def of(self, name: str) -> list[tuple[Any, ...]]:
        return [arguments for method, arguments in self.calls if method == name]


class Rig:
    """One daemon in memory. Time passes only in `run`."""

    def __init__(
        self,
        robot_id: int = 1,
        allocator: Allocator | None = None,
        start_ns: int = 1000 * NS_PER_S,
        tick_ns: int = TICK_NS,
        **settings: Any,
    ) -> None:
        self.now_ns = start_ns
        self.radio, self.vehicle, self.saver, self.log = FakeRadio(), FakeVehicle(), FakeSaver(), FakeLog()
        self.observations: list[bytes] = []
        self.snapshots: list[Snapshot] = []
        self.agent = Agent(Identity(robot_id, RobotKind.UAV, 1.0), CONFIG, allocator or Greedy(), DEMO_KEY)
        ports = Ports(
            radio=self.radio,
            perception=self,
            vehicle=self.vehicle,
            clock_ns=lambda: self.now_ns,
            log=self.log,
            saver=self.saver,
            published=lambda t_ns, snapshot: self.snapshots.append(snapshot()),
        )
        perception = Perception(robot_id, RobotKind.UAV, CONFIG.grid)
        self.daemon = Daemon(self.agent, perception, ByteBudget(32_768), ports, Settings(tick_ns, **settings))

    def receive(self) -> list[bytes]:
        arrived, self.observations = self.observations, []
        return arrived

    def see(self, cell: Cell = (0, 0), targets: list[Cell] | None = None, **more: Any) -> None:
        targets = targets if targets is not None else [(5, 5)]
        seen = [[x, y] for x in range(15) for y in range(15)]
        datagram = {"v": 1, "cell": cell, "seen": seen, "targets": targets, **more}
        self.observations.append(json.dumps(datagram).encode())

    def run(self, seconds: float, *, seeing: bool = True, step_ns: int = TICK_NS) -> None:
        end_ns = self.now_ns + int(seconds * NS_PER_S)
        while self.now_ns < end_ns:
            if seeing:
                self.see()
            self.daemon.step(self.now_ns)
            self.now_ns += step_ns

    @property
    def last(self) -> Snapshot:
        return self.snapshots[-1]
