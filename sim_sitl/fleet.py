"""The whole team in one process: agents, radio, bridge, autopilots and physics on one virtual clock.

The composition root of the simulator, and the only file of it that knows the bridge. Nothing here sleeps: the caller
advances the time, as fast as it likes (lock-step) or with the wall clock (real time).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import NamedTuple, Protocol

import msgspec

from gatar_edge.agent import Agent, Identity, Inbox, Outbox
from gatar_edge.allocators.base import Allocator
from gatar_edge.bridge.driver import VehicleDriver
from gatar_edge.bridge.settings import DriverConfig
from gatar_edge.health import Shunned
from gatar_edge.keys import DEMO_KEY
from gatar_edge.record import Recorder
from gatar_edge.separation import occupied
from gatar_edge.sim_sitl.body import Body
from gatar_edge.sim_sitl.faulty_link import End, FaultyLink
from gatar_edge.sim_sitl.fleet_config import FleetConfig
from gatar_edge.sim_sitl.fleet_log import write_beginning, write_fault, write_thought, write_wire
from gatar_edge.sim_sitl.incident_types import ClockSkew, KillCompanion
from gatar_edge.sim_sitl.incidents import Script, Turn, happen
from gatar_edge.sim_sitl.radio import Radio
from gatar_edge.sim_sitl.tally import Result, Tally
from gatar_edge.sim_sitl.world import observe
from gatar_edge.types import NS_PER_S, Cell, Decision, Observation, RobotKind, TaskKind, VehicleCommand

PUMPS = 8  # exchanges between driver and autopilot within one instant, at most


class Gateway(Protocol):
    """Where the rest of the world, such as a ground station, reaches the autopilots."""

    def send(self, data: bytes) -> None:
        """What an autopilot says."""

    def receive(self) -> list[bytes]:
        """What was said to the autopilots."""


class Robot:
    """One robot of the fleet: its mind, its bridge, its vehicle, and the wire between the last two."""

    def __init__(self, index: int, config: FleetConfig, allocator: Allocator) -> None:
        grid = config.agent.grid
        self.body = Body(config.world, index, grid, config.stacks[index], config.speed_m_s)
        self.robot_id = self.body.robot_id
        self.kind = self.body.kind
        identity = Identity(self.robot_id, self.kind, config.speed_m_s / grid.cell_m)
        self.agent = Agent(identity, config.agent, allocator, DEMO_KEY)
        self.driver = VehicleDriver(
            DriverConfig(
                robot_id=self.robot_id,
                kind=self.kind,
                grid=grid,
                sysid=self.robot_id,
                altitude_m=config.altitude_m + index * config.altitude_step_m,
                speed_m_s=config.speed_m_s,
                min_separation_m=config.min_separation_m,
            ),
            0,
        )
        self.shunned = Shunned()
        self.alive = True
        self.thinks = True  # its companion computer runs
        self.skew_ns = 0  # of the companion's clock
        seed = config.world.seed * 64 + index
        self.wire = FaultyLink(*config.faults.link_of(self.robot_id), seed=seed)

    def vehicle_speaks(self, now_ns: int, gateway: Gateway | None) -> None:
        """The autopilot says what it has to say."""
        said = self.body.autopilot.take_frames()
        if said:
            if gateway is not None:
                gateway.send(b"".join(said))
            self.wire.send_frames(now_ns, End.VEHICLE, said)

    def companion_speaks(self, now_ns: int) -> None:
        """So does the driver, where its computer runs."""
        said = self.driver.poll(now_ns) if self.thinks else b""
        if said:
            self.wire.send(now_ns, End.COMPANION, said)

    def listen(self, now_ns: int) -> bool:
        """They take in what has arrived; whether anything has."""
        arrived = self.wire.deliver(now_ns)
        for end, data in arrived:
            receiver = self.driver if end is End.COMPANION else self.body.autopilot
            receiver.receive(data, now_ns)
        return bool(arrived)

    def give_up(self, now_ns: int) -> None:
        """A goal that the vehicle refuses or does not get nearer to is left to the others for a while."""
        task = self.agent.task
        if task.kind is not TaskKind.HOLD and self.driver.cannot_go:
            self.shunned.failed(task.cell, now_ns)
        self.agent.shunned = self.shunned.cells(now_ns)

    def obey(self, wanted: VehicleCommand, seen: Observation, config: FleetConfig, now_ns: int) -> VehicleCommand:
        """Let the vehicle do what was decided; what passed the gate."""
        if self.kind is RobotKind.UGV:  # UAVs fly in layers
            heard = self.agent.neighbors.fresh(seen.t_ns, seen.cell)
            self.driver.neighbors(occupied(self.robot_id, self.kind, heard, config.agent.grid))
        return self.driver.command(wanted, now_ns)

    def suffer(self, turn: Turn, now_ns: int) -> None:
        """Something happens to this robot that nobody asked for."""
        if isinstance(turn.incident, KillCompanion):
            self.thinks = False
        elif isinstance(turn.incident, ClockSkew):
            self.skew_ns = 0 if turn.over else int(turn.incident.offset_s * NS_PER_S)
        happen(turn, self.body.autopilot, now_ns)


class Thought(NamedTuple):
    """What one robot saw and made of it, and how long that took."""

    robot: Robot
    seen: Observation
    out: Outbox
    latency_ns: int


class Fleet:
    """All robots of a mission. Call `advance` with rising times; then read `tally`."""

    def __init__(
        self,
        config: FleetConfig,
        allocator: Callable[[], Allocator],
        log: Recorder | None = None,
        gateway: Gateway | None = None,
    ) -> None:
        self.config = config
        self.log = log
        self.gateway = gateway
        self.robots = [Robot(index, config, allocator()) for index in range(len(config.world.team.kinds))]
        self.radio = Radio(config.agent.r_comm, config.faults.radio, config.world.seed, config.faults.between)
        self.tally = Tally(config.world, self.robots[0].agent.allocator.name)
        self.began_ns: int | None = None  # when the launch was over
        self._by_id = {robot.robot_id: robot for robot in self.robots}
        config.faults.check(self._by_id)
        vehicles = {robot.robot_id: robot.body.autopilot for robot in self.robots}
        self._script = Script(config.faults.incidents, vehicles)
        self.now_ns = 0
        self.ticks = 0
        self.decisions: tuple[Decision, ...] = ()  # of the last tick
        self._next_tick_ns = 0
        self._launch_m: dict[int, float] = {}

    @property
    def over(self) -> bool:
        """Nothing left to localize, or out of time."""
        return self.began_ns is not None and (self.tally.left == 0 or self.step >= self.config.max_steps)

    @property
    def step(self) -> float:
        """The mission's time in steps."""
        return 0.0 if self.began_ns is None else (self.now_ns - self.began_ns) / self.config.step_ns

    def advance(self, now_ns: int) -> None:
        """Let the world go on up to `now_ns`; the minds tick when their time has come."""
        self.now_ns = now_ns
        for data in self.gateway.receive() if self.gateway is not None else ():
            for robot in self.robots:
                robot.body.autopilot.receive(data, now_ns)
        self._exchange([robot for robot in self.robots if robot.alive], now_ns)
        if self.began_ns is None and self._launched(now_ns):
            self._begin(now_ns)
        if self.began_ns is not None:
            self._happen(now_ns - self.began_ns)
            self._deliver(now_ns)
            if now_ns >= self._next_tick_ns:
                self._next_tick_ns += int(self.config.tick_s * NS_PER_S)
                self._tick(now_ns)
        if self.log is not None:
            self.log.poll(now_ns)

    def _exchange(self, robots: list[Robot], now_ns: int) -> None:
        """Physics up to now, then let companions and autopilots talk until they have nothing more to say.

        All robots take one step together, then the next: so the code of a step stays in the processor's cache.
        """
        for robot in robots:
            robot.body.step(now_ns)
        talking = robots
        for _ in range(PUMPS):
            for robot in talking:
                robot.vehicle_speaks(now_ns, self.gateway)
            for robot in talking:
                robot.companion_speaks(now_ns)
            talking = [robot for robot in talking if robot.listen(now_ns)]
        if self.log is not None:
            for robot in robots:
                write_wire(self.log, robot)

    def result(self) -> Result:
        """The mission's figures."""
        self.tally.distance = {"UAV": 0.0, "UGV": 0.0}
        for robot in self.robots:
            flown_m = robot.body.travelled_m - self._launch_m.get(robot.robot_id, 0.0)
            self.tally.travel(robot.kind, flown_m / self.config.agent.grid.cell_m)
        return self.tally.result(self.step)

    def _launched(self, now_ns: int) -> bool:
        ready = all(robot.driver.ready(now_ns) for robot in self.robots)
        return ready or now_ns >= self.config.launch_timeout_s * NS_PER_S

    def _begin(self, now_ns: int) -> None:
        self.began_ns = self._next_tick_ns = now_ns
        if self.log is not None:
            write_beginning(self.log, self.config, now_ns)
        self._launch_m = {robot.robot_id: robot.body.travelled_m for robot in self.robots}
        self.radio.begin(now_ns)
        for robot in self.robots:
            robot.wire.begin(now_ns)

    def _happen(self, elapsed_ns: int) -> None:
        """What the scenario has in store."""
        for turn in self._script.due(elapsed_ns):
            robot = self._by_id[turn.incident.robot]
            if self.log is not None:
                details = msgspec.to_builtins(turn.incident) | {"over": turn.over}
                write_fault(self.log, robot.robot_id, turn.text, details, self.now_ns)
            robot.suffer(turn, self.now_ns)
        for robot in self.robots:
            if robot.alive and self.config.faults.killed(robot.robot_id, elapsed_ns):
                robot.alive = robot.thinks = False
                if self.log is not None:
                    write_fault(self.log, robot.robot_id, "killed by the scenario", {"do": "kill_robot"}, self.now_ns)

    def _positions(self) -> dict[int, Cell]:
        return {robot.robot_id: robot.body.cell for robot in self.robots if robot.thinks}

    def _deliver(self, now_ns: int) -> None:
        """Everything that is due on the air, relays at once."""
        positions: dict[int, Cell] | None = None  # worked out where somebody relays
        log, by_id = self.log, self._by_id
        while deliveries := self.radio.deliver(now_ns):
            relays: list[tuple[Robot, bytes]] = []
            for receiver, data in deliveries:
                robot = by_id[receiver]
                if not robot.thinks:
                    continue
                what = robot.agent.hear(data, now_ns + robot.skew_ns)
                if log is not None:
                    log.heard(receiver, data, what.outcome, now_ns + robot.skew_ns)
                if what.relay is not None:
                    relays.append((robot, what.relay))
            for robot, relay in relays:
                positions = positions or self._positions()
                self._send(robot, relay, positions, now_ns)

    def _send(self, robot: Robot, datagram: bytes, positions: dict[int, Cell], now_ns: int) -> None:
        self.tally.sent(datagram)
        self.radio.send(now_ns, robot.robot_id, datagram, positions)
        if self.log is not None:
            self.log.sent(robot.robot_id, datagram, now_ns + robot.skew_ns)

    def _tick(self, now_ns: int) -> None:
        """One tick of every mind: all think, then all command their vehicles, then all tell the others."""
        positions = self._positions()
        thoughts = [self._think(robot, now_ns) for robot in self.robots if robot.thinks]
        sent = [thought.robot.obey(thought.out.command, thought.seen, self.config, now_ns) for thought in thoughts]
        for thought, command in zip(thoughts, sent, strict=True):
            self._tell(thought, command, positions, now_ns)
        self.decisions = tuple([thought.out.decision for thought in thoughts])
        self.tally.decided_together(self.decisions)
        self.ticks += 1
        if self.log is not None:
            self.log.truth_positions(((robot.robot_id, *robot.body.xy) for robot in self.robots), now_ns)

    def _think(self, robot: Robot, now_ns: int) -> Thought:
        its_ns = now_ns + robot.skew_ns
        seen = observe(self.config.world, robot.robot_id, robot.body.cell, self.config.agent.r_sense, its_ns)
        robot.give_up(its_ns)
        robot.agent.has_vehicle = robot.driver.ready(now_ns)
        start_ns = time.perf_counter_ns()
        out = robot.agent.tick(its_ns, Inbox(seen))
        return Thought(robot, seen, out, time.perf_counter_ns() - start_ns)

    def _tell(self, thought: Thought, sent: VehicleCommand, positions: dict[int, Cell], now_ns: int) -> None:
        """Keep count of what one robot did, write it down, and let the others hear."""
        robot, seen, out, latency_ns = thought
        if self.tally.visit(seen.cell, self.step) and self.log is not None:
            self.log.truth_visit(robot.robot_id, seen.cell, self.step, now_ns)
        self.tally.decided(out.decision, latency_ns)
        if self.log is not None:
            write_thought(self.log, thought, sent, now_ns)
        for datagram in (out.message, *out.talks):
            self._send(robot, datagram, positions, now_ns)


def lock_step(fleet: Fleet) -> Iterator[int]:
    """Fly the mission in virtual time, as fast as the machine can; yields the time after each slice of physics."""
    slice_ns = int(fleet.config.physics_s * NS_PER_S)
    now_ns = 0
    while not fleet.over:
        fleet.advance(now_ns)
        yield now_ns
        now_ns += slice_ns
