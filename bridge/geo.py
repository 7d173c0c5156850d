"""Cells of the shared grid to latitude and longitude and back, exact on the WGS84 ellipsoid.

The grid is a rectangle in the plane that touches the ellipsoid at the grid's origin, the outer south-west corner of
cell (0, 0). `heading_deg` turns the grid's +y axis clockwise from north. A flat-earth formula would err by 2 mm at
100 m and by 4.8 m at 5 km; this way, there and back, is exact at any size.
"""

from __future__ import annotations

import math
from functools import lru_cache
from itertools import pairwise

from gatar_edge.types import Cell, GridSpec

# WGS84: semi-major axis, flattening (NIMA TR8350.2), and what follows from them.
_A_M = 6378137.0
_F = 1.0 / 298.257223563
_B_M = _A_M * (1.0 - _F)
_E2 = _F * (2.0 - _F)
_EP2 = _E2 / (1.0 - _E2)

Point = tuple[float, float]
Point3 = tuple[float, float, float]


def deg_e7(deg: float) -> int:
    """Degrees in the integer unit of MAVLink, 1e-7 degree, rounded: truncation would err by up to 1 cm."""
    return round(deg * 1e7)


def wrap_lon_deg(lon_deg: float) -> float:
    """Longitude in [-180, 180)."""
    return (lon_deg + 180.0) % 360.0 - 180.0


def _geodetic_to_ecef(lat_deg: float, lon_deg: float, alt_m: float) -> Point3:
    lat, lon = math.radians(lat_deg), math.radians(lon_deg)
    n = _A_M / math.sqrt(1.0 - _E2 * math.sin(lat) ** 2)
    ring = (n + alt_m) * math.cos(lat)
    return ring * math.cos(lon), ring * math.sin(lon), (n * (1.0 - _E2) + alt_m) * math.sin(lat)


def _ecef_to_geodetic(x: float, y: float, z: float) -> Point3:
    """Bowring's formula, iterated: far below a micrometre anywhere near the surface."""
    ring = math.hypot(x, y)
    beta = math.atan2(z * _A_M, ring * _B_M)
    lat = 0.0
    for _ in range(3):
        lat = math.atan2(z + _EP2 * _B_M * math.sin(beta) ** 3, ring - _E2 * _A_M * math.cos(beta) ** 3)
        beta = math.atan2((1.0 - _F) * math.sin(lat), math.cos(lat))
    n = _A_M / math.sqrt(1.0 - _E2 * math.sin(lat) ** 2)
    # this form of the height has no pole of its own
    alt = ring * math.cos(lat) + z * math.sin(lat) - _A_M**2 / n
    return math.degrees(lat), math.degrees(math.atan2(y, x)), alt


@lru_cache(maxsize=64)  # one site has one origin, asked for at every position
def _frame(origin: Point3) -> tuple[float, float, float, float, float, float, float]:
    """Sine and cosine of latitude and longitude, and the place in ECEF, of (lat_deg, lon_deg, alt_m)."""
    lat, lon = math.radians(origin[0]), math.radians(origin[1])
    return math.sin(lat), math.cos(lat), math.sin(lon), math.cos(lon), *_geodetic_to_ecef(*origin)


def enu_to_geodetic(enu_m: Point3, origin: Point3) -> Point3:
    """A point (east, north, up) of `origin` = (lat_deg, lon_deg, alt_m), as (lat_deg, lon_deg, alt_m)."""
    east_m, north_m, up_m = enu_m
    sl, cl, so, co, x0, y0, z0 = _frame(origin)
    ring = cl * up_m - sl * north_m
    return _ecef_to_geodetic(x0 + co * ring - so * east_m, y0 + so * ring + co * east_m, z0 + sl * up_m + cl * north_m)


