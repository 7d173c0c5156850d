"""What can be seen, how far it is, and the way there."""

from __future__ import annotations

import itertools
import tracemalloc
from collections import deque

import numpy as np
import pytest
from builders import belief_of

from gatar_edge.grid import CACHE_BYTES, UNREACHABLE, as_cells, field_of_view, passable, path_lengths, path_to
from gatar_edge.soak import resident_mb
from gatar_edge.types import RobotKind

WALL = belief_of(
    """
    ..#..
    ..#..
    ..#..
    ..#..
    .....
    """
)


def test_a_ground_robot_drives_round_a_wall_that_an_aerial_robot_crosses() -> None:
    ground = path_lengths(RobotKind.UGV, (0, 4), passable(RobotKind.UGV, WALL))
    aerial = path_lengths(RobotKind.UAV, (0, 4), passable(RobotKind.UAV, WALL))
    assert (ground[4, 4], aerial[4, 4]) == (12, 4)


@pytest.mark.parametrize("seed", range(20))
def test_driving_lengths_are_those_of_a_plain_breadth_first_search(seed: int) -> None:
    rng = np.random.default_rng(seed)
    width, height = (int(side) for side in rng.integers(1, 40, 2))
    free = rng.random((width, height)) < 0.7
    start = int(rng.integers(width)), int(rng.integers(height))
    expected = np.full(free.shape, UNREACHABLE)
    expected[start] = 0
    waiting = deque([start])
    while waiting:
        x, y = waiting.popleft()
        for cell in ((x + 1, y), (x - 1, y), (x, y + 1), (x, y - 1)):
            inside = 0 <= cell[0] < width and 0 <= cell[1] < height
            if inside and free[cell] and expected[cell] == UNREACHABLE:
                expected[cell] = expected[x, y] + 1
                waiting.append(cell)
    lengths = path_lengths(RobotKind.UGV, start, free)
    assert np.array_equal(lengths, expected)
    assert (lengths.dtype, lengths.flags.writeable) == (np.int32, False)


@pytest.mark.parametrize("kind", RobotKind)
def test_the_ways_that_are_remembered_on_large_grids_stay_within_the_bytes_allowed(kind: RobotKind) -> None:
    path_lengths(kind, (0, 0), np.zeros((3, 3), dtype=np.bool_))  # whatever was remembered before is of another size
    tracemalloc.start()
    try:
        for width in (200, 190):
            walled_in = np.zeros((width, 200), dtype=np.bool_)
            for number in range(300):  # 48 to 60 MB
                path_lengths(kind, (number % width, number // width), walled_in)
        held, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert CACHE_BYTES / 2 < held < CACHE_BYTES * 1.05


def test_the_ways_on_thousands_of_maps_leave_no_memory_behind() -> None:
    def search(maps: int) -> None:
        for number in range(maps):
            free = np.ones((15, 15), dtype=np.bool_)
            free.reshape(-1)[1:17] = [number >> bit & 1 for bit in range(16)]
            path_lengths(RobotKind.UGV, (7, 7), free)

    search(2000)  # fills the cache
    before = resident_mb()
    search(6000)
    assert resident_mb() - before < 6  # a leak of 4 KB a call would be 23


def test_a_cell_behind_a_closed_wall_is_unreachable_on_the_ground() -> None:
    closed = belief_of("..#..\n..#..\n..#..")
    lengths = path_lengths(RobotKind.UGV, (0, 0), passable(RobotKind.UGV, closed))
    assert lengths[4, 0] == UNREACHABLE
    assert path_to((4, 0), lengths) == ()


def test_unknown_cells_count_as_free_until_they_are_seen() -> None:
    assert passable(RobotKind.UGV, belief_of("?#.")).tolist() == [[True], [False], [True]]


def test_a_path_joins_start_and_goal_by_single_steps_over_passable_cells() -> None:
    free = passable(RobotKind.UGV, WALL)
    path = path_to((4, 4), path_lengths(RobotKind.UGV, (0, 4), free))
    assert (path[0], path[-1], len(path)) == ((0, 4), (4, 4), 13)
    assert all(abs(a[0] - b[0]) + abs(a[1] - b[1]) == 1 for a, b in itertools.pairwise(path))
    assert all(free[cell] for cell in path)


def test_a_path_in_the_open_has_a_single_corner() -> None:
    path = path_to((5, 3), path_lengths(RobotKind.UGV, (0, 0), np.ones((8, 8), dtype=bool)))
    turns = sum(a[0] - b[0] != b[0] - c[0] for a, b, c in zip(path, path[1:], path[2:], strict=False))
    assert turns == 1


def test_a_robot_whose_own_cell_is_believed_blocked_can_leave_it() -> None:
    lengths = path_lengths(RobotKind.UGV, (1, 0), passable(RobotKind.UGV, belief_of(".#.")))
    assert lengths[2, 0] == 1


def test_an_obstacle_hides_what_is_behind_it_from_a_ground_robot_only() -> None:
    obstacles = np.zeros((9, 9), dtype=bool)
    obstacles[4, 4] = True
    ground = field_of_view(RobotKind.UGV, (2, 4), obstacles, 4)
    aerial = field_of_view(RobotKind.UAV, (2, 4), obstacles, 4)
    assert (ground[4, 4], ground[6, 4]) == (True, False)
    assert aerial[6, 4]


@pytest.mark.parametrize("kind", list(RobotKind))
def test_the_field_of_view_is_a_disc(kind: RobotKind) -> None:
    seen = field_of_view(kind, (7, 7), np.zeros((15, 15), dtype=bool), 4)
    assert len(as_cells(seen)) == 49  # lattice points within 4 of the centre
    assert (seen[11, 7], seen[10, 10]) == (True, False)


@pytest.mark.parametrize("seed", range(20))
def test_if_one_free_cell_sees_another_the_other_sees_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    obstacles = rng.random((12, 12)) < 0.2
    free = [tuple(int(c) for c in cell) for cell in as_cells(~obstacles)]
    views = {cell: field_of_view(RobotKind.UGV, cell, obstacles, 4) for cell in free}
    assert all(views[a][b] == views[b][a] for a in free for b in free)
