"""The gate: what passes, what is held back, and why."""

from __future__ import annotations

import dataclasses
import math

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gatar_edge.bridge.geo import cell_centre_m, inside_grid, point_inside
from gatar_edge.bridge.safety import Known, Limits, Refusal, gate
from gatar_edge.separation import Place
from gatar_edge.types import Goto, GridSpec, Hold, Mission, VehicleCommand

S = 1_000_000_000
GRID = GridSpec(width=15, height=10, cell_m=10.0)
RECTANGLE = ((0.0, 0.0), (150.0, 0.0), (150.0, 100.0), (0.0, 100.0))
NOTCHED = (
    (0.0, 0.0),
    (150.0, 0.0),
    (150.0, 100.0),
    (90.0, 100.0),
    (90.0, 40.0),
    (60.0, 40.0),
    (60.0, 100.0),
    (0.0, 100.0),
)
LIMITS = Limits(GRID, RECTANGLE, 20.0, (2.0, 120.0), S, S)
KNOWN = Known(
    now_ns=100 * S,
    pilot=False,
    ready=True,
    home=True,
    origin=True,
    position_m=(25.0, 75.0),
    position_ns=100 * S - S // 2,
    pursued=Goto((1, 1)),
    retasked_ns=50 * S,
)


def known(**changes: object) -> Known:
    return msgspec.structs.replace(KNOWN, **changes)  # type: ignore[arg-type]


def limits(**changes: object) -> Limits:
    return dataclasses.replace(LIMITS, **changes)  # type: ignore[arg-type]


@pytest.mark.parametrize("wanted", [Goto((9, 8)), Mission(((2, 2), (9, 2)))])
def test_a_command_with_nothing_against_it_passes_unchanged(wanted: VehicleCommand) -> None:
    assert gate(wanted, KNOWN, LIMITS) == wanted


@pytest.mark.parametrize(
    ("changes", "refusal"),
    [
        ({"pilot": True}, Refusal.PILOT),
        ({"ready": False}, Refusal.NOT_READY),
        ({"home": False}, Refusal.NO_HOME),
        ({"origin": False}, Refusal.NO_ORIGIN),
        ({"position_m": None}, Refusal.NO_POSITION),
        ({"position_ns": 100 * S - S - 1}, Refusal.STALE_POSITION),
    ],
)
def test_a_vehicle_that_cannot_obey_is_held_and_told_why(changes: dict[str, object], refusal: Refusal) -> None:
    assert gate(Goto((9, 8)), known(**changes), LIMITS) == Hold(refusal.value)


@pytest.mark.parametrize(
    ("wanted", "refusal"),
    [
        (Mission(()), Refusal.EMPTY),
        (Goto((15, 0)), Refusal.OUTSIDE_GRID),
        (Goto((0, -1)), Refusal.OUTSIDE_GRID),
        (Mission(((2, 2), (2, 10))), Refusal.OUTSIDE_GRID),
        (Goto((math.nan, 2)), Refusal.NOT_FINITE),  # type: ignore[arg-type]
        (Goto((math.inf, 2)), Refusal.NOT_FINITE),  # type: ignore[arg-type]
        (Goto(("x", 2)), Refusal.NOT_FINITE),  # type: ignore[arg-type]
        (Goto((10**400, 2)), Refusal.NOT_FINITE),
        (Mission(((1, 2, 3),)), Refusal.NOT_FINITE),  # type: ignore[arg-type]
    ],
)
def test_a_command_that_no_vehicle_may_follow_is_held_and_told_why(wanted: VehicleCommand, refusal: Refusal) -> None:
    assert gate(wanted, KNOWN, LIMITS) == Hold(refusal.value)


@pytest.mark.parametrize("altitude_m", [1.9, 120.1, math.nan])
def test_an_altitude_outside_the_band_is_refused(altitude_m: float) -> None:
    assert gate(Goto((9, 8)), KNOWN, limits(altitude_m=altitude_m)) == Hold(Refusal.ALTITUDE.value)


@pytest.mark.parametrize(
    ("wanted", "passes"),
    [
        (Goto((7, 8)), False),  # in the notch
        (Goto((12, 8)), False),  # straight through the notch
        (Goto((5, 2)), True),
        (Mission(((2, 2), (12, 2), (12, 8))), True),  # round the notch
        (Mission(((2, 2), (2, 8), (12, 8))), False),
    ],
)
def test_neither_a_target_nor_the_way_to_it_may_leave_the_fence(wanted: VehicleCommand, passes: bool) -> None:
    expected = wanted if passes else Hold(Refusal.OUTSIDE_FENCE.value)
    assert gate(wanted, KNOWN, limits(fence_m=NOTCHED)) == expected


