"""Flying a mission: what each item makes of the vehicle and when it is done. What happens then differs by dialect."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import replace

from gatar_edge.sim_sitl.core import Core, Phase
from gatar_edge.sim_sitl.mission_items import (
    AMSL_FRAMES,
    DELAY,
    JUMP,
    LAND,
    LOITER_TIME,
    LOITER_UNLIM,
    RTL,
    SPEED,
    TAKEOFF,
    WAYPOINT,
    Item,
)
from gatar_edge.sim_sitl.vehicle import Body, Goal, corner_speed_m_s
from gatar_edge.types import NS_PER_S

NO_MISSION, NOT_STARTED, ACTIVE, PAUSED, COMPLETE = 1, 2, 3, 4, 5  # MISSION_STATE

_ALTITUDE_REACHED_M = 0.5


class Runner(ABC):
    """Steps through the items of one vehicle's mission. `leg` is the item being flown, kept when the list changes."""

    def __init__(self, core: Core) -> None:
        self.core = core
        self.index = 0
        self.state = NO_MISSION
        self.leg: Item | None = None
        self._until_ns: int | None = None  # of a wait that has begun
        self._jumps: dict[int, int] = {}

    @abstractmethod
    def enter(self) -> None:
        """AUTO was entered."""

    @abstractmethod
    def leave(self) -> None:
        """AUTO was left."""

    @abstractmethod
    def done(self) -> None:
        """The leg is done: say so and go on."""

    @abstractmethod
    def changed(self, seq: int | None) -> None:
        """An item was stored, or the list was cut, cleared or replaced."""

    @abstractmethod
    def received(self) -> None:
        """An upload is complete."""

    @abstractmethod
    def set_current(self, seq: int) -> None:
        """MISSION_SET_CURRENT."""

    @abstractmethod
    def acceptance_m(self, item: Item) -> float:
        """How near counts as reached."""

    @property
    def items(self) -> list[Item]:
        """What is stored on the vehicle now."""
        return self.core.server.items

    def begin(self, index: int) -> None:
        """Fly item `index`, which exists."""
        self.index, self.leg, self._until_ns = index, self.items[index], None
        core, item = self.core, self.leg
        core.phase = Phase.NONE
        if item.command in (WAYPOINT, LOITER_UNLIM, LOITER_TIME):
            core.nav = self._through(item, index)
        elif item.command == TAKEOFF and core.is_copter:
            up = max(core.body.up_m, self._up(item))
            core.nav = replace(core.stopping_place(), up_m=up)
        elif item.command == LAND:
            core.nav = self._goal(item)
            core.phase = Phase.DESCEND if core.is_copter else Phase.NONE
        elif item.command == RTL:
            core.begin_return()
        elif item.command == SPEED and item.params[1] > 0:
            core.limits = replace(core.limits, speed_m_s=min(item.params[1], 30.0))

    def step(self) -> None:
        """Look whether the leg is done."""
        if self.leg is None or (self.core.is_copter and self.core.landed and not self._grounded(self.leg)):
            return
        if not self._reached(self.leg):
            return
        wait_s = self._wait_s(self.leg)
        if wait_s > 0 and self._until_ns is None:
            self._until_ns = self.core.now_ns + int(wait_s * NS_PER_S)
        if self._until_ns is None or self.core.now_ns >= self._until_ns:
            self.done()

    def following(self) -> int:
        """The index after this one, jumps obeyed; it may lie behind the end."""
        item = self.leg
        if (
            item is not None
            and item.command == JUMP
            and math.isfinite(item.params[0])
            and math.isfinite(item.params[1])
        ):
            made = self._jumps.get(self.index, 0)
            target, repeats = int(item.params[0]), int(item.params[1])
            if (repeats < 0 or made < repeats) and 0 <= target < len(self.items):
                self._jumps[self.index] = made + 1
                return target
        return self.index + 1

    def reset_jumps(self) -> None:
        """Count repeats from the start again."""
        self._jumps.clear()

    @staticmethod
    def _grounded(item: Item) -> bool:
        return item.command in (LAND, RTL, SPEED, JUMP, DELAY)

    def _up(self, item: Item) -> float:
        if not self.core.is_copter:
            return 0.0
        z = item.z if math.isfinite(item.z) else self.core.body.up_m
        return self.core.up_of(z, item.frame in AMSL_FRAMES)

    def _goal(self, item: Item) -> Goal:
        up = self._up(item)
        if item.x == 0 and item.y == 0:  # "here", as both stacks read it
            return replace(self.core.stopping_place(), up_m=up)
        return self.core.place(item.x / 1e7, item.y / 1e7, up)

    def _through(self, item: Item, index: int) -> Goal:
        goal = self._goal(item)
        after = self.items[index + 1] if index + 1 < len(self.items) else None
        if self.core.is_copter or after is None or after.command != WAYPOINT or self._wait_s(item) > 0:
            return goal
        body: Body = self.core.body
        here = Goal(body.east_m, body.north_m, 0.0)
        return replace(goal, exit_m_s=corner_speed_m_s(self.core.limits, here, goal, self._goal(after)))

    def _reached(self, item: Item) -> bool:
        core, nav = self.core, self.core.nav
        if item.command in (LAND, RTL):
            return core.landed if core.is_copter else core.phase is Phase.NONE and core.body.speed_m_s < 0.1
        if item.command == TAKEOFF:
            return not core.is_copter or not isinstance(nav, Goal) or nav.up_m - core.body.up_m < _ALTITUDE_REACHED_M
        if item.command in (WAYPOINT, LOITER_TIME, LOITER_UNLIM) and isinstance(nav, Goal):
            level = not core.is_copter or abs(nav.up_m - core.body.up_m) < max(_ALTITUDE_REACHED_M, 1.0)
            near = nav.distance_m(core.body) < self.acceptance_m(item)
            return near and level and item.command != LOITER_UNLIM
        return True

    @staticmethod
    def _wait_s(item: Item) -> float:
        seconds = item.params[0] if item.command in (WAYPOINT, LOITER_TIME, DELAY) else 0.0
        return min(seconds, 3600.0) if math.isfinite(seconds) else 0.0
