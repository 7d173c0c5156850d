"""A simulated vehicle in the world: autopilot and physics, placed on the grid."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from gatar_edge.sim_sitl.autopilot import AutopilotConfig, SimAutopilot
from gatar_edge.sim_sitl.geodesy import LocalFrame
from gatar_edge.sim_sitl.world import World
from gatar_edge.types import Cell, GridSpec, RobotKind

StackName = Literal["ardupilot", "px4"]


class Body:
    """The vehicle of robot `index` (its id is one more), starting at the centre of its cell."""

    def __init__(self, world: World, index: int, grid: GridSpec, stack: StackName, speed_m_s: float) -> None:
        self.robot_id = index + 1
        self.kind = world.team.kinds[index]
        self._grid = grid
        self._start_m = tuple((c + 0.5) * grid.cell_m for c in world.starts[index])
        angle = math.radians(grid.heading_deg)
        self._cos, self._sin = math.cos(angle), math.sin(angle)
        self._width, self._height = world.shape
        self._obstacles = {(x, y) for x, y in np.argwhere(world.obstacles).tolist()}
        frame = LocalFrame(grid.origin_lat_deg, grid.origin_lon_deg)
        lat_deg, lon_deg = frame.geodetic(*self._to_enu(*self._start_m))
        self.autopilot = SimAutopilot(
            AutopilotConfig(
                sysid=self.robot_id,
                vehicle="copter" if self.kind is RobotKind.UAV else "rover",
                stack=stack,
                home_lat_deg=lat_deg,
                home_lon_deg=lon_deg,
                seed=world.seed * 64 + index,
                speed_m_s=speed_m_s,
            ),
            0,
            blocked=self._blocked if self.kind is RobotKind.UGV else None,
        )
        self.travelled_m = 0.0

    def step(self, now_ns: int) -> None:
        """Physics up to now."""
        autopilot = self.autopilot
        before, place_m = autopilot.body, autopilot.place_m
        autopilot.step(now_ns)
        if autopilot.body is not before:
            self.travelled_m += math.dist(place_m, autopilot.place_m)

    @property
    def cell(self) -> Cell:
        """Where the vehicle really is; a vehicle outside the grid counts as in the nearest cell of it."""
        x, y = self._cell_at(*self.autopilot.place_m)
        return min(max(x, 0), self._grid.width - 1), min(max(y, 0), self._grid.height - 1)

    @property
    def xy(self) -> tuple[float, float]:
        """Where the vehicle really is, in cells; whole numbers at the centres."""
        x_m, y_m = self._grid_m(*self.autopilot.place_m)
        return x_m / self._grid.cell_m - 0.5, y_m / self._grid.cell_m - 0.5

    def _grid_m(self, east_m: float, north_m: float) -> tuple[float, float]:
        """Metres from the start to metres of the grid."""
        x_m = east_m * self._cos - north_m * self._sin
        y_m = east_m * self._sin + north_m * self._cos
        return self._start_m[0] + x_m, self._start_m[1] + y_m

    def _cell_at(self, east_m: float, north_m: float) -> Cell:
        """The cell of a place given in metres from the start."""
        x_m, y_m = self._grid_m(east_m, north_m)
        return math.floor(x_m / self._grid.cell_m), math.floor(y_m / self._grid.cell_m)

    def _to_enu(self, x_m: float, y_m: float) -> tuple[float, float]:
        """Grid metres to metres east and north of the grid's origin: the grid's +y is `heading_deg` from north."""
        return x_m * self._cos + y_m * self._sin, y_m * self._cos - x_m * self._sin

    def _blocked(self, east_m: float, north_m: float) -> bool:
        x, y = self._cell_at(east_m, north_m)
        inside = 0 <= x < self._width and 0 <= y < self._height
        return not inside or (x, y) in self._obstacles