def test_a_vehicle_that_strayed_outside_the_fence_may_come_back() -> None:
    assert gate(Goto((2, 2)), known(position_m=(75.0, 75.0)), limits(fence_m=NOTCHED)) == Goto((2, 2))


@pytest.mark.parametrize(
    ("wanted", "neighbor", "passes"),
    [
        (Goto((9, 8)), Place((95.0, 85.0), 20.0), False),
        (Goto((9, 8)), Place((95.0, 79.9), 20.4), False),  # 5.1 m away
        (Goto((9, 8)), Place((95.0, 77.0), 20.0), True),  # 8 m away
        (Goto((9, 8)), Place((95.0, 85.0), 22.0), True),  # another layer
        (Mission(((2, 2), (9, 2))), Place((95.0, 25.0), 20.0), False),
        (Mission(((2, 2), (9, 2), (9, 5))), Place((95.0, 25.0), 20.0), True),  # it will be gone
        (Mission(((2, 2), (9, 2), (9, 5))), Place((95.0, 25.0), 20.0, stands=True), False),
        (Mission(((2, 2), (9, 2), (9, 5))), Place((65.0, 30.9), 20.0, stands=True), False),  # 5.9 m from a leg
        (Mission(((2, 2), (9, 2), (9, 5))), Place((65.0, 31.1), 20.0, stands=True), True),
        (Mission(((2, 2), (9, 2))), Place((25.0, 50.0), 20.0, stands=True), False),  # before the first corner
        (Mission(((2, 2), (2, 9), (9, 9))), Place((25.0, 25.0), 20.0, stands=True), True),  # at a corner long passed
        (Mission(((2, 9),)), Place((25.0, 71.0), 20.0, stands=True), True),  # away from one that stands too near
        (Mission(((2, 2),)), Place((25.0, 71.0), 20.0, stands=True), False),  # but not through it
    ],
)
def test_no_vehicle_goes_to_rest_where_another_one_of_its_layer_is_nor_past_one_that_stands(
    wanted: VehicleCommand, neighbor: Place, passes: bool
) -> None:
    expected = wanted if passes else Hold(Refusal.SEPARATION.value)
    assert gate(wanted, known(neighbors=(neighbor,)), limits(min_separation_m=6.0)) == expected
    assert gate(wanted, known(neighbors=(neighbor,)), LIMITS) == wanted  # not asked for


def test_too_soon_for_another_task_keeps_the_one_pursued() -> None:
    soon = known(retasked_ns=100 * S - S // 2)
    assert gate(Goto((9, 8)), soon, LIMITS) == Goto((1, 1))


@pytest.mark.parametrize("changes", [{"retasked_ns": -1}, {"retasked_ns": 99 * S}, {"pursued": Hold("x")}])
def test_it_is_not_too_soon_when_enough_time_went_by_or_nothing_was_pursued(changes: dict[str, object]) -> None:
    recent: dict[str, object] = {"retasked_ns": 100 * S - 1, **changes}
    assert gate(Goto((9, 8)), known(**recent), LIMITS) == Goto((9, 8))


@pytest.mark.parametrize("changes", [{}, {"pilot": True, "ready": False, "position_m": None}, {"retasked_ns": 100 * S}])
def test_a_hold_always_passes(changes: dict[str, object]) -> None:
    assert gate(Hold("mine"), known(**changes), LIMITS) == Hold("mine")


@given(
    st.lists(st.tuples(st.integers(-3, 18), st.integers(-3, 12)), max_size=4),
    st.tuples(st.floats(-50, 200), st.floats(-50, 150)),
    st.booleans(),
    st.integers(0, 3 * S),
)
def test_whatever_passes_is_inside_the_grid_and_the_fence(
    cells: list[tuple[int, int]], position: tuple[float, float], ready: bool, age_ns: int
) -> None:
    state = known(position_m=position, ready=ready, position_ns=100 * S - age_ns, pursued=Hold("start"))
    passed = gate(Mission(tuple(cells)), state, limits(fence_m=NOTCHED))
    if isinstance(passed, Mission):
        assert ready
        assert age_ns <= S
        assert passed.cells
        assert all(inside_grid(GRID, c) and point_inside(NOTCHED, cell_centre_m(GRID, c)) for c in passed.cells)
    else:
        assert isinstance(passed, Hold)
        assert passed.reason in {r.value for r in Refusal}
