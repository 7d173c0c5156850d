"""The classical rules."""

from __future__ import annotations

import numpy as np
from builders import belief_of, robot, view_of

from gatar_edge.allocators.base import NO_TARGET
from gatar_edge.allocators.greedy import Greedy, greedy_pairs
from gatar_edge.allocators.nearest import Nearest
from gatar_edge.types import RobotKind


def test_greedy_takes_the_shortest_pair_first_and_removes_both() -> None:
    times = np.array([[1.0, 2.0], [1.5, 9.0]])
    assert greedy_pairs(times).tolist() == [0, 1]


def test_greedy_leaves_surplus_robots_and_impossible_pairs_without_a_target() -> None:
    assert greedy_pairs(np.array([[np.inf, 3.0], [np.inf, 2.0], [np.inf, 1.0]])).tolist() == [NO_TARGET, NO_TARGET, 1]


def test_every_robot_of_a_graph_finds_the_same_greedy_assignment() -> None:
    belief = belief_of("T..T..T\n.......\nT..T..T")
    team = [robot(i, ((i * 3) % 7, (i * 2) % 3)) for i in range(1, 5)]
    answers = []
    for ego in team:
        view = view_of(belief, ego, [r for r in team if r is not ego], r_comm=20)
        answers.append({r.robot_id: int(c) for r, c in zip(view.robots, Greedy().allocate(view).choices, strict=True)})
    assert all(answer == answers[0] for answer in answers)
    assert len(set(answers[0].values())) == 4


def test_greedy_goes_by_time_so_that_a_faster_robot_gets_the_farther_target() -> None:
    view = view_of(belief_of("...T...."), robot(1, (0, 0)), [robot(2, (7, 0), speed=2.0)])
    assert Greedy().allocate(view).choices.tolist() == [NO_TARGET, 0]


def test_nearest_ignores_the_others() -> None:
    view = view_of(belief_of("T......T"), robot(1, (2, 0)), [robot(2, (1, 0))])
    assert Nearest().allocate(view).choices.tolist() == [0, 0]


def test_nearest_gives_no_target_where_none_can_be_reached() -> None:
    view = view_of(belief_of("..#T"), robot(1, (0, 0), RobotKind.UGV))
    assert Nearest().allocate(view).choices.tolist() == [NO_TARGET]


def test_no_targets_no_choices() -> None:
    view = view_of(belief_of("..."), robot(1, (0, 0)))
    for rule in (Greedy(), Nearest()):
        assert rule.allocate(view).choices.tolist() == [NO_TARGET]
