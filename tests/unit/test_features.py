"""The network's input: the paper's four channels, and features of robots and candidates."""

from dataclasses import replace

import numpy as np
import pytest

from gatar_edge import features as f
from gatar_edge.belief import nothing_known
from gatar_edge.export.states import random_view
from gatar_edge.manifest import GOLDEN_SCALE, golden_digest, golden_view
from gatar_edge.types import CellState, GridSpec, RobotKind, RobotState
from gatar_edge.view import build_view

HALF = f.WINDOW // 2
PAIR = {name: index for index, name in enumerate(f.PAIR_FEATURES)}
ROBOT = {name: index for index, name in enumerate(f.ROBOT_FEATURES)}


def view_of(belief, *robots, r_comm=6.0):
    belief.flags.writeable = False
    return build_view(0, robots[0], robots[1:], belief, r_comm, 2, 64)


def known(width=15, height=15):
    return np.full((width, height), CellState.FREE, dtype=np.uint8)


def uav(robot_id, cell, speed=1.0):
    return RobotState(robot_id, RobotKind.UAV, cell, speed)


def ugv(robot_id, cell, speed=1.0):
    return RobotState(robot_id, RobotKind.UGV, cell, speed)


def test_the_reward_is_speed_over_the_shortest_way():
    belief = known()
    belief[8, 3:12] = CellState.OBSTACLE
    maps = f.features(view_of(belief, ugv(1, (7, 7)), uav(2, (7, 7))))["maps"]
    assert maps[0, 0, HALF, HALF] == pytest.approx(1 / f.EPSILON)
    assert maps[0, 0, HALF + 2, HALF] == pytest.approx(1 / (12 + f.EPSILON))  # round the wall: 5 + 2 + 5
    assert maps[1, 0, HALF + 2, HALF] == pytest.approx(1 / (2 + f.EPSILON))  # over it
    assert maps[0, 0, HALF + 1, HALF] == 0  # nobody drives into a wall


def test_the_gaussian_map_peaks_at_each_target_and_takes_the_larger_of_two():
    belief = known()
    belief[5, 7] = belief[9, 7] = CellState.TARGET
    gaussian = f.features(view_of(belief, uav(1, (7, 7))))["maps"][0, 1]
    assert gaussian[HALF - 2, HALF] == gaussian[HALF + 2, HALF] == 1
    assert gaussian[HALF, HALF] == pytest.approx(np.exp(-4))  # not the sum of both
    assert gaussian[HALF + 2, HALF + 1] == pytest.approx(np.exp(-1))


def test_the_obstacle_map_shows_known_obstacles_and_nothing_outside_the_world():
    belief = known()
    belief[2, 1] = CellState.OBSTACLE
    obstacles = f.features(view_of(belief, uav(1, (1, 1))))["maps"][0, 2]
    assert obstacles.sum() == 1
    assert obstacles[HALF + 1, HALF] == 1


def test_the_product_map_is_the_product():
    maps = f.features(random_view(6, 9, 1, 6.0))["maps"]
    np.testing.assert_array_equal(maps[:, 3], maps[:, 0] * maps[:, 1])


def test_every_map_is_zero_outside_the_world():
    belief = known()
    belief[0, 0] = CellState.TARGET
    maps = f.features(view_of(belief, uav(1, (0, 0))))["maps"][0]
    assert not maps[:, :HALF].any()
    assert not maps[:, :, :HALF].any()


def test_an_unreachable_target_is_not_valid_and_has_no_reward():
    belief = known()
    belief[8, :] = CellState.OBSTACLE
    belief[10, 3] = CellState.TARGET
    inputs = f.features(view_of(belief, ugv(1, (2, 3)), uav(2, (2, 3))))
    assert inputs["valid"].tolist() == [[0.0], [1.0]]
    assert inputs["pairs"][0, 0, PAIR["reward"]] == 0
    assert inputs["pairs"][0, 0, PAIR["reachable"]] == 0
    assert inputs["pairs"][1, 0, PAIR["time"]] == pytest.approx(0.8)


def test_speeds_count_relative_to_the_fastest_so_that_their_unit_does_not_matter():
    belief = known()
    belief[10, 3] = CellState.TARGET
    slow = f.features(view_of(belief, ugv(1, (2, 3), 0.25), uav(2, (2, 3), 0.5)))
    fast = f.features(view_of(belief.copy(), ugv(1, (2, 3), 2.0), uav(2, (2, 3), 4.0)))
    for name, array in slow.items():
        np.testing.assert_array_equal(array, fast[name])
    assert slow["pairs"][0, 0, PAIR["time"]] == 2 * slow["pairs"][1, 0, PAIR["time"]]


