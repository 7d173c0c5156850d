"""Looks over a simulated mission's shoulder: what must never happen, and how fast a dead robot's target is taken over.

Everything is judged by the truth of the simulator and by the bytes that reach the vehicles, not by what robots say.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field

import numpy as np

from gatar_edge.grid import UNREACHABLE, path_lengths
from gatar_edge.sim_sitl.faulty_link import End
from gatar_edge.sim_sitl.fleet import Fleet, Robot
from gatar_edge.sim_sitl.geodesy import LocalFrame
from gatar_edge.sim_sitl.wire import Message, Wire
from gatar_edge.types import BoolGrid, Cell, Decision, GridSpec, RobotKind, TaskKind

EDGE_M = 0.1  # rounding of coordinates on the wire
_AIRBORNE_M = 5.0


@dataclass(slots=True)
class Seen:
    """What a watch has seen."""

    in_obstacle: int = 0  # UGVs, once a slice of physics
    outside_fence: list[str] = field(default_factory=list)  # commanded places
    separation_m: float = math.inf  # least between two robots in the air
    # Of each target that a dead robot leaves: ticks after its last message had expired ...
    replanned_ticks: list[int] = field(default_factory=list)  # until nobody's joint solution counts on the dead robot
    planned_ticks: list[int] = field(default_factory=list)  # until somebody's gives the target to a living robot
    taken_ticks: list[int] = field(default_factory=list)  # until somebody pursues it or has localized it
    neglected_ticks: list[int] = field(
        default_factory=list
    )  # of these, while a robot that could have gone had no target
    orphaned: int = 0  # such targets that nobody had taken over by the end


@dataclass(slots=True)
class Orphan:
    """The target of a dead robot; ticks."""

    robot_id: int
    expired: int  # when its claim has lapsed
    neglected: int = 0
    replanned: bool = False
    planned: bool = False


class Tap:
    """Looks at what one companion sends to its vehicle."""

    def __init__(self, robot_id: int, grid: GridSpec, seen: Seen) -> None:
        self._robot_id, self._grid, self._seen = robot_id, grid, seen
        self._wire = Wire(255)
        self._frame = LocalFrame(grid.origin_lat_deg, grid.origin_lon_deg)

    def __call__(self, sender: End, data: bytes) -> None:
        """See FaultyLink.tap."""
        if sender is End.COMPANION and data:
            for message in self._wire.parse(data):
                self._judge(message)

    def _judge(self, message: Message) -> None:
        name = message.get_type()
        if name in ("MISSION_ITEM_INT", "COMMAND_INT"):
            place = message.x, message.y
        elif name == "SET_POSITION_TARGET_GLOBAL_INT":
            place = message.lat_int, message.lon_int
        else:
            return
        if not self._inside(place[0] / 1e7, place[1] / 1e7):
            self._seen.outside_fence.append(f"robot {self._robot_id}: {name} to {place}")

    def _inside(self, lat_deg: float, lon_deg: float) -> bool:
        grid = self._grid
        east, north = self._frame.local(lat_deg, lon_deg)
        angle = math.radians(grid.heading_deg)
        x_m = east * math.cos(angle) - north * math.sin(angle)
        y_m = east * math.sin(angle) + north * math.cos(angle)
        sides = ((x_m, grid.width), (y_m, grid.height))
        return all(-EDGE_M <= at_m <= cells * grid.cell_m + EDGE_M for at_m, cells in sides)


class Watch:
    """Attach to a fleet before it flies; call `look` after every `advance`."""

    def __init__(self, fleet: Fleet) -> None:
        self.seen = Seen()
        self._fleet = fleet
        self._ticks = 0
        self._goals: dict[int, Cell] = {}  # by living robot
        self._orphans: dict[Cell, Orphan] = {}
        self._alive = {robot.robot_id for robot in fleet.robots}
        grid = fleet.config.agent.grid
        for robot in fleet.robots:
            robot.wire.tap = Tap(robot.robot_id, grid, self.seen)

    def look(self) -> None:
        """Judge this moment."""
        fleet = self._fleet
        obstacles = fleet.config.world.obstacles
        grounded = (robot for robot in fleet.robots if robot.kind is RobotKind.UGV)
        self.seen.in_obstacle += sum(bool(obstacles[robot.body.cell]) for robot in grounded)
        self._separation()
        self._deaths()
        if fleet.ticks > self._ticks:
            self._ticks = fleet.ticks
            self._assignments()

    def left(self) -> int:
        """Targets not yet localized that a living robot can reach."""
        open_cells = [cell for cell in map(tuple, self._fleet.config.world.targets) if not self._done(cell)]
        return sum(self._reachable(cell) for cell in open_cells)

    def finish(self) -> Seen:
        """What was seen, at the end of the mission."""
        self.seen.orphaned = sum(self._reachable(cell) and not self._done(cell) for cell in self._orphans)
        return self.seen

    def _done(self, cell: Cell) -> bool:
        return cell in self._fleet.tally.seen_from

    def _reachable(self, cell: Cell) -> bool:
        return any(robot.thinks and self._reaches(robot)[cell] for robot in self._fleet.robots)

    def _reaches(self, robot: Robot) -> BoolGrid:
        world = self._fleet.config.world
        free = np.ones(world.shape, dtype=np.bool_) if robot.kind is RobotKind.UAV else ~world.obstacles
        reached: BoolGrid = path_lengths(robot.kind, robot.body.cell, free) != UNREACHABLE
        return reached

    def _separation(self) -> None:
        if self._fleet.began_ns is None:
            return
        cell_m = self._fleet.config.agent.grid.cell_m
        bodies = [robot.body for robot in self._fleet.robots if robot.kind is RobotKind.UAV]
        places = [(*(cell_m * at for at in body.xy), body.autopilot.truth.alt_rel_m) for body in bodies]
        flying = [place for place in places if place[2] > _AIRBORNE_M]
        for one, other in itertools.combinations(flying, 2):
            self.seen.separation_m = min(self.seen.separation_m, math.dist(one, other))

    def _deaths(self) -> None:
        config = self._fleet.config
        for robot in self._fleet.robots:
            if robot.thinks or robot.robot_id not in self._alive:
                continue
            self._alive.discard(robot.robot_id)
            goal = self._goals.pop(robot.robot_id, None)
            if goal is not None and not self._done(goal) and goal not in self._goals.values():
                expiry_ticks = math.ceil(config.agent.max_age_s / config.tick_s)
                self._orphans[goal] = Orphan(robot.robot_id, self._fleet.ticks + expiry_ticks)

    def _assignments(self) -> None:
        self._goals = {
            decision.robot_id: decision.assignment.cell
            for decision in self._fleet.decisions
            if decision.assignment.kind is TaskKind.TARGET and decision.robot_id in self._alive
        }
        for cell, orphan in list(self._orphans.items()):
            late = max(0, self._fleet.ticks - orphan.expired)
            taken = cell in self._goals.values() or self._done(cell)
            if not orphan.replanned and (taken or not self._counted_on(orphan.robot_id)):
                orphan.replanned = True
                self.seen.replanned_ticks.append(late)
            if not orphan.planned and (taken or self._planned(cell)):
                orphan.planned = True
                self.seen.planned_ticks.append(late)
            if taken:
                self.seen.taken_ticks.append(late)
                self.seen.neglected_ticks.append(orphan.neglected)
                del self._orphans[cell]
            elif late:
                orphan.neglected += any(self._idle_for(cell, decision) for decision in self._fleet.decisions)

    def _counted_on(self, robot_id: int) -> bool:
        """Whether a living robot still plans with this one, be it as one that is out of range."""
        return any(
            robot.robot_id == robot_id
            for decision in self._fleet.decisions
            for robot in (*decision.robots, *decision.absent)
        )

    def _planned(self, cell: Cell) -> bool:
        """Whether the joint solution of a living robot gives the target to a living robot."""
        return any(
            choice >= 0 and decision.candidates[choice].cell == cell and robot.robot_id in self._alive
            for decision in self._fleet.decisions
            for robot, choice in zip(decision.robots, decision.choices, strict=True)
        )

    def _idle_for(self, cell: Cell, decision: Decision) -> bool:
        """Whether a robot that knows the target and can go there has none."""
        idle = decision.robot_id in self._alive and decision.robot_id not in self._goals
        return idle and any(known.cell == cell and known.length >= 0 for known in decision.candidates)
