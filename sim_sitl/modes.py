"""Flight modes of the simulated autopilots as tables: the number on the wire, and what the vehicle does in it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Does(Enum):
    """What a mode makes of the vehicle."""

    STAY = "stay"
    GUIDED = "guided"
    AUTO = "auto"
    RETURN = "return"
    LAND = "land"
    TAKEOFF = "takeoff"
    OFFBOARD = "offboard"


@dataclass(frozen=True, slots=True)
class Mode:
    """One flight mode: `base_mode` is HEARTBEAT.base_mode while disarmed."""

    name: str
    number: int
    does: Does
    base_mode: int
    needs_position: bool = True
    armable: bool = True


def _table(*modes: Mode) -> dict[int, Mode]:
    return {mode.number: mode for mode in modes}


# base_mode as measured on ArduCopter and ArduRover 4.6.2 (custom 1, guided 8, stabilize 16, manual 64).
ARDUCOPTER = _table(
    Mode("STABILIZE", 0, Does.STAY, 81, needs_position=False),
    Mode("ALT_HOLD", 2, Does.STAY, 81, needs_position=False),
    Mode("AUTO", 3, Does.AUTO, 89, armable=False),
    Mode("GUIDED", 4, Does.GUIDED, 89),
    Mode("LOITER", 5, Does.STAY, 89),
    Mode("RTL", 6, Does.RETURN, 89, armable=False),
    Mode("LAND", 9, Does.LAND, 89, needs_position=False, armable=False),
    Mode("BRAKE", 17, Does.STAY, 89, armable=False),
)
ARDUROVER = _table(
    Mode("MANUAL", 0, Does.STAY, 65, needs_position=False),
    Mode("HOLD", 4, Does.STAY, 1, needs_position=False),
    Mode("LOITER", 5, Does.STAY, 9),
    Mode("AUTO", 10, Does.AUTO, 9),
    Mode("RTL", 11, Does.RETURN, 9, armable=False),
    Mode("GUIDED", 15, Does.GUIDED, 9),
)
# PX4: main mode << 16 | sub mode << 24; base_mode 29 in all of them, as measured.
PX4 = _table(
    Mode("MANUAL", 0x00010000, Does.STAY, 29, needs_position=False),
    Mode("POSCTL", 0x00030000, Does.STAY, 29),
    Mode("AUTO.TAKEOFF", 0x02040000, Does.TAKEOFF, 29),
    Mode("AUTO.LOITER", 0x03040000, Does.STAY, 29),
    Mode("AUTO.MISSION", 0x04040000, Does.AUTO, 29),
    Mode("AUTO.RTL", 0x05040000, Does.RETURN, 29),
    Mode("AUTO.LAND", 0x06040000, Does.LAND, 29),
    Mode("OFFBOARD", 0x00060000, Does.OFFBOARD, 29),
)


def by_name(table: dict[int, Mode], name: str) -> Mode:
    """The mode of that name; the names are constants of this package."""
    return next(mode for mode in table.values() if mode.name == name)
