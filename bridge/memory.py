"""What a driver remembers over a restart of its process: nothing that the vehicle itself can tell.

With it a restarted companion goes on with the mission on board where that is still the one that it put there, and its
signed frames are newer than all that it has sent.
"""

from __future__ import annotations

from dataclasses import dataclass

from gatar_edge.bridge.geo import cell_to_wgs84
from gatar_edge.bridge.mission_items import Items, build, fingerprint
from gatar_edge.bridge.profiles.base import Profile
from gatar_edge.types import Cell, GridSpec, Mission

Points = tuple[tuple[float, float], ...]


@dataclass(frozen=True, slots=True)
class DriverMemory:
    """One moment of a driver. `mission` is "" where nothing is certain to be on board."""

    mission: str = ""  # fingerprint of what is on board
    cells: tuple[Cell, ...] = ()  # the pursued mission
    start: Cell | None = None  # where it began
    signing_timestamp: int = 0  # of the next frame, see `signing.Signing`

    @property
    def pursued(self) -> Mission | None:
        """The mission that the vehicle was driving."""
        return Mission(self.cells) if self.mission and self.cells else None


NOTHING = DriverMemory()


def mission_points(grid: GridSpec, cells: tuple[Cell, ...]) -> Points:
    """(lat, lon) of each cell's centre, degrees."""
    return tuple(cell_to_wgs84(grid, cell) for cell in cells)


def remembered_items(memory: DriverMemory, grid: GridSpec, profile: Profile) -> Items:
    """The mission of `memory` as items; none where it would be another one today, as after a change of the grid."""
    items = build(profile, mission_points(grid, memory.cells), 0.0) if memory.mission else ()
    return items if items and fingerprint(items, profile.first_item_seq) == memory.mission else ()
