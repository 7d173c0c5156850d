"""The whole team in one process: agents, radio, bridge, autopilots and physics on one virtual clock.

The composition root of the simulator, and the only file of it that knows the bridge. Nothing here sleeps: the caller
advances the time, as fast as it likes (lock-step) or with the wall clock (real time).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Literal, Protocol

from gatar_edge.bridge.driver import DriverConfig, VehicleDriver
from gatar_edge.bridge.geo import cell_to_wgs84
from gatar_edge.sim_sitl.autopilot import AutopilotConfig, SimAutopilot
from gatar_edge.sim_sitl.faulty_link import FaultyLink, LinkFaults
from gatar_edge.sim_sitl.radio import Radio, RadioConfig

from gatar_edge.agent import Agent, Identity, Inbox
from gatar_edge.allocators.base import Allocator
from gatar_edge.config import AgentConfig
from gatar_edge.keys import DEMO_KEY
from gatar_edge.sim_sitl.tally import Result, Tally
from gatar_edge.sim_sitl.world import World, observe
from gatar_edge.types import (
    NS_PER_S,
    ByteGrid,
    Cell,
    Decision,
    GridSpec,
    Observation,
    RobotKind,
    VehicleCommand,
    VehicleState,
)

StackName = Literal["ardupilot", "px4"]
PUMPS = 8  # exchanges between driver and autopilot within one instant, at most


@dataclass(frozen=True, slots=True)
class FleetConfig:
    """One simulated mission."""

    world: World
    agent: AgentConfig
    radio: RadioConfig
    stacks: tuple[StackName, ...]  # by robot index
    telemetry: LinkFaults = field(default_factory=LinkFaults)
    speed_m_s: float = 5.0
    altitude_m: float = 15.0
    altitude_step_m: float = 2.0  # every UAV has its own layer
    physics_s: float = 0.1
    tick_s: float = 0.5
    launch_timeout_s: float = 120.0
    max_steps: int = 500
    kills: tuple[tuple[int, float], ...] = ()  # (robot id, step at which its companion and vehicle die)

    @property
    def step_ns(self) -> int:
        """A step: the time in which a robot at cruise speed crosses one cell."""
        return int(self.agent.grid.cell_m / self.speed_m_s * NS_PER_S)


class Log(Protocol):
    """What the fleet tells a recorder; see `gatar_edge.record.Recorder`."""

    def observation(self, observation: Observation, now_ns: int) -> None: ...
    def heard(self, robot_id: int, datagram: bytes, outcome: str, now_ns: int) -> None: ...
    def sent(self, robot_id: int, datagram: bytes, now_ns: int) -> None: ...
    def decision(self, decision: Decision, wanted: VehicleCommand, sent: VehicleCommand, now_ns: int) -> None: ...
    def vehicle(self, robot_id: int, state: VehicleState, now_ns: int) -> None: ...
    def mavlink(self, robot_id: int, direction: Literal["rx", "tx"], frame: bytes, now_ns: int) -> None: ...
    def belief(self, robot_id: int, belief: ByteGrid, grid: GridSpec, now_ns: int) -> None: ...
    def text(self, level: str, robot_id: int, text: str, now_ns: int) -> None: ...
    def poll(self, now_ns: int) -> None: ...


class Robot:
    """One robot of the fleet: its mind, its bridge, its autopilot, and the wire between the last two."""

    def __init__(self, index: int, config: FleetConfig, allocator: Allocator, now_ns: int) -> None:
        self.robot_id = index + 1
        self.kind = config.world.team.kinds[index]
        self.start = config.world.starts[index]
        self._grid = config.agent.grid
        lat_deg, lon_deg = cell_to_wgs84(self._grid, self.start)
        speed_cells_s = config.speed_m_s / self._grid.cell_m
        self.agent = Agent(Identity(self.robot_id, self.kind, speed_cells_s), config.agent, allocator, DEMO_KEY)
        self.driver = VehicleDriver(
            DriverConfig(
                robot_id=self.robot_id,
                kind=self.kind,
                grid=self._grid,
                sysid=self.robot_id,
                altitude_m=config.altitude_m + index * config.altitude_step_m,
                speed_m_s=config.speed_m_s,
            ),
            now_ns,
        )
        self.autopilot = SimAutopilot(
            AutopilotConfig(
                sysid=self.robot_id,
                vehicle="copter" if self.kind is RobotKind.UAV else "rover",
                stack=config.stacks[index],
                home_lat_deg=lat_deg,
                home_lon_deg=lon_deg,
                seed=config.world.seed * 64 + index,
                speed_m_s=config.speed_m_s,
            ),
            now_ns,
            blocked=self._obstacle_map(config.world) if self.kind is RobotKind.UGV else None,
        )
        self.up = FaultyLink(config.telemetry, seed=config.world.seed * 128 + 2 * index)
        self.down = FaultyLink(config.telemetry, seed=config.world.seed * 128 + 2 * index + 1)
        self.alive = True
        self.travelled_m = 0.0

    def advance(self, now_ns: int, log: Log | None) -> None:
        """Physics up to now, then let companion and autopilot talk until they have nothing more to say."""
        before = self.autopilot.truth
        self.autopilot.step(now_ns)
        after = self.autopilot.truth
        self.travelled_m += math.hypot(after.east_m - before.east_m, after.north_m - before.north_m)
        for _ in range(PUMPS):
            self.down.send(self.autopilot.take(), now_ns)
            self.up.send(self.driver.poll(now_ns), now_ns)
            arrived = [*self.down.deliver(now_ns)]
            obeyed = [*self.up.deliver(now_ns)]
            for data in arrived:
                self.driver.receive(data, now_ns)
            for data in obeyed:
                self.autopilot.receive(data, now_ns)
            if not arrived and not obeyed:
                break
        if log is not None:
            for direction, frame in self.driver.frames():
                log.mavlink(self.robot_id, direction, frame, now_ns)
            for event in self.driver.events():
                log.text("info", self.robot_id, event.text, event.t_ns)

    @property
    def cell(self) -> Cell:
        """Where the robot really is."""
        truth, cell_m = self.autopilot.truth, self._grid.cell_m
        angle = math.radians(self._grid.heading_deg)
        x_m = truth.east_m * math.cos(angle) - truth.north_m * math.sin(angle)
        y_m = truth.east_m * math.sin(angle) + truth.north_m * math.cos(angle)
        x = self.start[0] + math.floor(x_m / cell_m + 0.5)
        y = self.start[1] + math.floor(y_m / cell_m + 0.5)
        return min(max(x, 0), self._grid.width - 1), min(max(y, 0), self._grid.height - 1)

    def _obstacle_map(self, world: World) -> Callable[[float, float], bool]:
        angle = math.radians(self._grid.heading_deg)

        def blocked(east_m: float, north_m: float) -> bool:
            x_m = east_m * math.cos(angle) - north_m * math.sin(angle)
            y_m = east_m * math.sin(angle) + north_m * math.cos(angle)
            x = self.start[0] + math.floor(x_m / self._grid.cell_m + 0.5)
            y = self.start[1] + math.floor(y_m / self._grid.cell_m + 0.5)
            inside = 0 <= x < world.shape[0] and 0 <= y < world.shape[1]
            return not inside or bool(world.obstacles[x, y])

        return blocked


class Fleet:
    """All robots of a mission. Call `advance` with rising times; then read `tally`."""

    def __init__(self, config: FleetConfig, allocator: Callable[[], Allocator], log: Log | None = None) -> None:
        self.config = config
        self.log = log
        self.robots = [Robot(index, config, allocator(), 0) for index in range(len(config.world.team.kinds))]
        self.radio = Radio(config.radio)
        self.tally = Tally(config.world, self.robots[0].agent.allocator.name)
        self.began_ns: int | None = None  # when the launch was over
        self._by_id = {robot.robot_id: robot for robot in self.robots}
        self._next_tick_ns = 0
        self._launch_m: dict[int, float] = {}

    @property
    def over(self) -> bool:
        """Nothing left to localize, or out of time."""
        return self.began_ns is not None and (self.tally.left == 0 or self.step >= self.config.max_steps)

    @property
    def step(self) -> float:
        """The mission's time in steps."""
        return 0.0 if self.began_ns is None else (self._now_ns - self.began_ns) / self.config.step_ns

    def advance(self, now_ns: int) -> None:
        """Let the world go on up to `now_ns`; the minds tick when their time has come."""
        self._now_ns = now_ns
        for robot in self.robots:
            if robot.alive:
                robot.advance(now_ns, self.log)
        if self.began_ns is None and self._launched(now_ns):
            self.began_ns = self._next_tick_ns = now_ns
            self._launch_m = {robot.robot_id: robot.travelled_m for robot in self.robots}
        if self.began_ns is not None:
            self._die()
            self._deliver(now_ns)
            if now_ns >= self._next_tick_ns:
                self._next_tick_ns += int(self.config.tick_s * NS_PER_S)
                self._tick(now_ns)
        if self.log is not None:
            self.log.poll(now_ns)

    def result(self) -> Result:
        """The mission's figures."""
        for robot in self.robots:
            flown_m = robot.travelled_m - self._launch_m.get(robot.robot_id, 0.0)
            self.tally.distance[robot.kind.name] += flown_m / self.config.agent.grid.cell_m
        return self.tally.result(self.step)

    def _launched(self, now_ns: int) -> bool:
        ready = all(robot.driver.state(now_ns).ready for robot in self.robots)
        return ready or now_ns >= self.config.launch_timeout_s * NS_PER_S

    def _die(self) -> None:
        for robot_id, step in self.config.kills:
            robot = self._by_id.get(robot_id)
            if robot is not None and robot.alive and self.step >= step:
                robot.alive = False
                if self.log is not None:
                    self.log.text("warning", robot_id, "killed by the scenario", self._now_ns)

    def _positions(self) -> dict[int, Cell]:
        return {robot.robot_id: robot.cell for robot in self.robots if robot.alive}

    def _deliver(self, now_ns: int) -> None:
        """Everything that is due on the air, relays at once."""
        positions = self._positions()
        while deliveries := self.radio.deliver(now_ns):
            for receiver, datagram in deliveries:
                robot = self._by_id[receiver]
                if not robot.alive:
                    continue
                heard = robot.agent.hear(datagram, now_ns)
                if self.log is not None:
                    self.log.heard(receiver, datagram, heard.outcome.value, now_ns)
                if heard.relay is not None:
                    self._send(robot, heard.relay, positions, now_ns)

    def _send(self, robot: Robot, datagram: bytes, positions: dict[int, Cell], now_ns: int) -> None:
        self.tally.sent(datagram)
        self.radio.send(now_ns, robot.robot_id, datagram, positions)
        if self.log is not None:
            self.log.sent(robot.robot_id, datagram, now_ns)

    def _tick(self, now_ns: int) -> None:
        """One tick of every mind."""
        positions = self._positions()
        decisions = []
        for robot in self.robots:
            if not robot.alive:
                continue
            self.tally.visit(robot.cell, self.step)
            seen = observe(self.config.world, robot.robot_id, robot.cell, self.config.agent.r_sense, now_ns)
            start_ns = time.perf_counter_ns()
            out = robot.agent.tick(now_ns, Inbox(seen))
            latency_ns = time.perf_counter_ns() - start_ns
            sent = robot.driver.command(out.command, now_ns)
            self.tally.decided(out.decision, latency_ns)
            decisions.append(out.decision)
            self._send(robot, out.message, positions, now_ns)
            if self.log is not None:
                self._record(robot, seen, out.decision, (out.command, sent), now_ns)
        self.tally.decided_together(decisions)

    def _record(
        self,
        robot: Robot,
        seen: Observation,
        decision: Decision,
        commands: tuple[VehicleCommand, VehicleCommand],
        now_ns: int,
    ) -> None:
        assert self.log is not None
        self.log.observation(seen, now_ns)
        self.log.decision(decision, commands[0], commands[1], now_ns)
        self.log.vehicle(robot.robot_id, robot.driver.state(now_ns), now_ns)
        self.log.belief(robot.robot_id, robot.agent.belief, self.config.agent.grid, now_ns)


def lock_step(fleet: Fleet) -> Iterator[int]:
    """Fly the mission in virtual time, as fast as the machine can; yields the time after each slice of physics."""
    slice_ns = int(fleet.config.physics_s * NS_PER_S)
    now_ns = 0
    while not fleet.over:
        fleet.advance(now_ns)
        yield now_ns
        now_ns += slice_ns
