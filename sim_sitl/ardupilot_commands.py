"""Modes, commands and targets of ArduPilot, as measured on ArduCopter and ArduRover 4.6.2."""

from __future__ import annotations

import math
from collections.abc import Callable

from gatar_edge.sim_sitl.ardupilot_mission import ArduRunner
from gatar_edge.sim_sitl.core import Core
from gatar_edge.sim_sitl.mission_items import TAKEOFF
from gatar_edge.sim_sitl.modes import Does, by_name
from gatar_edge.sim_sitl.orders import COMMON, FORCE, Handler, Order, Result
from gatar_edge.sim_sitl.vehicle import Goal, Velocity
from gatar_edge.sim_sitl.wire import Message

AMSL_FRAMES = frozenset({0, 5})
TERRAIN_FRAMES = frozenset({10, 11})
TARGET_FRAMES = frozenset({0, 3, 5, 6, 10, 11})
# Bits of POSITION_TARGET_TYPEMASK: set means ignore.
_POSITION_BITS, _VELOCITY_BITS, _ACCELERATION_BITS, _FORCE_BIT = 0x007, 0x038, 0x1C0, 0x200
_ROVER_POSITION_BITS = 0x003  # a rover has no altitude to ignore


def change_mode(core: Core, number: int) -> bool:
    """Whether the mode was entered; says why not."""
    mode = core.stack.modes.get(number)
    if mode is None:
        core.text(4, f"No such mode {number}")
        return False
    if mode.needs_position and not core.ready:
        core.text(4, f"Mode change to {mode.name} failed: requires position")
        return False
    if mode.does is Does.AUTO:
        items = core.server.items
        if len(items) <= 1:
            core.text(4, f"Mode change to {mode.name} failed: no mission")
            return False
        if core.is_copter and core.is_armed and core.landed and items[1].command != TAKEOFF:
            core.text(4, "Auto: Missing Takeoff Cmd")
            return False
    core.enter(mode)
    return True


def _to_mode(name: str) -> Handler:
    def handler(core: Core, order: Order) -> Result:
        mode = next((mode for mode in core.stack.modes.values() if mode.name == name), None)
        if mode is None:
            return Result.UNSUPPORTED
        return Result.ACCEPTED if change_mode(core, mode.number) else Result.FAILED

    return handler


def _set_mode(core: Core, order: Order) -> Result:
    flags, number = order.params[0], order.params[1]
    if not (math.isfinite(flags) and math.isfinite(number)) or not int(flags) & 1:
        return Result.DENIED
    return Result.ACCEPTED if change_mode(core, int(number)) else Result.FAILED


def _arm(core: Core, order: Order) -> Result:
    wanted, force = order.params[0], order.params[1] == FORCE
    if wanted == 0:
        if core.is_copter and not core.landed and not force:
            return Result.FAILED
        core.disarm()
        return Result.ACCEPTED
    if wanted != 1:
        return Result.UNSUPPORTED
    if not core.is_armed:
        refusal = _why_not_armed(core)
        if refusal:
            core.text(2, refusal)
            return Result.FAILED
        core.arm()
    return Result.ACCEPTED


def _why_not_armed(core: Core) -> str:
    if not core.ready and (core.is_copter or core.mode.needs_position):
        return "Arm: Need Position Estimate"
    return "" if core.mode.armable else f"Arm: {core.mode.name} mode not armable"


def _take_off(core: Core, order: Order) -> Result:
    if not core.is_copter:
        return Result.UNSUPPORTED
    if not core.is_armed or not core.landed or core.mode.does is not Does.GUIDED or not 0 < order.z < 1000:
        return Result.FAILED
    core.lift = True
    core.go(Goal(core.body.east_m, core.body.north_m, core.up_of(order.z, amsl=False)))
    return Result.ACCEPTED