def test_robots_are_ranked_by_id_and_targets_by_cell():
    belief = known()
    belief[3, 9] = belief[3, 4] = belief[1, 1] = CellState.TARGET
    inputs = f.features(view_of(belief, uav(7, (7, 7)), uav(9, (6, 7)), uav(2, (5, 7))))
    ranks = inputs["robots"][:, ROBOT["rank"]] * f.RANK_SCALE
    assert ranks.tolist() == [1, 0, 2]  # ids 7, 2, 9: ego first, the rest by id
    assert (inputs["pairs"][0, :, PAIR["target_rank"]] * f.TARGET_RANK_SCALE).tolist() == [0, 1, 2]


def test_a_target_outside_the_window_is_marked_and_reads_no_cell():
    belief = known(40, 40)
    belief[30, 5] = belief[8, 5] = CellState.TARGET
    inputs = f.features(view_of(belief, uav(1, (5, 5))))
    assert inputs["pairs"][0, :, PAIR["inside"]].tolist() == [1, 0]
    assert inputs["cells"][0].tolist() == [(HALF + 3) * f.WINDOW + HALF, 0]


def test_the_unknown_share_counts_unknown_cells_round_a_target():
    belief = known()
    belief[10, 10] = CellState.TARGET
    belief[11, 8:13] = CellState.UNKNOWN
    pairs = f.features(view_of(belief, uav(1, (3, 3))))["pairs"]
    assert pairs[0, 0, PAIR["unknown"]] == pytest.approx(5 / 25)


def test_without_targets_there_is_one_empty_candidate():
    inputs = f.features(view_of(nothing_known(GridSpec()).copy(), uav(1, (3, 3))))
    assert inputs["pairs"].shape == (1, 1, len(f.PAIR_FEATURES))
    assert not inputs["valid"].any()
    assert not inputs["pairs"].any()


@pytest.mark.parametrize("robots", [1, 2, 12, 64])
@pytest.mark.parametrize("candidates", [0, 1, 30, 64])
def test_axes_types_and_values_are_as_contracted(robots, candidates):
    inputs = f.features(random_view(robots, candidates, 0, 6.0))
    sizes = {**f.SIZES, "N": robots, "M": max(1, candidates)}
    assert set(inputs) == set(f.AXES)
    for name, array in inputs.items():
        assert array.shape == tuple(sizes[axis] for axis in f.AXES[name]), name
        assert array.dtype == (np.int64 if name in {"cells", "hops"} else np.float32), name
        assert np.isfinite(array).all(), name


def test_without_windows_all_the_rest_is_the_same():
    whole, rest = (f.features(random_view(5, 8, 1, 6.0), with_windows=asked) for asked in (True, False))
    assert set(whole) - set(rest) == {"maps", "cells"}
    for name, array in rest.items():
        np.testing.assert_array_equal(array, whole[name], err_msg=name)


def test_a_batch_of_views_gives_what_each_view_gives_alone():
    views = [f.arrays_of(random_view(5, 8, seed, 6.0)) for seed in range(4)]
    stacked = f.ViewArrays(*(np.stack([getattr(v, name) for v in views]) for name in f.ViewArrays.__slots__))
    together = f.features_of(stacked)
    for index, view in enumerate(views):
        for name, array in f.features_of(view).items():
            np.testing.assert_array_equal(together[name][index], array, err_msg=name)


def test_rows_that_fill_up_a_batch_change_nothing_and_are_zero():
    view = f.arrays_of(random_view(4, 6, 3, 6.0))
    wide = replace(
        view,
        **{
            name: np.concatenate([getattr(view, name), getattr(view, name)[:1]])
            for name in ("distances", "robots", "kinds", "speeds", "ids", "tasks", "ages_s")
        },
        present=np.array([True] * 4 + [False]),
        hops=np.pad(view.hops, ((0, 1), (0, 1)), constant_values=-1),
    )
    alone, padded = f.features_of(view), f.features_of(wide)
    for name in ("maps", "robots", "pairs", "valid"):
        np.testing.assert_array_equal(padded[name][:4], alone[name], err_msg=name)
        assert not padded[name][4].any(), name


def test_the_golden_input_is_not_on_the_edge_of_rounding():
    for name, array in f.features_of(golden_view()).items():
        scaled = np.asarray(array, dtype=np.float64) * GOLDEN_SCALE
        assert (np.abs(scaled - np.floor(scaled) - 0.5) > 1e-3).all(), name
    assert len(golden_digest()) == 16
