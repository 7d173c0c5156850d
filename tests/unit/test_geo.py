"""Cells to WGS84 and back, paths to corners, and the fence's geometry."""

from __future__ import annotations

import math
from itertools import pairwise

import pymap3d
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gatar_edge.bridge import geo
from gatar_edge.grid import simplify
from gatar_edge.types import Cell, GridSpec

LAT = st.floats(-60, 60)
LON = st.floats(-180, 180)
GRIDS = st.builds(
    GridSpec,
    width=st.integers(1, 500),
    height=st.integers(1, 500),
    cell_m=st.floats(0.5, 50),
    origin_lat_deg=LAT,
    origin_lon_deg=LON,
    heading_deg=st.floats(-360, 360),
)


def metres_apart(a: tuple[float, float], b: tuple[float, float]) -> float:
    east, north, _ = pymap3d.geodetic2enu(*b, 0, *a, 0)
    return math.hypot(east, north)


@given(GRIDS, st.data())
def test_a_cell_survives_the_way_over_mavlink_integers_within_two_centimetres(
    grid: GridSpec, data: st.DataObject
) -> None:
    cell = (data.draw(st.integers(0, grid.width - 1)), data.draw(st.integers(0, grid.height - 1)))
    lat_e7, lon_e7 = map(geo.deg_e7, geo.cell_to_wgs84(grid, cell))
    assert -(2**31) <= lon_e7 < 2**31
    back = geo.wgs84_to_grid_m(grid, lat_e7 / 1e7, lon_e7 / 1e7)
    assert math.dist(back, geo.cell_centre_m(grid, cell)) < 0.02
    assert geo.wgs84_to_cell(grid, lat_e7 / 1e7, lon_e7 / 1e7) == cell


@given(
    st.tuples(st.floats(-5000, 5000), st.floats(-5000, 5000), st.floats(-500, 5000)),
    st.tuples(LAT, LON, st.floats(-100, 3000)),
)
def test_enu_to_geodetic_agrees_with_pymap3d(
    enu: tuple[float, float, float], origin: tuple[float, float, float]
) -> None:
    mine = geo.enu_to_geodetic(enu, origin)
    oracle = pymap3d.enu2geodetic(*enu, *origin)
    assert metres_apart(mine[:2], oracle[:2]) < 1e-4
    assert mine[2] == pytest.approx(oracle[2], abs=1e-4)
    assert geo.geodetic_to_enu(mine, origin) == pytest.approx(enu, abs=1e-4)


def test_the_origin_is_the_outer_south_west_corner_of_the_first_cell() -> None:
    grid = GridSpec(width=7, height=3, cell_m=20.0, origin_lat_deg=47.0, origin_lon_deg=8.0)
    lat, lon = geo.cell_to_wgs84(grid, (0, 0))
    east, north, _ = pymap3d.geodetic2enu(lat, lon, 0, 47.0, 8.0, 0)
    assert (east, north) == pytest.approx((10, 10), abs=1e-6)


@pytest.mark.parametrize(
    ("heading_deg", "east_m", "north_m"), [(0, 130, 30), (90, 30, -130), (180, -130, -30), (-90, -30, 130)]
)
def test_the_heading_turns_the_grid_clockwise_from_north(heading_deg: float, east_m: float, north_m: float) -> None:
    grid = GridSpec(width=7, height=3, cell_m=20.0, origin_lat_deg=47.0, origin_lon_deg=8.0, heading_deg=heading_deg)
    lat, lon = geo.cell_to_wgs84(grid, (6, 1))
    east, north, _ = pymap3d.geodetic2enu(lat, lon, 0, 47.0, 8.0, 0)
    assert (east, north) == pytest.approx((east_m, north_m), abs=1e-3)


def test_a_grid_over_the_antimeridian_has_cells_on_both_sides() -> None:
    grid = GridSpec(width=10, height=1, cell_m=100.0, origin_lat_deg=-17.0, origin_lon_deg=179.997)
    lons = [geo.cell_to_wgs84(grid, (x, 0))[1] for x in range(10)]
    assert lons[0] > 179
    assert lons[-1] < -179
    assert [geo.wgs84_to_cell(grid, -16.9996, lon) for lon in lons] == [(x, 0) for x in range(10)]


@pytest.mark.parametrize("lat_lon", [(math.nan, 8.0), (47.0, math.inf), (47.01, 8.0), (46.9999, 8.0)])
def test_what_is_not_in_the_grid_has_no_cell(lat_lon: tuple[float, float]) -> None:
    grid = GridSpec(width=7, height=3, cell_m=20.0, origin_lat_deg=47.0, origin_lon_deg=8.0)
    assert geo.wgs84_to_cell(grid, *lat_lon) is None


