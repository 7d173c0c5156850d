"""What a robot knows, and how it comes to know more."""

from __future__ import annotations

import numpy as np
from builders import belief_of, observation

from gatar_edge.belief import WINDOW, merged, nothing_known, observed, window_at, window_origin
from gatar_edge.types import CellState, GridSpec

NOTHING = nothing_known(GridSpec(width=5, height=4))


def test_what_is_seen_is_known() -> None:
    belief = observed(NOTHING, observation((0, 0), seen=[(0, 0), (1, 0)], obstacles=[(2, 0)], targets=[(1, 1)]))
    assert [belief[0, 0], belief[2, 0], belief[1, 1], belief[4, 3]] == [
        CellState.FREE,
        CellState.OBSTACLE,
        CellState.TARGET,
        CellState.UNKNOWN,
    ]


def test_a_target_is_localized_by_being_there() -> None:
    belief = observed(NOTHING, observation((1, 1), targets=[(1, 1), (2, 1)]))
    assert (belief[1, 1], belief[2, 1]) == (CellState.LOCALIZED, CellState.TARGET)


def test_a_localized_target_stays_localized_though_it_still_looks_like_one() -> None:
    belief = observed(NOTHING, observation((1, 1), targets=[(1, 1)]))
    assert observed(belief, observation((2, 1), targets=[(1, 1)]))[1, 1] == CellState.LOCALIZED


def test_own_eyes_correct_an_obstacle_that_was_only_heard_of() -> None:
    heard = merged(NOTHING, (0, 0), np.full((1, 1), CellState.OBSTACLE, dtype=np.uint8))
    assert observed(heard, observation((1, 0), seen=[(0, 0)]))[0, 0] == CellState.FREE


def test_hearing_adds_knowledge_and_takes_none_away() -> None:
    mine, heard = belief_of("x.?\nT#?"), belief_of("T#.\n..T")
    assert merged(mine, (0, 0), heard).tolist() == belief_of("x#.\nT#T").tolist()


def test_parts_of_a_window_outside_the_grid_are_ignored() -> None:
    window = np.full((WINDOW, WINDOW), CellState.FREE, dtype=np.uint8)
    assert (merged(NOTHING, (-13, 2), window) == CellState.FREE).sum() == 4
    assert merged(NOTHING, (500, -500), window) is NOTHING


def test_observations_outside_the_grid_are_ignored() -> None:
    belief = observed(NOTHING, observation((-1, 9), seen=[(9, 9), (-1, 0)], targets=[(5, 0)]))
    assert not belief.any()


def test_beliefs_are_read_only() -> None:
    assert not NOTHING.flags.writeable
    assert not observed(NOTHING, observation((0, 0), seen=[(0, 0)])).flags.writeable


def test_in_a_world_of_one_window_each_message_carries_all_that_is_known() -> None:
    belief = np.random.default_rng(1).integers(0, 5, (15, 15)).astype(np.uint8)
    for sequence in range(4):
        origin = window_origin(belief, (14, 0), sequence)
        assert origin == (0, 0)
        assert (window_at(belief, origin) == belief).all()


def test_in_a_larger_world_every_known_cell_is_told_within_some_messages() -> None:
    belief = np.zeros((40, 33), dtype=np.uint8)
    belief[3:22, 5:33] = CellState.FREE
    told = nothing_known(GridSpec(width=40, height=33))
    for sequence in range(24):
        origin = window_origin(belief, (20, 30), sequence)
        told = merged(told, origin, window_at(belief, origin))
    assert (told == belief).all()


def test_every_other_message_of_a_larger_world_is_about_the_robots_surroundings() -> None:
    belief = np.full((40, 40), CellState.FREE, dtype=np.uint8)
    for sequence in (0, 2, 4):
        x, y = window_origin(belief, (20, 39), sequence)
        assert x <= 20 < x + WINDOW
        assert y <= 39 < y + WINDOW
