"""COMMAND_LONG and COMMAND_INT as one value, their results, and the commands that both stacks obey alike."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import IntEnum

from gatar_edge.sim_sitl.core import Core
from gatar_edge.sim_sitl.mission_server import Client
from gatar_edge.sim_sitl.streams import home_position
from gatar_edge.sim_sitl.vehicle import Goal
from gatar_edge.sim_sitl.wire import Message

MAX_SPEED_M_S = 30.0
FORCE = 21196  # param2 of arming that overrides the checks


class Result(IntEnum):
    """MAV_RESULT."""

    ACCEPTED = 0
    TEMPORARILY_REJECTED = 1
    DENIED = 2
    UNSUPPORTED = 3
    FAILED = 4


@dataclass(frozen=True, slots=True)
class Order:
    """A command: for COMMAND_INT `lat_deg` and `lon_deg` come from x and y, else from param5 and param6."""

    command: int
    params: tuple[float, float, float, float]
    lat_deg: float
    lon_deg: float
    z: float
    frame: int | None  # None for COMMAND_LONG
    client: Client


Handler = Callable[[Core, Order], Result]


def order_from(message: Message) -> Order:
    """The command in a COMMAND_LONG or COMMAND_INT."""
    client = (message.get_srcSystem(), message.get_srcComponent())
    params = (message.param1, message.param2, message.param3, message.param4)
    if message.get_type() == "COMMAND_INT":
        lat, lon = message.x / 1e7, message.y / 1e7
        return Order(message.command, params, lat, lon, message.z, message.frame, client)
    return Order(message.command, params, message.param5, message.param6, message.param7, None, client)


def acknowledge(core: Core, order: Order, result: Result) -> None:
    """Send COMMAND_ACK to the one who asked."""
    system, component = order.client
    core.emit(
        "COMMAND_ACK",
        command=order.command, result=int(result), progress=0, result_param2=0,
        target_system=system, target_component=component,
    )  # fmt: skip


def change_speed(core: Core, order: Order) -> Result:
    """MAV_CMD_DO_CHANGE_SPEED."""
    speed = order.params[1]
    if not 0 < speed <= MAX_SPEED_M_S:
        return Result.DENIED
    core.limits = replace(core.limits, speed_m_s=speed)
    return Result.ACCEPTED


def set_home(core: Core, order: Order) -> Result:
    """MAV_CMD_DO_SET_HOME: here (param1 is 1) or at a position, altitude above the sea."""
    if not core.home_set:
        return Result.FAILED
    if order.params[0] == 1:
        core.set_home(Goal(core.body.east_m, core.body.north_m, core.body.up_m))
    else:
        if not (abs(order.lat_deg) <= 90 and abs(order.lon_deg) <= 180 and math.isfinite(order.z)):
            return Result.DENIED
        core.set_home(core.place(order.lat_deg, order.lon_deg, core.up_of(order.z, amsl=True)))
    core.emit("HOME_POSITION", **(home_position(core) or {}))
    return Result.ACCEPTED


def get_home(core: Core, order: Order) -> Result:
    """MAV_CMD_GET_HOME_POSITION."""
    fields = home_position(core)
    if fields is None:
        return Result.FAILED
    core.emit("HOME_POSITION", **fields)
    return Result.ACCEPTED


COMMON: dict[int, Handler] = {178: change_speed, 179: set_home, 410: get_home}
