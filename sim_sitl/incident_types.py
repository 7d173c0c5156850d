"""What can happen to one robot at one time: values, written under [[event]] in a faults file, told apart by `do`."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

Time = Annotated[float, Meta(ge=0, le=86_400)]
Metres = Annotated[float, Meta(ge=-10_000, le=10_000)]
RobotId = Annotated[int, Meta(ge=1, le=254)]


class _Incident(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="do"):
    """Something that happens to `robot` at `at_s` of the mission."""

    robot: RobotId
    at_s: Time


class Passing(_Incident, frozen=True, kw_only=True):
    """One that is over after `for_s`; 0: never."""

    for_s: Time = 0.0


class KillRobot(_Incident, frozen=True, kw_only=True, tag="kill_robot"):
    """The robot is gone, vehicle and all."""


class KillCompanion(_Incident, frozen=True, kw_only=True, tag="kill_companion"):
    """The companion computer dies; the vehicle does what its failsafe parameters say."""


class GpsLoss(Passing, frozen=True, kw_only=True, tag="gps_loss"):
    """No fix: no position is told, modes that need one are refused; what was begun goes on by dead reckoning."""


class GpsFreeze(Passing, frozen=True, kw_only=True, tag="gps_freeze"):
    """The position that is told stays the same, whatever the vehicle does."""


class GpsJump(Passing, frozen=True, kw_only=True, tag="gps_jump"):
    """The vehicle believes that it is somewhere else, and steers by that."""

    east_m: Metres = 0.0
    north_m: Metres = 0.0


class Battery(_Incident, frozen=True, kw_only=True, tag="battery"):
    """The battery drops to `percent`."""

    percent: Annotated[float, Meta(ge=0, le=100)]


class PilotMode(_Incident, frozen=True, kw_only=True, tag="pilot_mode"):
    """The pilot takes over with the mode switch; `mode` is the stack's own name for it, such as LOITER or POSCTL."""

    mode: Annotated[str, Meta(min_length=1, max_length=32)]


class Reboot(_Incident, frozen=True, kw_only=True, tag="reboot"):
    """The autopilot starts anew, also in the air."""


class ClockSkew(Passing, frozen=True, kw_only=True, tag="clock_skew"):
    """The companion's clock runs `offset_s` ahead of everybody else's."""

    offset_s: Annotated[float, Meta(ge=-3600, le=3600)]


Incident = KillRobot | KillCompanion | GpsLoss | GpsFreeze | GpsJump | Battery | PilotMode | Reboot | ClockSkew
