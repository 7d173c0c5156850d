"""The gate: every command to a vehicle passes `gate`, which returns the command that is really pursued.

Rule 1: it is a pure function of what is wanted and what is known. Rule 2: what it cannot prove allowed becomes a Hold
that names the reason. Rule 3: a Hold itself is always allowed. The vehicle's own fence is no substitute: Copter refuses
outside targets in silence and keeps the old one, Rover stops in silence, PX4 accepts latitude 95 and NaN.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache
from itertools import pairwise
from typing import Any

import msgspec

from gatar_edge.bridge.geo import Point, cell_centre_m, distance_to_segment_m, inside_grid, point_inside, segment_inside
from gatar_edge.separation import Place
from gatar_edge.types import Cell, Goto, GridSpec, Hold, Mission, VehicleCommand


class Refusal(StrEnum):
    """Why a command was turned into a Hold; the value is the Hold's reason."""

    PILOT = "refused: the pilot has control"
    NOT_READY = "refused: the vehicle is not ready"
    NO_HOME = "refused: home is not known"
    NO_ORIGIN = "refused: the estimator's origin is not known"
    NO_POSITION = "refused: the position is not known"
    STALE_POSITION = "refused: the position is too old"
    NOT_FINITE = "refused: not a finite number"
    EMPTY = "refused: a mission without cells"
    OUTSIDE_GRID = "refused: outside the grid"
    OUTSIDE_FENCE = "refused: outside the fence"
    ALTITUDE = "refused: outside the altitude band"
    SEPARATION = "refused: another robot is there, goes there, or stands in the way"


_MILLIMETRE = 1e-3
GOAL_REFUSALS = {Refusal.OUTSIDE_FENCE.value, Refusal.OUTSIDE_GRID.value, Refusal.SEPARATION.value}  # another may do


@dataclass(frozen=True, slots=True)
class Limits:
    """What never changes during a mission."""

    grid: GridSpec
    fence_m: tuple[Point, ...]  # polygon in metres along the grid's axes
    altitude_m: float  # at which the vehicle flies, above home
    altitude_band_m: tuple[float, float]
    position_max_age_ns: int
    retask_min_interval_ns: int
    min_separation_m: float = 0.0  # from where neighbours of its layer are or will be; 0: not asked
    layer_m: float = 1.0  # neighbours that are this much higher or lower fly in another layer


class Known(msgspec.Struct, frozen=True):
    """What is known of the vehicle at `now_ns`."""

    now_ns: int
    pilot: bool  # somebody else chose the mode, and we were not told to go on
    ready: bool  # connected, armed, airborne if it flies, in a mode that obeys us
    home: bool
    origin: bool  # of the estimator: without one there is no position to go by
    position_m: Point | None  # in metres along the grid's axes
    position_ns: int
    pursued: VehicleCommand  # what was returned last
    retasked_ns: int  # when that was another command than before; negative: never
    neighbors: tuple[Place, ...] = ()  # where other robots stand, or go to, and have the right of way


def gate(wanted: VehicleCommand, known: Known, limits: Limits) -> VehicleCommand:
    """The command to pursue: `wanted`, the one pursued already if it is too soon for another, or a Hold that says why.

    Expects cells that are pairs of numbers; anything else in them is refused, not raised.
    """
    if isinstance(wanted, Hold):
        return wanted
    refusal = _vehicle_refusal(known, limits) or _cells_refusal(wanted, known, limits)
    if refusal is not None:
        return Hold(refusal.value)
    too_soon = known.retasked_ns >= 0 and known.now_ns - known.retasked_ns < limits.retask_min_interval_ns
    # leaving a Hold is never too soon: a refusal that ended must not leave the vehicle standing
    if too_soon and not isinstance(known.pursued, Hold):
        return known.pursued
    return wanted


def _vehicle_refusal(known: Known, limits: Limits) -> Refusal | None:
    low_m, high_m = limits.altitude_band_m
    checks = (
        (known.pilot, Refusal.PILOT),
        (not known.ready, Refusal.NOT_READY),
        (not known.home, Refusal.NO_HOME),
        (not known.origin, Refusal.NO_ORIGIN),
        (known.position_m is None, Refusal.NO_POSITION),
        (known.now_ns - known.position_ns > limits.position_max_age_ns, Refusal.STALE_POSITION),
        (not low_m <= limits.altitude_m <= high_m, Refusal.ALTITUDE),  # NaN is outside every band
    )
    return next((refusal for broken, refusal in checks if broken), None)


def _cells_refusal(wanted: Goto | Mission, known: Known, limits: Limits) -> Refusal | None:
    cells = (wanted.cell,) if isinstance(wanted, Goto) else wanted.cells
    if not cells:
        return Refusal.EMPTY
    if not all(map(_finite, cells)):
        return Refusal.NOT_FINITE
    if not all(inside_grid(limits.grid, cell) for cell in cells):
        return Refusal.OUTSIDE_GRID
    if not _path_inside(tuple((x, y) for x, y in cells), limits.grid, limits.fence_m):
        return Refusal.OUTSIDE_FENCE
    if limits.min_separation_m and not _separate(cells, known, limits):
        return Refusal.SEPARATION
    # a vehicle that strayed outside may come back; one inside may not cross the outside on its way
    start, goal, fence_m = known.position_m, cell_centre_m(limits.grid, cells[0]), limits.fence_m
    if start is None or not point_inside(fence_m, start) or segment_inside(fence_m, start, goal):
        return None
    return Refusal.OUTSIDE_FENCE


def _separate(cells: tuple[Cell, ...], known: Known, limits: Limits) -> bool:
    """Whether the goal keeps from all neighbours of the layer, and the way from those that stand.

    Those on their way will be gone; where is not known, nor when. Who is too near to one that stands may leave it.
    """
    way = _way_ahead(known.position_m, cells, limits.grid)
    for place in known.neighbors:
        if abs(place.altitude_m - limits.altitude_m) >= limits.layer_m:
            continue
        if math.dist(way[-1], place.point_m) < limits.min_separation_m:
            return False
        room_m = min(limits.min_separation_m, math.dist(way[0], place.point_m)) - _MILLIMETRE
        if place.stands and any(distance_to_segment_m(place.point_m, a, b) < room_m for a, b in pairwise(way)):
            return False
    return True


def _way_ahead(position_m: Point | None, cells: tuple[Cell, ...], grid: GridSpec) -> list[Point]:
    """From the vehicle through the corners that it has not passed: a path stays the same while it is driven."""
    points = [cell_centre_m(grid, cell) for cell in cells]
    if position_m is None:
        return points
    for passed, leg in enumerate(pairwise(points), start=1):
        if distance_to_segment_m(position_m, *leg) <= grid.cell_m / 2:
            return [position_m, *points[passed:]]
    return [position_m, *points]


@lru_cache(maxsize=1024)  # the same command comes at every tick
def _path_inside(cells: tuple[Cell, ...], grid: GridSpec, fence_m: tuple[Point, ...]) -> bool:
    centres = [cell_centre_m(grid, cell) for cell in cells]
    return all(point_inside(fence_m, centre) for centre in centres) and all(
        segment_inside(fence_m, a, b) for a, b in pairwise(centres)
    )


def _finite(cell: Any) -> bool:
    try:
        x, y = cell
        return math.isfinite(x) and math.isfinite(y)
    except (TypeError, ValueError, OverflowError):
        return False
