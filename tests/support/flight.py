"""A daemon with the real driver on a simulated autopilot, in memory and virtual time; the wire can be cut and heard."""

from __future__ import annotations

from collections.abc import Callable

from fake_ports import CONFIG, TICK_NS, FakeLog, FakeRadio
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from gatar_edge.agent import Agent, Identity
from gatar_edge.allocators.greedy import Greedy
from gatar_edge.bridge.driver import VehicleDriver
from gatar_edge.bridge.settings import DriverConfig
from gatar_edge.daemon import Daemon, Ports, Settings
from gatar_edge.health import Snapshot
from gatar_edge.journal import Journal
from gatar_edge.keys import DEMO_KEY
from gatar_edge.perception import Perception, encode_observation
from gatar_edge.sim_sitl.body import Body
from gatar_edge.sim_sitl.world import Team, observe, random_world
from gatar_edge.transports.budget import ByteBudget
from gatar_edge.types import NS_PER_S, RobotKind
from gatar_edge.vehicle_port import AutopilotPort

SLICE_NS = NS_PER_S // 20


class Flight:
    """One robot, one vehicle, one world. Time passes only in `fly`."""

    def __init__(
        self, team: str = "1A0G", *, launch: str = "auto", dry_run: bool = False, on_stop: str = "hold"
    ) -> None:
        kind = RobotKind.UAV if team == "1A0G" else RobotKind.UGV
        self.now_ns = 0
        self.world = random_world(Team.parse(team), 12, 15, 15, seed=3)
        self.body = Body(self.world, 0, CONFIG.grid, "ardupilot", 5.0)
        self.cut = False
        self.sent: list[bytes] = []
        self.snapshots: list[Snapshot] = []
        self.log = FakeLog()
        by_itself = launch == "auto" and not dry_run
        config = DriverConfig(1, kind, CONFIG.grid, sysid=1, speed_m_s=5.0, auto_launch=by_itself)
        self.driver = VehicleDriver(config, 0)
        journal = Journal(1)
        self.port = AutopilotPort(
            self.driver, self, journal, self.log, launch_when_armed=launch == "armed" and not dry_run
        )
        agent = Agent(Identity(1, kind, 0.5), CONFIG, Greedy(), DEMO_KEY)
        self._observations: list[bytes] = []
        eyes = _Eyes(self._take_observations)
        ports = Ports(FakeRadio(), eyes, self.port, lambda: self.now_ns, self.log, published=self.snapshots.append)
        settings = Settings(TICK_NS, dry_run=dry_run, on_stop=on_stop)  # type: ignore[arg-type]
        self.daemon = Daemon(agent, Perception(1, kind, CONFIG.grid), ByteBudget(32_768), ports, settings)

    # the wire, as the port sees it

    def receive(self) -> list[bytes]:
        data = self.body.autopilot.take()
        return [data] if data and not self.cut else []

    def send(self, data: bytes, sysid: int | None = None) -> bool:
        self.sent.append(data)
        if not self.cut:
            self.body.autopilot.receive(data, self.now_ns)
        return True

    def fly(self, seconds: float, until: Callable[[], bool] = lambda: False, step: bool = True) -> None:
        """Let time pass; without `step` the daemon hangs."""
        end_ns = self.now_ns + int(seconds * NS_PER_S)
        while self.now_ns < end_ns and not until():
            self.now_ns += SLICE_NS
            self.body.step(self.now_ns)
            if self.now_ns % TICK_NS == 0:
                seen = observe(self.world, 1, self.body.cell, 4.0, self.now_ns)
                self._observations.append(encode_observation(seen, self.now_ns))
            if step:
                self.daemon.step(self.now_ns)

    def somebody_else_sets(self, mode: int) -> None:
        """A ground station changes the mode."""
        self._ground_station(mavlink.MAV_CMD_DO_SET_MODE, 1, mode)

    def somebody_else_arms(self) -> None:
        """A ground station arms the vehicle."""
        self._ground_station(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)

    def message_ids_sent(self) -> set[tuple[int, int]]:
        """(message id, command or 0) of all frames sent since the last call."""
        parser = mavlink.MAVLink(None)
        frames = [frame for data in self.sent for frame in parser.parse_buffer(data) or []]
        self.sent.clear()
        return {(frame.get_msgId(), getattr(frame, "command", 0)) for frame in frames}

    @property
    def last(self) -> Snapshot:
        return self.snapshots[-1]

    def _ground_station(self, command: int, *params: float) -> None:
        mav = mavlink.MAVLink(None, 255, 190)
        padded = [*params, *[0.0] * (7 - len(params))]
        frame = mavlink.MAVLink_command_long_message(1, 1, command, 0, *padded).pack(mav)
        self.body.autopilot.receive(frame, self.now_ns)

    def _take_observations(self) -> list[bytes]:
        taken, self._observations = self._observations, []
        return taken


class _Eyes:
    def __init__(self, take: Callable[[], list[bytes]]) -> None:
        self.receive = take