def geodetic_to_enu(point: Point3, origin: Point3) -> Point3:
    """A point (lat_deg, lon_deg, alt_m) as metres (east, north, up) of `origin`, given alike."""
    sl, cl, so, co, x0, y0, z0 = _frame(origin)
    x, y, z = _geodetic_to_ecef(*point)
    dx, dy, dz = x - x0, y - y0, z - z0
    ring = co * dx + so * dy
    return co * dy - so * dx, cl * dz - sl * ring, cl * ring + sl * dz


def grid_m_to_wgs84(grid: GridSpec, x_m: float, y_m: float) -> tuple[float, float]:
    """Metres along the grid's axes from its origin, as (lat_deg, lon_deg) of the ellipsoid's point there."""
    heading = math.radians(grid.heading_deg)
    east = x_m * math.cos(heading) + y_m * math.sin(heading)
    north = y_m * math.cos(heading) - x_m * math.sin(heading)
    up = lat = lon = 0.0
    for _ in range(3):  # down from the touching plane to the ellipsoid: 2 m at 5 km, converges at once
        lat, lon, alt = enu_to_geodetic((east, north, up), (grid.origin_lat_deg, grid.origin_lon_deg, 0.0))
        up -= alt
    return lat, wrap_lon_deg(lon)


def wgs84_to_grid_m(grid: GridSpec, lat_deg: float, lon_deg: float) -> Point:
    """(lat, lon) as metres along the grid's axes from its origin."""
    east, north, _ = geodetic_to_enu((lat_deg, lon_deg, 0.0), (grid.origin_lat_deg, grid.origin_lon_deg, 0.0))
    heading = math.radians(grid.heading_deg)
    return (
        east * math.cos(heading) - north * math.sin(heading),
        east * math.sin(heading) + north * math.cos(heading),
    )


def cell_centre_m(grid: GridSpec, cell: Cell) -> Point:
    """The centre of a cell in metres along the grid's axes."""
    return (cell[0] + 0.5) * grid.cell_m, (cell[1] + 0.5) * grid.cell_m


def cell_to_wgs84(grid: GridSpec, cell: Cell) -> tuple[float, float]:
    """The centre of a cell as (lat_deg, lon_deg)."""
    return grid_m_to_wgs84(grid, *cell_centre_m(grid, cell))


def inside_grid(grid: GridSpec, cell: Cell) -> bool:
    """Whether the grid has this cell."""
    return 0 <= cell[0] < grid.width and 0 <= cell[1] < grid.height


def wgs84_to_cell(grid: GridSpec, lat_deg: float, lon_deg: float) -> Cell | None:
    """The cell that holds (lat, lon), None outside the grid and for what is not a finite position."""
    if not (math.isfinite(lat_deg) and math.isfinite(lon_deg)):
        return None
    x_m, y_m = wgs84_to_grid_m(grid, lat_deg, lon_deg)
    cell = (math.floor(x_m / grid.cell_m), math.floor(y_m / grid.cell_m))
    return cell if inside_grid(grid, cell) else None


def expand(start: Cell, corners: tuple[Cell, ...]) -> tuple[Cell, ...] | None:
    """The cells from `start` through all corners, both ends included: undoes `grid.simplify`.

    None where a leg does not run along one axis, so that its cells are not defined.
    """
    cells = [start]
    for corner in corners:
        (x0, y0), (x1, y1) = cells[-1], corner
        if x0 != x1 and y0 != y1:
            return None
        step = ((x1 > x0) - (x1 < x0), (y1 > y0) - (y1 < y0))
        cells.extend((x0 + i * step[0], y0 + i * step[1]) for i in range(1, abs(x1 - x0) + abs(y1 - y0) + 1))
    return tuple(cells)


def is_rest(corners: tuple[Cell, ...], whole: tuple[Cell, ...], start: Cell, here: Cell) -> bool:
    """Whether a way through `corners` from `here` is what remains of the way from `start` through `whole`."""
    path = expand(start, whole)
    if path is None or here not in path:
        return False
    behind = set(path[: path.index(here) + 1])
    ahead = tuple(corner for corner in whole if corner not in behind)
    return corners == (ahead or whole[-1:])


