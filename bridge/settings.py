"""What one vehicle's driver must be told."""

from __future__ import annotations

import math
from dataclasses import dataclass

from gatar_edge.bridge.geo import Point, wgs84_to_grid_m
from gatar_edge.bridge.safety import Limits
from gatar_edge.errors import ConfigError
from gatar_edge.types import NS_PER_S, GridSpec, RobotKind


@dataclass(frozen=True, slots=True)
class DriverConfig:
    """One vehicle and how it is to be driven. Raises `ConfigError` for values that cannot be flown."""

    robot_id: int
    kind: RobotKind
    grid: GridSpec
    sysid: int  # the vehicle's, and so ours: a companion is a component of its vehicle
    compid: int = 191  # MAV_COMP_ID_ONBOARD_COMPUTER
    altitude_m: float = 20.0  # above home; give each UAV its own layer
    altitude_band_m: tuple[float, float] = (2.0, 120.0)
    speed_m_s: float | None = None  # for guided targets; None: the vehicle's own
    fence_deg: tuple[Point, ...] | None = None  # (lat, lon) corners; None: the grid's rectangle
    position_max_age_s: float = 1.0
    retask_min_interval_s: float = 1.0
    min_separation_m: float = 0.0  # from neighbours in its layer, where the caller tells of them; 0: not asked
    failed_retry_s: float = 10.0  # an unchanged command that failed is tried again after this long
    drive: str = "mission"  # how a UGV is driven: "mission" items in AUTO, or "guided" targets
    targets: str = "reposition"  # how guided targets are given: DO_REPOSITION, or "setpoint": SET_POSITION_TARGET_*
    arrive_m: float | None = None  # None: 2 m (the stacks' own radius), less on small cells
    progress_s: float = 15.0  # a rover takes up to 10 s to turn round
    heartbeat_hz: float = 1.0
    critical_s: float = 5.0  # how long a failing robot still says so before it falls silent
    auto_launch: bool = True  # arm and take off without being told
    log_frames: bool = True
    seed: int = 0  # of the jitter when another ground station is in the way

    def __post_init__(self) -> None:
        """Check what no vehicle could make up for."""
        rows = (
            (1 <= self.sysid <= 255, "sysid", self.sysid, "1 to 255"),
            (1 <= self.compid <= 255, "compid", self.compid, "1 to 255"),
            (self.drive in ("mission", "guided"), "drive", self.drive, "mission or guided"),
            (self.targets in ("reposition", "setpoint"), "targets", self.targets, "reposition or setpoint"),
            (0.1 <= self.heartbeat_hz <= 50, "heartbeat_hz", self.heartbeat_hz, "0.1 to 50"),
            (0 <= self.min_separation_m < 1e4, "min_separation_m", self.min_separation_m, "0 to 10000"),
            (self.position_max_age_s > 0, "position_max_age_s", self.position_max_age_s, "more than 0"),
            (self.fence_deg is None or len(self.fence_deg) >= 3, "fence_deg", self.fence_deg, "at least 3 corners"),
            (self.speed_m_s is None or 0 < self.speed_m_s < 100, "speed_m_s", self.speed_m_s, "0 to 100"),
        )
        for good, name, got, limit in rows:
            if not good:
                raise ConfigError(f"vehicle {self.robot_id}: {name} is {got}, must be {limit}")
        low_m, high_m = self.altitude_band_m
        if self.kind is RobotKind.UAV and not low_m <= self.altitude_m <= high_m:
            raise ConfigError(
                f"vehicle {self.robot_id}: altitude_m is {self.altitude_m}, outside altitude_band_m {low_m} to {high_m}"
            )

    def limits(self) -> Limits:
        """What the gate needs of this."""
        grid = self.grid
        w, h = grid.width * grid.cell_m, grid.height * grid.cell_m
        fence = self.fence_deg and tuple(wgs84_to_grid_m(grid, lat, lon) for lat, lon in self.fence_deg)
        flies = self.kind is RobotKind.UAV
        return Limits(
            grid=grid,
            fence_m=fence or ((0.0, 0.0), (w, 0.0), (w, h), (0.0, h)),
            altitude_m=self.altitude_m if flies else 0.0,
            altitude_band_m=self.altitude_band_m if flies else (-math.inf, math.inf),
            position_max_age_ns=round(self.position_max_age_s * NS_PER_S),
            retask_min_interval_ns=round(self.retask_min_interval_s * NS_PER_S),
            min_separation_m=self.min_separation_m,
        )
