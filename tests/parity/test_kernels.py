"""The compiled loops of data generation give what the robot's own code gives."""

import numpy as np
import pytest

from gatar_edge import belief as beliefs
from gatar_edge import grid
from gatar_edge.allocators.greedy import greedy_pairs
from gatar_edge.explore import frontiers
from gatar_edge.features import PLACE_FEATURES, features
from gatar_edge.learn import kernels
from gatar_edge.learn.plans import hidden_density
from gatar_edge.sim_sitl.world import Team, observe, random_obstacles, random_world
from gatar_edge.types import CellState, GridSpec, RobotKind, RobotState
from gatar_edge.view import build_view, distances_of, hop_counts

pytestmark = pytest.mark.usefixtures("compiled")


def maps(count):
    rng = np.random.default_rng(5)
    for _ in range(count):
        shape = (int(rng.integers(5, 25)), int(rng.integers(5, 25)))
        obstacles = random_obstacles(*shape, rng)
        if rng.random() < 0.5:
            obstacles |= rng.random(shape) < 0.3
        yield obstacles, (int(rng.integers(shape[0])), int(rng.integers(shape[1]))), rng


@pytest.mark.parametrize("kind", RobotKind)
@pytest.mark.parametrize("r_sense", [1.0, 4.0, 4.5, 7.0])
def test_the_compiled_field_of_view_is_tcods(kind, r_sense):
    rows = np.zeros((64, 3), dtype=np.float32)
    for obstacles, cell, _ in maps(200):
        seen = np.zeros(obstacles.shape, dtype=np.bool_)
        kernels.field_of_view(obstacles, kind == RobotKind.UGV, *cell, r_sense, seen, rows)
        np.testing.assert_array_equal(seen, grid.field_of_view(kind, cell, obstacles, r_sense))


@pytest.mark.parametrize("kind", RobotKind)
def test_the_compiled_path_lengths_are_those_of_the_robot(kind):
    for obstacles, cell, _ in maps(100):
        belief = np.where(obstacles, CellState.OBSTACLE, CellState.FREE).astype(np.uint8)
        lengths = np.zeros(obstacles.shape, dtype=np.int32)
        kernels.path_lengths(belief, kind == RobotKind.UGV, *cell, lengths, np.zeros(obstacles.size, dtype=np.int64))
        np.testing.assert_array_equal(lengths, grid.path_lengths(kind, cell, grid.passable(kind, belief)))


def test_following_the_next_step_takes_as_many_steps_as_the_length_says():
    for obstacles, start, rng in maps(50):
        belief = np.where(obstacles, CellState.OBSTACLE, CellState.FREE).astype(np.uint8)
        lengths = np.zeros(obstacles.shape, dtype=np.int32)
        queue = np.zeros(obstacles.size, dtype=np.int64)
        kernels.path_lengths(belief, True, *start, lengths, queue)
        goals = np.argwhere(lengths > 0)
        if not len(goals):
            continue
        goal = goals[rng.integers(len(goals))]
        cell, expected = start, int(lengths[tuple(goal)])
        for _ in range(expected):
            cell = kernels.next_step(lengths, *goal)
            kernels.path_lengths(belief, True, *cell, lengths, queue)
        assert cell == tuple(goal)


def test_the_compiled_hop_counts_are_the_views():
    rng = np.random.default_rng(1)
    for _ in range(100):
        cells = rng.integers(0, 15, size=(int(rng.integers(1, 13)), 2))
        r_comm, limit = float(rng.choice([0, 1, 3, 5, 6, 10])), int(rng.integers(1, 4))
        robots = [RobotState(i + 1, RobotKind.UAV, (int(x), int(y)), 1.0) for i, (x, y) in enumerate(cells)]
        hops = np.zeros((len(cells), len(cells)), dtype=np.int64)
        kernels.hop_counts(cells, r_comm, limit, hops)
        np.testing.assert_array_equal(hops, hop_counts(robots, r_comm, limit))