def segment_inside(polygon: tuple[Point, ...], a: Point, b: Point) -> bool:
    """Whether the straight line from a to b stays inside a simple polygon (its border counts as inside)."""
    if not (point_inside(polygon, a) and point_inside(polygon, b)):
        return False
    if _is_convex(polygon):
        return True
    edges = list(zip(polygon, (*polygon[1:], polygon[0]), strict=True))
    cuts = sorted({0.0, 1.0, *(t for edge in edges for t in _crossings(a, b, *edge))})
    # between two neighbouring cuts the line is wholly inside or wholly outside
    return all(point_inside(polygon, _between(a, b, (s + t) / 2)) for s, t in pairwise(cuts))


def point_inside(polygon: tuple[Point, ...], p: Point) -> bool:
    """Whether a point lies in a simple polygon, its border (within 1 mm) included."""
    edges = list(zip(polygon, (*polygon[1:], polygon[0]), strict=True))
    inside = False
    for a, b in edges:
        if (a[1] > p[1]) != (b[1] > p[1]) and p[0] < a[0] + (p[1] - a[1]) / (b[1] - a[1]) * (b[0] - a[0]):
            inside = not inside
    return inside or any(distance_to_segment_m(p, a, b) <= 1e-3 for a, b in edges)


def self_crossing(polygon: tuple[Point, ...]) -> tuple[int, int] | None:
    """The first two edges that cross each other, by the number of the corner where each begins; None: it is simple."""
    edges = list(zip(polygon, (*polygon[1:], polygon[0]), strict=True))
    for i, (a, b) in enumerate(edges):
        for j in range(i + 2, len(edges) - (i == 0)):  # neighbours share a corner
            c, d = edges[j]
            if _apart(c, d, a, b) and _apart(a, b, c, d):
                return i, j
    return None


def _apart(p: Point, q: Point, a: Point, b: Point) -> bool:
    """Whether p and q lie on two sides of the line through a and b, each by more than 1 mm: touching is no crossing."""
    length = math.dist(a, b) or 1.0
    sides = [((b[0] - a[0]) * (o[1] - a[1]) - (b[1] - a[1]) * (o[0] - a[0])) / length for o in (p, q)]
    return min(sides) < -1e-3 and max(sides) > 1e-3


@lru_cache(maxsize=64)
def _is_convex(polygon: tuple[Point, ...]) -> bool:
    """Whether a simple polygon turns one way only."""
    n = len(polygon)
    corners = ((polygon[i - 1], polygon[i], polygon[(i + 1) % n]) for i in range(n))
    turns = [(b[0] - a[0]) * (c[1] - b[1]) - (b[1] - a[1]) * (c[0] - b[0]) for a, b, c in corners]
    return all(t >= 0 for t in turns) or all(t <= 0 for t in turns)


def _between(a: Point, b: Point, t: float) -> Point:
    return a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])


def distance_to_segment_m(p: Point, a: Point, b: Point) -> float:
    """How near the straight line from a to b comes to p."""
    dx, dy = b[0] - a[0], b[1] - a[1]
    length2 = dx * dx + dy * dy
    t = 0.0 if length2 == 0 else min(1.0, max(0.0, ((p[0] - a[0]) * dx + (p[1] - a[1]) * dy) / length2))
    return math.dist(p, _between(a, b, t))


def _crossings(a: Point, b: Point, c: Point, d: Point) -> tuple[float, ...]:
    """Where on a-b (0..1) the line meets the edge c-d; none for parallels, whose ends other edges mark."""
    rx, ry, sx, sy = b[0] - a[0], b[1] - a[1], d[0] - c[0], d[1] - c[1]
    cross = rx * sy - ry * sx
    if cross == 0:
        return ()
    t = ((c[0] - a[0]) * sy - (c[1] - a[1]) * sx) / cross
    u = ((c[0] - a[0]) * ry - (c[1] - a[1]) * rx) / cross
    return (t,) if 0 <= t <= 1 and -1e-9 <= u <= 1 + 1e-9 else ()
