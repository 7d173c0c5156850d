"""The registry of autopilot stacks, and the choice of one from a heartbeat.

>>> choose(autopilot=3, vehicle_type=10).name
'ardupilot-rover'
>>> choose(autopilot=0, vehicle_type=2).text
'generic autopilot (MAV_AUTOPILOT 0) with MAV_TYPE 2 has no profile; known: ardupilot-copter, ardupilot-rover, px4-copter, px4-rover'
"""  # noqa: E501

from __future__ import annotations

from dataclasses import dataclass

from gatar_edge.bridge.profiles import ardupilot_copter, ardupilot_rover, px4_copter, px4_rover
from gatar_edge.bridge.profiles.base import HoldBy, Profile, SetCurrent, Takeoff

PROFILES: tuple[Profile, ...] = (
    ardupilot_copter.PROFILE,
    ardupilot_rover.PROFILE,
    px4_copter.PROFILE,
    px4_rover.PROFILE,
)

# MAV_AUTOPILOT, for a refusal that people understand
_AUTOPILOT_NAMES = {0: "generic autopilot", 3: "ArduPilot", 4: "OpenPilot", 12: "PX4", 20: "AirRails"}


@dataclass(frozen=True, slots=True)
class Unsupported:
    """A heartbeat for which there is no profile."""

    autopilot: int
    vehicle_type: int

    @property
    def text(self) -> str:
        """One line that names what was found and what would do."""
        name = _AUTOPILOT_NAMES.get(self.autopilot, "an unknown autopilot")
        known = ", ".join(p.name for p in PROFILES)
        return (
            f"{name} (MAV_AUTOPILOT {self.autopilot}) with MAV_TYPE {self.vehicle_type} has no profile; known: {known}"
        )


def choose(autopilot: int, vehicle_type: int) -> Profile | Unsupported:
    """The profile for a heartbeat's `autopilot` and `type`."""
    for profile in PROFILES:
        if profile.autopilot == autopilot and vehicle_type in profile.vehicle_types:
            return profile
    return Unsupported(autopilot, vehicle_type)


__all__ = ["PROFILES", "HoldBy", "Profile", "SetCurrent", "Takeoff", "Unsupported", "choose"]
