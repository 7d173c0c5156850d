"""From what perception usually gives, a costmap or detections in latitude and longitude, to cells of the grid."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from gatar_edge.bridge.geo import wgs84_to_cell
from gatar_edge.types import Cells, GridSpec

UNKNOWN = -1  # as in nav_msgs/OccupancyGrid
OCCUPIED_PERCENT = 65  # map_server's default threshold


def cells_from_costmap(
    costmap: npt.NDArray[np.int8],
    corner_m: tuple[float, float],
    resolution_m: float,
    grid: GridSpec,
    occupied: int = OCCUPIED_PERCENT,
) -> tuple[Cells, Cells]:
    """Cells in view and blocked cells, both int16 [n, 2], of an occupancy grid laid out as nav_msgs/OccupancyGrid.

    `costmap` is [rows, columns] with row 0 in the south and percent or -1 (unknown); `corner_m` is its south-west
    corner in metres along the grid's axes from the grid's origin. A cell is in view where at least half of it is
    known, and blocked where any known part of it is occupied.
    """
    rows, columns = costmap.shape
    x = np.floor((corner_m[0] + (np.arange(columns) + 0.5) * resolution_m) / grid.cell_m).astype(np.int64)
    y = np.floor((corner_m[1] + (np.arange(rows) + 0.5) * resolution_m) / grid.cell_m).astype(np.int64)
    inside = ((y >= 0) & (y < grid.height))[:, None] & ((x >= 0) & (x < grid.width))[None, :]
    place = np.broadcast_to(x[None, :] * grid.height + y[:, None], costmap.shape)[inside]
    values = costmap[inside]
    count = grid.width * grid.height
    known = np.bincount(place, values != UNKNOWN, count)
    blocked = np.bincount(place, values >= occupied, count) > 0
    samples = max(1.0, (grid.cell_m / resolution_m) ** 2)
    seen = known >= samples / 2
    return _cells(seen, grid), _cells(blocked & seen, grid)


def cells_from_detections(lat_lon_deg: Iterable[tuple[float, float]], grid: GridSpec) -> Cells:
    """The cells that hold a detection, int16 [n, 2], each once; detections off the grid are left out."""
    found = {cell for lat, lon in lat_lon_deg if (cell := wgs84_to_cell(grid, lat, lon)) is not None}
    return np.array(sorted(found), dtype=np.int16).reshape(-1, 2)


def _cells(mask: npt.NDArray[np.bool_], grid: GridSpec) -> Cells:
    return np.argwhere(mask.reshape(grid.width, grid.height)).astype(np.int16)
