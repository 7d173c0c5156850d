"""One robot's picture at a decision."""

from __future__ import annotations

import numpy as np
from builders import belief_of, robot, view_of
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from gatar_edge.allocators.greedy import Greedy
from gatar_edge.grid import UNREACHABLE
from gatar_edge.tasks import Rules, Task, decide
from gatar_edge.types import RobotKind
from gatar_edge.view import (
    FAR_HOPS,
    build_view,
    distances_of,
    hop_counts,
    hops_from_ego,
    travel_times,
    with_absent,
    without,
)

OPEN = belief_of("\n".join(["." * 20] * 3))


def test_hops_count_radio_links_up_to_the_limit() -> None:
    chain = [robot(1, (0, 0)), robot(2, (5, 0)), robot(3, (10, 0)), robot(4, (15, 0))]
    assert hop_counts(chain, 6, 2)[0].tolist() == [0, 1, 2, -1]
    assert hop_counts(chain, 6, 3)[0].tolist() == [0, 1, 2, 3]


@given(
    cells=st.lists(st.tuples(st.integers(0, 14), st.integers(0, 14)), min_size=1, max_size=12),
    limit=st.integers(0, 4),
)
def test_the_hops_from_ego_are_the_first_row_of_all_hops(cells: list[tuple[int, int]], limit: int) -> None:
    team = [robot(number, cell) for number, cell in enumerate(cells, start=1)]
    assert hops_from_ego(team, 4.5, limit) == tuple(hop_counts(team, 4.5, limit)[0].tolist())


def test_the_radio_range_is_inclusive_and_round() -> None:
    assert hop_counts([robot(1, (0, 0)), robot(2, (6, 0))], 6, 1)[0, 1] == 1
    assert hop_counts([robot(1, (0, 0)), robot(2, (5, 4))], 6, 1)[0, 1] == -1


def test_ego_stands_first_and_the_rest_by_id() -> None:
    view = view_of(OPEN, robot(3, (0, 0)), [robot(4, (1, 0)), robot(1, (2, 0))])
    assert [r.robot_id for r in view.robots] == [3, 1, 4]


def test_targets_are_those_known_and_not_localized_in_order_of_cells() -> None:
    view = view_of(belief_of("T.x\n.T?\nT.."), robot(1, (1, 0)))
    assert view.targets.tolist() == [[0, 0], [0, 2], [1, 1]]
    assert view.lengths[0].tolist() == [1, 3, 1]


def test_of_too_many_targets_the_nearest_to_ego_are_kept_in_order_of_cells() -> None:
    view = build_view(0, robot(1, (1, 0)), [], belief_of("TTT\nT.T"), 6, 2, 2)
    assert view.targets.tolist() == [[0, 0], [1, 1]]


def test_each_robot_has_its_own_ways() -> None:
    belief = belief_of(".#T\n.#.\n...")
    view = view_of(belief, robot(1, (0, 2), RobotKind.UGV), [robot(2, (0, 2))])
    assert view.lengths[:, 0].tolist() == [6, 2]


def test_a_ground_robots_ways_lead_round_cells_that_it_cannot_reach_even_from_one_of_them() -> None:
    view = view_of(belief_of("..T\n...\n..."), robot(1, (0, 2), RobotKind.UGV))
    assert without(view, [(1, 2)]).lengths[0].tolist() == [4]
    assert without(view, [(0, 2), (1, 2)]).lengths[0].tolist() == [4]
    assert without(view, [(2, 2)]).lengths[0].tolist() == [UNREACHABLE]


def test_an_aerial_robot_flies_over_cells_that_it_cannot_stay_in() -> None:
    view = without(view_of(belief_of("..T\n...\n..."), robot(1, (0, 2))), [(0, 2), (0, 1), (1, 2), (1, 1)])
    assert view.lengths[0].tolist() == [2]
    assignment = decide(view, Greedy().allocate(view), Task(), Rules())
    assert assignment.path == ((0, 2), (1, 2), (2, 2))


def test_travel_time_counts_speed_and_is_infinite_where_there_is_no_way() -> None:
    belief = belief_of("..#T")
    view = view_of(belief, robot(1, (0, 0), RobotKind.UGV), [robot(2, (0, 0), speed=2.0)])
    assert view.lengths[0, 0] == UNREACHABLE
    assert np.isinf(travel_times(view)[0, 0])
    assert travel_times(view)[1, 0] == 1.5


def test_a_view_without_targets_is_a_view() -> None:
    view = view_of(belief_of("..."), robot(1, (0, 0)), [robot(2, (2, 0))])
    assert view.lengths.shape == (2, 0)


def test_absent_robots_stand_by_id_among_the_others_with_their_own_ways_and_far_from_everybody() -> None:
    belief = belief_of("....#..T\n....#...\n....#...\n........")
    near, gone = [robot(5, (0, 1)), robot(2, (1, 0))], [robot(1, (7, 0), RobotKind.UGV), robot(4, (3, 3))]
    view = build_view(0, robot(3, (0, 0)), near, belief, 2, 2, 64, (gone[0], replace(gone[1], age_ns=7)))
    whole = with_absent(view)
    assert [r.robot_id for r in whole.robots] == [3, 1, 2, 4, 5]
    assert whole.robots[3].age_ns == 7
    assert whole.hops[0].tolist() == [0, FAR_HOPS, 1, FAR_HOPS, 1]
    assert whole.hops[2].tolist() == [1, FAR_HOPS, 0, FAR_HOPS, 1]
    assert (whole.hops == whole.hops.T).all()
    np.testing.assert_array_equal(whole.distances, distances_of(whole.robots, belief))
    assert whole.lengths[:, 0].tolist() == [10, 3, 9, 4, 9]
    np.testing.assert_array_equal(whole.targets, view.targets)


def test_a_neighbour_that_left_the_graph_is_far_from_everybody_too() -> None:
    chain = [robot(2, (5, 0)), robot(3, (19, 0))]
    view = with_absent(view_of(OPEN, robot(1, (0, 0)), chain))
    assert view.hops.tolist() == [[0, 1, FAR_HOPS], [1, 0, FAR_HOPS], [FAR_HOPS, FAR_HOPS, 0]]


def test_absent_robots_change_nothing_of_ego_and_its_neighbours() -> None:
    view = build_view(0, robot(1, (0, 0)), [robot(2, (5, 0))], OPEN, 6, 2, 64, (robot(3, (19, 0)),))
    whole = with_absent(view)
    np.testing.assert_array_equal(whole.distances[:2], view.distances)
    np.testing.assert_array_equal(whole.hops[:2, :2], view.hops)
    assert whole.robots[:2] == view.robots
