"""Mission items and what each stack finds wrong with them, as measured on ArduCopter, ArduRover and PX4."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from gatar_edge.sim_sitl.wire import Message

WAYPOINT, LOITER_UNLIM, LOITER_TIME, RTL, LAND, TAKEOFF, DELAY, JUMP, SPEED = 16, 17, 19, 20, 21, 22, 93, 177, 178
COMMANDS = frozenset({WAYPOINT, LOITER_UNLIM, LOITER_TIME, RTL, LAND, TAKEOFF, DELAY, JUMP, SPEED})
NAV_LAST = 95  # MAV_CMD_NAV_LAST: only items up to here are reported as reached
PLACES = frozenset({WAYPOINT, LOITER_UNLIM, LOITER_TIME, LAND, TAKEOFF})
# Frames whose altitude is above mean sea level; the other accepted ones are above home.
AMSL_FRAMES = frozenset({0, 5})
ARDUPILOT_FRAMES = frozenset({0, 2, 3, 5, 6, 10, 11})
PX4_FRAMES = frozenset({0, 2, 3, 5, 6})
_INT_FRAME_TO_FLOAT = {5: 0, 6: 3, 11: 10}  # ArduPilot stores these and reads back the latter
_MAX_ALT_M = 83_000.0  # LOCATION_ALT_MAX_M of ArduPilot


class Ack(IntEnum):
    """MAV_MISSION_RESULT."""

    ACCEPTED = 0
    ERROR = 1
    UNSUPPORTED_FRAME = 2
    UNSUPPORTED = 3
    NO_SPACE = 4
    INVALID = 5
    INVALID_PARAM1 = 6
    INVALID_PARAM2 = 7
    INVALID_PARAM3 = 8
    INVALID_PARAM4 = 9
    INVALID_PARAM5_X = 10
    INVALID_PARAM6_Y = 11
    INVALID_PARAM7 = 12
    INVALID_SEQUENCE = 13
    DENIED = 14
    OPERATION_CANCELLED = 15


@dataclass(frozen=True, slots=True)
class Item:
    """One mission item as stored: x and y are 1e-7 degrees, z metres in `frame`."""

    frame: int
    command: int
    params: tuple[float, float, float, float]
    x: int
    y: int
    z: float
    autocontinue: int = 1

    def fields(self, seq: int, current: int) -> dict[str, Any]:
        """The fields that MISSION_ITEM_INT and MISSION_ITEM share; x and y as integers."""
        p1, p2, p3, p4 = self.params
        return {
            "seq": seq, "frame": self.frame, "command": self.command, "current": current,
            "autocontinue": self.autocontinue, "param1": p1, "param2": p2, "param3": p3, "param4": p4,
            "x": self.x, "y": self.y, "z": self.z,
        }  # fmt: skip


def item_from(message: Message) -> Item | None:
    """The item in a MISSION_ITEM_INT or MISSION_ITEM; None where its float degrees are no numbers."""
    x, y = message.x, message.y
    if message.get_type() == "MISSION_ITEM":
        if not (abs(x) <= 200 and abs(y) <= 200):  # false for NaN too; keeps 1e7 within int32
            return None
        x, y = round(x * 1e7), round(y * 1e7)
    params = (message.param1, message.param2, message.param3, message.param4)
    return Item(message.frame, message.command, params, x, y, message.z, message.autocontinue)


def check_ardupilot(item: Item) -> Ack:
    """What ArduPilot answers to an item. NaN yaw is taken, other NaN parameters are not."""
    nan_of = (Ack.INVALID_PARAM1, Ack.INVALID_PARAM2, Ack.INVALID_PARAM3)
    found = [
        (item.command == 0, Ack.INVALID),
        (item.command not in COMMANDS, Ack.UNSUPPORTED),
        *((math.isnan(param), result) for param, result in zip(item.params[:3], nan_of, strict=True)),
    ]
    if item.command in PLACES:
        found += [
            (item.frame not in ARDUPILOT_FRAMES, Ack.UNSUPPORTED_FRAME),
            (abs(item.x) > 900_000_000, Ack.INVALID_PARAM5_X),
            (abs(item.y) > 1_800_000_000, Ack.INVALID_PARAM6_Y),
            (not abs(item.z) < _MAX_ALT_M, Ack.INVALID_PARAM7),  # NaN too
        ]
    return next((result for wrong, result in found if wrong), Ack.ACCEPTED)


def check_px4(item: Item) -> Ack:
    """What PX4 answers to an item: NaN, latitude 95 and no altitude are all ACCEPTED."""
    if item.command in PLACES and item.frame not in PX4_FRAMES:
        return Ack.UNSUPPORTED_FRAME
    return Ack.ACCEPTED if item.command in COMMANDS else Ack.UNSUPPORTED


def stored_by_ardupilot(item: Item) -> Item:
    """An item as it reads back: frame 6 is stored as 3."""
    frame = _INT_FRAME_TO_FLOAT.get(item.frame, item.frame)
    return Item(frame, item.command, item.params, item.x, item.y, item.z, item.autocontinue)


def stored_by_px4(item: Item) -> Item:
    """An item as it reads back: unchanged."""
    return item
