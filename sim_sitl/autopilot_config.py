"""What one simulated autopilot is told, and what is true of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from gatar_edge.errors import ConfigError


@dataclass(frozen=True, slots=True)
class AutopilotConfig:
    """One simulated autopilot. Home is where it stands at the start, and the origin of its east-north metres."""

    sysid: int
    vehicle: Literal["copter", "rover"]
    stack: Literal["ardupilot", "px4"] = "ardupilot"
    home_lat_deg: float = -35.3632621
    home_lon_deg: float = 149.1652374
    home_alt_m: float = 584.0
    heading_deg: float = 0.0
    seed: int = 0
    ekf_ready_s: float = 0.0  # real ones take 42-45 s
    speed_m_s: float = 5.0
    acceleration_m_s2: float = 2.5
    climb_m_s: float = 2.5
    turn_deg_s: float = 120.0
    battery_percent: float = 100.0
    endurance_s: float = 3600.0
    accepts_unsigned: bool = True  # as the first serial link does, also once signing is set up

    def __post_init__(self) -> None:
        """Refuse what no vehicle can be."""
        if not 1 <= self.sysid <= 255:
            raise ConfigError(f"sysid is {self.sysid}, must be 1 to 255")
        if self.vehicle not in ("copter", "rover") or self.stack not in ("ardupilot", "px4"):
            raise ConfigError(
                f"no autopilot for {self.vehicle!r} with {self.stack!r}: copter or rover, ardupilot or px4"
            )
        if min(self.speed_m_s, self.acceleration_m_s2, self.climb_m_s, self.turn_deg_s, self.endurance_s) <= 0:
            raise ConfigError("speed, acceleration, climb, turn rate and endurance must be above 0")


@dataclass(frozen=True, slots=True)
class Truth:
    """Where the vehicle really is, whatever its telemetry says."""

    lat_deg: float
    lon_deg: float
    alt_rel_m: float
    east_m: float
    north_m: float
    speed_m_s: float
    heading_deg: float
    armed: bool
    mode: str
    landed: bool
    battery_percent: float
    mission_index: int
    mission_state: int
