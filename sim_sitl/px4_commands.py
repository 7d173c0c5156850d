"""Modes, commands and targets of PX4, as measured on its simulated multicopter and rover."""

from __future__ import annotations

import math
from dataclasses import replace

from gatar_edge.sim_sitl.core import Core
from gatar_edge.sim_sitl.modes import Does, Mode, by_name
from gatar_edge.sim_sitl.orders import COMMON, FORCE, MAX_SPEED_M_S, Handler, Order, Result, acknowledge
from gatar_edge.sim_sitl.px4_mission import Px4Runner
from gatar_edge.sim_sitl.vehicle import Goal
from gatar_edge.sim_sitl.wire import Message
from gatar_edge.types import NS_PER_S

_NAMES = {"AUTO.MISSION": "Mission", "OFFBOARD": "Offboard", "AUTO.TAKEOFF": "Takeoff", "AUTO.RTL": "Return"}
_AMSL_FRAME, _HOME_FRAME, _TERRAIN_FRAME = 5, 6, 11
_POSITION_BITS = 0x007


class Offboard:
    """The stream of position targets that OFFBOARD lives on."""

    def __init__(self) -> None:
        self.goal: Goal | None = None
        self._seen_ns = 0

    def fresh(self, core: Core) -> bool:
        """Whether targets still arrive."""
        limit_ns = core.params["COM_OF_LOSS_T"] * NS_PER_S
        return self.goal is not None and core.now_ns - self._seen_ns < limit_ns

    def receive(self, core: Core, message: Message) -> None:
        """SET_POSITION_TARGET_GLOBAL_INT: used in OFFBOARD only; without all three position bits it is no position."""
        frame = message.coordinate_frame
        if frame not in (_AMSL_FRAME, _HOME_FRAME, _TERRAIN_FRAME):
            core.text(2, f"SET_POSITION_TARGET_GLOBAL_INT invalid frame {frame}")
            return
        if message.type_mask & _POSITION_BITS or not math.isfinite(message.alt):
            return
        up = message.alt if frame == _TERRAIN_FRAME else core.up_of(message.alt, amsl=frame == _AMSL_FRAME)
        self.goal = core.place(message.lat_int / 1e7, message.lon_int / 1e7, up if core.is_copter else 0.0)
        self._seen_ns = core.now_ns
        if core.mode.does is Does.OFFBOARD:
            core.go(self.goal)

    def step(self, core: Core) -> None:
        """Leave OFFBOARD when the targets stop."""
        if core.mode.does is Does.OFFBOARD and not self.fresh(core):
            core.critical = True
            name = {3: "AUTO.RTL", 4: "AUTO.LAND"}.get(int(core.params["COM_OBL_RC_ACT"]), "AUTO.LOITER")
            core.enter(by_name(core.stack.modes, name))


def change_mode(core: Core, offboard: Offboard, mode: Mode) -> bool:
    """Whether the mode was entered; says why not."""
    runner = core.runner
    no_mission = mode.does is Does.AUTO and not (isinstance(runner, Px4Runner) and runner.available)
    no_targets = mode.does is Does.OFFBOARD and not offboard.fresh(core)
    no_position = mode.needs_position and not core.ready
    if no_mission or no_targets or no_position or (mode.does is Does.TAKEOFF and not core.is_copter):
        core.text(2, f"Switching to {_NAMES.get(mode.name, mode.name)} is currently not available")
        return False
    core.critical = False
    core.enter(mode)
    if mode.does is Does.OFFBOARD:
        core.lift = core.lift or (core.is_copter and core.landed)
        core.go(offboard.goal)
    return True


def set_mode(offboard: Offboard) -> Handler:
    """MAV_CMD_DO_SET_MODE: ACCEPTED in any case; a second acknowledgement tells whether it switched."""

    def handler(core: Core, order: Order) -> Result:
        main, sub = order.params[1], order.params[2]
        if not (0 <= main <= 255 and 0 <= sub <= 255):
            return Result.DENIED
        mode = core.stack.modes.get(int(main) << 16 | int(sub) << 24)
        if mode is None:
            return Result.DENIED
        switched = change_mode(core, offboard, mode)
        acknowledge(core, order, Result.ACCEPTED if switched else Result.TEMPORARILY_REJECTED)
        return Result.ACCEPTED

    return handler


def to_mode(offboard: Offboard, name: str) -> Handler:
    """A command that is a mode: MISSION_START, NAV_LAND, NAV_RETURN_TO_LAUNCH, NAV_LOITER_UNLIM."""

    def handler(core: Core, order: Order) -> Result:
        switched = change_mode(core, offboard, by_name(core.stack.modes, name))
        return Result.ACCEPTED if switched else Result.TEMPORARILY_REJECTED

    return handler


def arm(core: Core, order: Order) -> Result:
    """MAV_CMD_COMPONENT_ARM_DISARM: in any mode."""
    wanted, force = order.params[0], order.params[1] == FORCE
    if wanted == 0:
        if core.is_copter and not core.landed and not force:
            return Result.DENIED
        core.disarm()
        return Result.ACCEPTED
    if wanted != 1:
        return Result.UNSUPPORTED
    if not core.is_armed and not core.ready:
        core.text(2, "Arming denied: Resolve system health failures")
        return Result.TEMPORARILY_REJECTED
    core.arm()
    return Result.ACCEPTED


def take_off(offboard: Offboard) -> Handler:
    """MAV_CMD_NAV_TAKEOFF: altitude above the sea, NaN for the default one."""

    def handler(core: Core, order: Order) -> Result:
        if not core.is_copter or not change_mode(core, offboard, by_name(core.stack.modes, "AUTO.TAKEOFF")):
            return Result.TEMPORARILY_REJECTED
        if math.isfinite(order.z) and isinstance(core.nav, Goal):
            core.nav = replace(core.nav, up_m=core.up_of(order.z, amsl=True))
        return Result.ACCEPTED

    return handler


def reposition(offboard: Offboard) -> Handler:
    """MAV_CMD_DO_REPOSITION, in either form: the frame is ignored, z is above the sea, nothing is validated."""

    def handler(core: Core, order: Order) -> Result:
        speed, flags, z = order.params[0], order.params[1], order.z
        if not math.isfinite(flags) or not int(flags) & 1:
            return Result.UNSUPPORTED
        if not change_mode(core, offboard, by_name(core.stack.modes, "AUTO.LOITER")):
            return Result.TEMPORARILY_REJECTED
        if 0 < speed <= MAX_SPEED_M_S:
            core.limits = replace(core.limits, speed_m_s=speed)
        up = core.up_of(z, amsl=True) if math.isfinite(z) else core.body.up_m
        here = core.stopping_place()
        known = math.isfinite(order.lat_deg) and math.isfinite(order.lon_deg)
        goal = core.place(order.lat_deg, order.lon_deg, up) if known else replace(here, up_m=up)
        core.go(goal if core.is_copter else replace(goal, up_m=0.0))
        core.lift = core.is_copter and core.is_armed and core.landed
        return Result.ACCEPTED

    return handler


def commands(offboard: Offboard) -> dict[int, Handler]:
    """All commands of one vehicle."""
    return {
        **COMMON,
        17: to_mode(offboard, "AUTO.LOITER"),
        20: to_mode(offboard, "AUTO.RTL"),
        21: to_mode(offboard, "AUTO.LAND"),
        22: take_off(offboard),
        176: set_mode(offboard),
        192: reposition(offboard),
        300: to_mode(offboard, "AUTO.MISSION"),
        400: arm,
    }