def _up_in_frame(core: Core, frame: int, z: float) -> float:
    if not core.is_copter:
        return 0.0
    if frame in TERRAIN_FRAMES:
        return -1.0  # without terrain data it flies into the ground, as measured
    return core.up_of(z, frame in AMSL_FRAMES)


def reposition(fence_refuses: Callable[[Goal], bool]) -> Handler:
    """MAV_CMD_DO_REPOSITION, as COMMAND_INT only."""

    def handler(core: Core, order: Order) -> Result:
        if order.frame is None:
            return Result.UNSUPPORTED
        if order.frame not in TARGET_FRAMES:
            core.text(6, f"Unknown mavlink coordinate frame {order.frame}")
            return Result.DENIED
        change = math.isfinite(order.params[1]) and bool(int(order.params[1]) & 1)
        valid = abs(order.lat_deg) <= 90 and abs(order.lon_deg) <= 180 and math.isfinite(order.z)
        if not valid or (core.mode.does is not Does.GUIDED and not change):
            return Result.DENIED
        goal = core.place(order.lat_deg, order.lon_deg, _up_in_frame(core, order.frame, order.z))
        if fence_refuses(goal):
            return Result.FAILED
        if core.mode.does is not Does.GUIDED and not change_mode(core, by_name(core.stack.modes, "GUIDED").number):
            return Result.FAILED
        core.go(goal)
        return Result.ACCEPTED

    return handler


def position_target(core: Core, message: Message, fence_refuses: Callable[[Goal], bool]) -> None:
    """SET_POSITION_TARGET_GLOBAL_INT: never acknowledged; what it cannot use stops the vehicle."""
    if core.mode.does is not Does.GUIDED or not core.is_armed:
        return
    mask = message.type_mask
    position_bits = _POSITION_BITS if core.is_copter else _ROVER_POSITION_BITS
    position, velocity = not mask & position_bits, not mask & _VELOCITY_BITS
    forced = mask & _FORCE_BIT and not mask & _ACCELERATION_BITS
    if message.coordinate_frame not in TARGET_FRAMES or forced:
        core.go(core.stopping_place() if core.is_copter else None)
    elif position and abs(message.lat_int) <= 900_000_000 and abs(message.lon_int) <= 1_800_000_000:
        alt = message.alt if math.isfinite(message.alt) else 0.0
        up = _up_in_frame(core, message.coordinate_frame, alt)
        goal = core.place(message.lat_int / 1e7, message.lon_int / 1e7, up)
        if not fence_refuses(goal):
            core.go(goal)
    elif velocity and not position and all(map(math.isfinite, (message.vx, message.vy, message.vz))):
        core.go(Velocity(message.vy, message.vx, -message.vz))
    else:
        core.go(core.stopping_place() if core.is_copter else None)


def _choose_item(core: Core, order: Order) -> Result:
    runner, number, reset = core.runner, order.params[0], order.params[1]
    if not isinstance(runner, ArduRunner) or not 0 <= number < 65535:
        return Result.DENIED
    return Result.ACCEPTED if runner.choose(int(number), reset=reset == 1) else Result.DENIED


def _start_mission(core: Core, order: Order) -> Result:
    if order.params[0] != 0 or order.params[1] != 0:
        return Result.DENIED
    already = core.mode.does is Does.AUTO
    if (core.is_copter and not core.is_armed) or not change_mode(core, by_name(core.stack.modes, "AUTO").number):
        return Result.FAILED
    if core.is_copter and isinstance(core.runner, ArduRunner):
        core.lift = core.lift or core.landed
        if already:
            core.runner.start_again()
    return Result.ACCEPTED  # a rover that is in AUTO already does nothing, as measured


COMMANDS: dict[int, Handler] = {
    **COMMON,
    17: _to_mode("LOITER"),
    20: _to_mode("RTL"),
    21: _to_mode("LAND"),
    22: _take_off,
    176: _set_mode,
    224: _choose_item,
    300: _start_mission,
    400: _arm,
}
