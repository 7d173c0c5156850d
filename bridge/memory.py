"""The driver's memory as missions: what it was driving before a restart, to compare with what is on board."""

from __future__ import annotations

from gatar_edge.bridge.geo import cell_to_wgs84
from gatar_edge.bridge.mission_items import Items, build, fingerprint
from gatar_edge.bridge.profiles.base import Profile
from gatar_edge.driver_memory import DriverMemory
from gatar_edge.types import Cell, GridSpec

Points = tuple[tuple[float, float], ...]


def mission_points(grid: GridSpec, cells: tuple[Cell, ...]) -> Points:
    """(lat, lon) of each cell's centre, degrees."""
    return tuple(cell_to_wgs84(grid, cell) for cell in cells)


def remembered_items(memory: DriverMemory, grid: GridSpec, profile: Profile) -> Items:
    """The mission of `memory` as items; none where it would be another one today, as after a change of the grid."""
    items = build(profile, mission_points(grid, memory.cells), 0.0) if memory.mission else ()
    return items if items and fingerprint(items, profile.first_item_seq) == memory.mission else ()