def test_degrees_are_rounded_not_truncated() -> None:
    assert geo.deg_e7(-35.36326219) == -353632622
    assert geo.deg_e7(180.0) == 1_800_000_000


@st.composite
def paths(draw: st.DrawFn) -> tuple[Cell, ...]:
    """4-connected walks that never turn back on the spot, as a shortest path never does."""
    path, last = [(0, 0)], (0, 0)
    for step in draw(st.lists(st.sampled_from([(1, 0), (-1, 0), (0, 1), (0, -1)]), max_size=40)):
        if step != (-last[0], -last[1]):
            path.append((path[-1][0] + step[0], path[-1][1] + step[1]))
            last = step
    return tuple(path)


@given(paths())
def test_the_simplified_path_runs_through_exactly_the_cells_of_the_path(path: tuple[Cell, ...]) -> None:
    corners = simplify(path)
    if len(path) == 1:
        assert corners == path
    else:
        assert geo.expand(path[0], corners) == path


@given(paths())
def test_a_simplified_path_touches_no_cell_off_the_path(path: tuple[Cell, ...]) -> None:
    # sampled along the straight lines between centres, so that a diagonal leg would show
    stops = (path[0], *simplify(path))
    for a, b in pairwise(stops):
        for i in range(101):
            x, y = a[0] + (b[0] - a[0]) * i / 100, a[1] + (b[1] - a[1]) * i / 100
            assert (math.floor(x + 0.5), math.floor(y + 0.5)) in path


def test_only_corners_and_the_goal_remain() -> None:
    assert simplify(((0, 0), (0, 1), (0, 2), (1, 2), (2, 2))) == ((0, 2), (2, 2))
    assert simplify(()) == ()


def test_a_diagonal_leg_has_no_cells() -> None:
    assert geo.expand((0, 0), ((2, 1),)) is None


U_SHAPE = ((0.0, 0.0), (30.0, 0.0), (30.0, 30.0), (20.0, 30.0), (20.0, 10.0), (10.0, 10.0), (10.0, 30.0), (0.0, 30.0))


@pytest.mark.parametrize(
    ("a", "b", "inside"),
    [
        ((5, 25), (5, 5), True),
        ((5, 25), (25, 25), False),  # over the gap
        ((5, 5), (25, 5), True),
        ((0, 0), (30, 0), True),  # along the border
        ((5, 25), (15, 25), False),  # ends outside
        ((5, 10), (25, 10), True),  # along the bottom of the gap
        ((5, 25), (25, 2), False),  # cuts the corner of the gap
        ((5, 5), (5, 5), True),
    ],
)
def test_a_leg_may_not_leave_a_fence_that_is_not_convex(
    a: tuple[float, float], b: tuple[float, float], inside: bool
) -> None:
    assert geo.segment_inside(U_SHAPE, a, b) is inside
    assert geo.segment_inside(U_SHAPE, b, a) is inside


@given(st.floats(-10, 40), st.floats(-10, 40))
def test_a_point_is_inside_the_u_where_its_rectangles_say_so(x: float, y: float) -> None:
    gap = 10.01 < x < 19.99 and y > 10.01
    inside = 0 <= x <= 30 and 0 <= y <= 30 and not gap
    near_border = min(abs(x - v) for v in (0, 10, 20, 30)) < 0.02 or min(abs(y - v) for v in (0, 10, 30)) < 0.02
    assert near_border or geo.point_inside(U_SHAPE, (x, y)) is inside


@pytest.mark.parametrize(
    ("polygon", "crossing"),
    [
        (((0, 0), (9, 0), (9, 9), (0, 9)), None),
        (((0, 0), (0, 9), (9, 9), (9, 0)), None),  # the other way round
        (((0, 0), (9, 0), (9, 9), (0, 9), (0, 0)), None),  # closed
        (((0, 0), (9, 0), (9, 9), (5, 9), (5, 0), (5, 9), (0, 9)), None),  # there and back on a line
        (((0, 0), (9, 9), (9, 0), (0, 9)), (0, 2)),
        (((5, 0), (8, 9), (0, 3), (9, 3), (2, 9)), (0, 2)),  # a star turns one way only
        (((0, 0), (9, 0), (9, 9), (4, -1)), (0, 2)),
    ],
)
def test_a_polygon_that_crosses_itself_is_told_from_one_that_does_not(
    polygon: tuple[geo.Point, ...], crossing: tuple[int, int] | None
) -> None:
    assert geo.self_crossing(polygon) == crossing