def test_the_compiled_greedy_is_the_allocators_with_the_same_ties():
    rng = np.random.default_rng(2)
    for _ in range(200):
        lengths = rng.integers(-1, 6, size=(int(rng.integers(1, 13)), int(rng.integers(1, 30))))
        times = np.where(lengths < 0, np.inf, lengths / rng.choice([1.0, 2.0], size=(len(lengths), 1)))
        choices = np.zeros(len(lengths), dtype=np.int64)
        kernels.greedy(times.copy(), choices)
        np.testing.assert_array_equal(choices, greedy_pairs(times))


def test_the_compiled_observation_is_the_beliefs():
    rows = np.zeros((64, 3), dtype=np.float32)
    for seed in range(30):
        world = random_world(Team.parse("1A1G"), 25, 15, 15, seed)
        here = np.zeros(world.shape, dtype=np.bool_)
        here[world.targets[:, 0], world.targets[:, 1]] = True
        rng = np.random.default_rng(seed)
        for index, kind in enumerate(world.team.kinds):
            old = rng.choice([0, 1, 4], size=world.shape).astype(np.uint8)
            cell = tuple(int(v) for v in world.targets[rng.integers(25)])
            new, seen = old.copy(), np.zeros(world.shape, dtype=np.bool_)
            kernels.field_of_view(world.obstacles, kind == RobotKind.UGV, *cell, 4.0, seen, rows)
            kernels.observe(new, world.obstacles, here, seen, *cell)
            np.testing.assert_array_equal(new, beliefs.observed(old, observe(world, index + 1, cell, 4.0, 0)))


def test_packing_loses_nothing_and_takes_three_bits_a_cell():
    rng = np.random.default_rng(3)
    for shape in [(15, 15), (5, 7), (16, 16), (48, 48)]:
        belief = rng.integers(0, 5, size=shape).astype(np.uint8)
        packed = np.zeros(-(-3 * belief.size // 8), dtype=np.uint8)
        kernels.pack(belief, packed)
        back = np.zeros_like(belief)
        kernels.unpack(packed, back)
        np.testing.assert_array_equal(back, belief)
    assert beliefs.nothing_known(GridSpec()).size * 3 / 8 <= 85


def dim_views(count):
    """Half-known worlds with one to four robots in them."""
    for obstacles, _, rng in maps(count):
        belief = np.where(obstacles, CellState.OBSTACLE, CellState.FREE).astype(np.uint8)
        belief[rng.random(belief.shape) < rng.random()] = CellState.UNKNOWN
        belief[rng.random(belief.shape) < 0.05] = rng.choice([CellState.TARGET, CellState.LOCALIZED])
        cells = np.argwhere(belief >= 0)[rng.permutation(belief.size)[: rng.integers(1, 5)]]
        robots = [
            RobotState(n + 1, RobotKind(int(rng.integers(2))), (int(x), int(y)), 1.0) for n, (x, y) in enumerate(cells)
        ]
        yield build_view(0, robots[0], robots[1:], belief, 6.0, 2, 64), rng


def test_the_compiled_frontiers_are_those_of_the_robot():
    some = 0
    for view, rng in dim_views(200):
        most = int(rng.choice([1, 3, 24]))
        cells, dark = np.zeros((most, 2), dtype=np.int64), np.zeros(most, dtype=np.int64)
        distances = distances_of(view.robots, view.belief)
        count = kernels.list_frontiers(view.belief, distances, most, cells, dark)
        wanted, unknown = frontiers(view.belief, distances, most)
        np.testing.assert_array_equal(cells[:count], wanted)
        np.testing.assert_array_equal(dark[:count], unknown)
        some += count == most
    assert some > 50


def test_the_teacher_expects_as_many_hidden_targets_as_the_network_is_told():
    judged = 0
    for view, _ in dim_views(60):
        places = features(view, with_frontiers=True)["places"]
        frontier = places[:, PLACE_FEATURES.index("frontier")] > 0
        dark = frontiers(view.belief, view.distances)[1]
        hidden = places[frontier, PLACE_FEATURES.index("hidden")]
        np.testing.assert_allclose(hidden, dark[: len(hidden)] * hidden_density(view.belief), rtol=1e-6)
        judged += len(hidden)
    assert judged > 100
