"""A daemon with the real driver on a simulated autopilot, in memory and virtual time; the wire can be cut and heard."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from fake_ports import CONFIG, TICK_NS, FakeLog, FakeRadio, FakeSaver
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from gatar_edge.agent import Agent, Identity
from gatar_edge.allocators.greedy import Greedy
from gatar_edge.bridge.driver import VehicleDriver
from gatar_edge.bridge.geo import cell_to_wgs84, deg_e7
from gatar_edge.bridge.settings import DriverConfig
from gatar_edge.bridge.signing import Signing, timestamp_of
from gatar_edge.daemon import Daemon, Settings
from gatar_edge.driver_memory import NOTHING
from gatar_edge.health import Snapshot
from gatar_edge.journal import Journal
from gatar_edge.keys import DEMO_KEY
from gatar_edge.perception import Perception, encode_observation
from gatar_edge.persist import LoadOutcome, Restored, encode_state, load, restore
from gatar_edge.ports import Ports
from gatar_edge.sim_sitl.body import Body, StackName
from gatar_edge.sim_sitl.world import Team, observe, random_world
from gatar_edge.transports.budget import ByteBudget
from gatar_edge.types import NS_PER_S, Cell, RobotKind
from gatar_edge.vehicle_port import AutopilotPort

SLICE_NS = NS_PER_S // 20
EPOCH_NS = 1_800_000_000 * NS_PER_S  # the time of day at the start


class Flight:
    """One robot, one vehicle, one world. Time passes only in `fly`."""

    def __init__(
        self,
        team: str = "1A0G",
        *,
        launch: str = "auto",
        dry_run: bool = False,
        on_stop: str = "hold",
        stack: StackName = "ardupilot",
        key: bytes | None = None,
    ) -> None:
        self.kind = RobotKind.UAV if team == "1A0G" else RobotKind.UGV
        self.now_ns = 0
        self.world = random_world(Team.parse(team), 12, 15, 15, seed=3)
        self.body = Body(self.world, 0, CONFIG.grid, stack, 5.0)
        self.cut = False
        self.sent: list[bytes] = []
        self.snapshots: list[Snapshot] = []
        self.log = FakeLog()
        self._launch, self._key, self._observations = launch, key, list[bytes]()
        self._settings = Settings(TICK_NS, dry_run=dry_run, on_stop=on_stop)  # type: ignore[arg-type]
        if key is not None:
            long_ago = timestamp_of(EPOCH_NS - 300 * NS_PER_S)
            self._hear(mavlink.MAVLink_setup_signing_message(1, 1, list(key), long_ago))
        self.start(Restored(LoadOutcome.ABSENT))

    def start(self, restored: Restored, clock_skew_ns: int = 0) -> None:
        """A new process, which knows what its predecessor has saved."""
        self.saver = FakeSaver()
        obeyed, saved = not self._settings.dry_run, restored.state
        config = DriverConfig(
            1, self.kind, CONFIG.grid, sysid=1, speed_m_s=5.0, auto_launch=obeyed and self._launch == "auto"
        )
        signing = None
        if self._key is not None:
            told = max(timestamp_of(EPOCH_NS + self.now_ns + clock_skew_ns), restored.signing_timestamp)
            signing = Signing(self._key, 0, told)
        memory = saved.vehicle if saved is not None else NOTHING
        self.driver = VehicleDriver(config, self.now_ns, signing, memory)
        self.port = AutopilotPort(
            self.driver, self, Journal(1), self.log, launch_when_armed=obeyed and self._launch == "armed"
        )
        agent = Agent(Identity(1, self.kind, 0.5), CONFIG, Greedy(), DEMO_KEY)
        if saved is not None:
            restore(agent, saved)
        eyes, seen = _Eyes(self._take_observations), Perception(1, self.kind, CONFIG.grid)
        ports = Ports(
            radio=FakeRadio(),
            perception=eyes,
            vehicle=self.port,
            clock_ns=lambda: self.now_ns,
            log=self.log,
            saver=self.saver,
            published=lambda t_ns, snapshot: self.snapshots.append(snapshot()),
        )
        self.daemon = Daemon(agent, seen, ByteBudget(32_768), ports, self._settings)

    def saved(self, folder: Path) -> Restored:
        """What a process finds that starts now, after this one was killed."""
        path = folder / "state.bin"
        path.write_bytes(encode_state(self.saver.states[-1]))
        return load(path, 1, CONFIG, self.now_ns, 600)

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

    def somebody_else_disarms(self) -> None:
        """A ground station disarms the vehicle."""
        self._ground_station(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0)

    def somebody_else_uploads(self, *cells: Cell) -> None:
        """A ground station puts another mission on board of an ArduPilot."""
        places = [(deg_e7(lat), deg_e7(lon)) for lat, lon in (cell_to_wgs84(CONFIG.grid, cell) for cell in cells)]
        items = [
            mavlink.MAVLink_mission_item_int_message(1, 1, seq, 3, 16, 0, 1, 0, 0, 0, 0, *place, 0.0)
            for seq, place in enumerate((places[0], *places))
        ]
        for message in (mavlink.MAVLink_mission_count_message(1, 1, len(items)), *items):
            self._hear(message)
            self.fly(SLICE_NS / NS_PER_S, step=False)

    def names_sent(self) -> list[str]:
        """What kinds of messages were sent since the last call, in their order."""
        parser = mavlink.MAVLink(None)
        frames = [frame for data in self.sent for frame in parser.parse_buffer(data) or []]
        self.sent.clear()
        return [frame.get_type() for frame in frames]

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
        padded = [*params, *[0.0] * (7 - len(params))]
        self._hear(mavlink.MAVLink_command_long_message(1, 1, command, 0, *padded))

    def _hear(self, message: mavlink.MAVLink_message) -> None:
        """The autopilot gets a ground station's message, whether the daemon's wire is cut or not."""
        self.body.autopilot.receive(bytes(message.pack(mavlink.MAVLink(None, 255, 190))), self.now_ns)

    def _take_observations(self) -> list[bytes]:
        taken, self._observations = self._observations, []
        return taken


class _Eyes:
    def __init__(self, take: Callable[[], list[bytes]]) -> None:
        self.receive = take
