"""Places to go and look: one of each block that is not known yet."""

from __future__ import annotations

import numpy as np
import pytest
from builders import belief_of, robot, view_of

from gatar_edge.explore import FRONTIER_BLOCK, frontiers, settled
from gatar_edge.types import CellState, RobotKind, RobotState
from gatar_edge.view import distances_of

CORNER = [robot(1, (0, 0))]


def found(picture: str, robots: list[RobotState] = CORNER, most: int = 24) -> list[tuple[int, int, int]]:
    """x, y and unknown cells of each frontier."""
    belief = belief_of(picture)
    cells, dark = frontiers(belief, distances_of(robots, belief), most)
    return [(int(x), int(y), int(count)) for (x, y), count in zip(cells, dark, strict=True)]


def test_every_block_with_something_unknown_gives_one_place() -> None:
    assert found("....????????\n" * 4) == [(5, 1, 16), (9, 1, 16)]


def test_blocks_at_the_edge_of_the_world_may_be_smaller() -> None:
    assert found(".....?\n" * 5) == [(5, 1, 4), (5, 4, 1)]


@pytest.mark.parametrize(
    ("picture", "place"),
    [
        ("?...\n....\n?...\n?...", (0, 1, 3)),  # middle (0, 1.3)
        ("????\n...?\n...?\n....", (2, 3, 6)),  # middle (2, 2.5)
        ("?..?\n....\n....\n?..?", (0, 0, 4)),  # all alike: the first
    ],
)
def test_a_place_is_the_unknown_cell_nearest_to_the_middle_of_the_blocks_unknown_cells(
    picture: str, place: tuple[int, int, int]
) -> None:
    assert found(picture) == [place]


def test_a_place_stays_while_its_own_block_is_as_unknown_as_before() -> None:
    assert found("....?.......\n" + "............\n" * 3) == [(4, 3, 1)]
    assert found("?????.....??\n" + "............\n" * 3)[1] == (4, 3, 1)


def test_of_too_many_places_those_that_some_robot_reaches_soonest_are_kept_in_order_of_cells() -> None:
    picture = "?...?...?...?...\n" + "................\n" * 3
    assert [x for x, _, _ in found(picture, [robot(1, (15, 3))], 2)] == [8, 12]
    assert [x for x, _, _ in found(picture, [robot(1, (15, 3)), robot(2, (0, 3))], 2)] == [0, 12]


def test_a_place_that_no_robot_reaches_is_left_out() -> None:
    picture = "....#...#..?\n" * 4
    assert found(picture, [robot(1, (0, 0), RobotKind.UGV)]) == []
    assert len(found(picture, [robot(1, (0, 0), RobotKind.UGV), robot(2, (0, 0))])) == 1


def test_where_everything_is_known_there_is_no_place() -> None:
    assert found(".T#x\n....") == []


def test_the_places_unknown_cells_are_all_that_are_unknown() -> None:
    rng = np.random.default_rng(4)
    for _ in range(50):
        belief = rng.choice(np.array([0, 1, 2, 3], dtype=np.uint8), size=tuple(rng.integers(1, 24, 2)))
        cells, dark = frontiers(belief, distances_of(CORNER, belief), 1000)
        assert dark.sum() == (belief == CellState.UNKNOWN).sum()
        assert (belief[cells[:, 0], cells[:, 1]] == CellState.UNKNOWN).all()
        assert len(np.unique(cells // FRONTIER_BLOCK, axis=0)) == len(cells)


@pytest.mark.parametrize(
    ("heading", "goes_to"),
    [
        ((4, 3), (4, 3)),  # in the block and still unknown
        ((5, 3), (6, 1)),  # seen by now
        ((8, 3), (6, 1)),  # another block
        ((-1, -1), (6, 1)),  # nowhere
    ],
)
def test_a_robot_goes_on_to_where_it_was_going_while_that_is_unknown_and_in_the_chosen_block(
    heading: tuple[int, int], goes_to: tuple[int, int]
) -> None:
    view = view_of(belief_of("....?..?????\n" + "......??????\n" * 3), robot(1, (0, 0)))
    assert settled(view, (6, 1), heading) == goes_to


def test_a_robot_does_not_go_on_to_where_no_way_leads() -> None:
    view = view_of(belief_of("....#?\n....##\n.....?\n......"), robot(1, (0, 0), RobotKind.UGV))
    assert settled(view, (5, 1), (5, 3)) == (5, 1)
