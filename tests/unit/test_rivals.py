"""What every classical rule promises, and what each of them is for."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from gatar_edge.allocators.base import NO_TARGET
from gatar_edge.allocators.hungarian import least_sum_pairs
from gatar_edge.allocators.registry import BOUNDS, NAMES, hears_all, make
from gatar_edge.allocators.routing import plan_on_lists, problem_of
from gatar_edge.errors import ConfigError
from gatar_edge.grid import UNREACHABLE
from gatar_edge.types import ByteGrid, CellState, RobotKind, RobotState
from gatar_edge.view import View, build_view

RULES = [name for name in NAMES if name != "gatar"]


def belief_of(seed: int, obstacles: int = 40, targets: int = 12) -> ByteGrid:
    belief = np.full((15, 15), CellState.FREE, dtype=np.uint8)
    cells = np.random.default_rng(seed).permutation(225)
    belief.flat[cells[:obstacles]] = CellState.OBSTACLE
    belief.flat[cells[obstacles : obstacles + targets]] = CellState.TARGET
    return belief


def view_of(seed: int, ego: int = 0, robots: int = 6, targets: int = 12) -> View:
    belief = belief_of(seed, targets=targets)
    cells = np.argwhere(belief == CellState.FREE)
    places = np.random.default_rng(seed + 1).permutation(len(cells))[:robots]
    team = [
        RobotState(i + 1, RobotKind(i % 2), (int(cells[p][0]), int(cells[p][1])), 1.0 + i % 3)
        for i, p in enumerate(places)
    ]
    return build_view(7, team[ego], [r for r in team if r is not team[ego]], belief, 6.0, 2, 64)


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("seed", range(4))
def test_no_rule_sends_a_robot_where_it_cannot_go(rule: str, seed: int) -> None:
    view = view_of(seed)
    choices = make(rule)().allocate(view).choices
    assert all(view.lengths[row, choice] != UNREACHABLE for row, choice in enumerate(choices) if choice != NO_TARGET)


@pytest.mark.parametrize("rule", [rule for rule in RULES if rule != "cbba"])  # which agrees by talking, not by seeing
def test_every_rule_gives_the_team_the_same_plan_whoever_asks(rule: str) -> None:
    plans = []
    for ego in range(6):
        view = view_of(3, ego)
        choices = make(rule)().allocate(view).choices
        plans.append({robot.robot_id: int(choice) for robot, choice in zip(view.robots, choices, strict=True)})
    assert all(plan == plans[0] for plan in plans)


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("targets", [0, 1, 3])
def test_every_rule_copes_with_fewer_targets_than_robots(rule: str, targets: int) -> None:
    view = view_of(5, targets=targets)
    allocation = make(rule)().allocate(view)
    assert allocation.choices.shape == (6,)
    assert allocation.scores.shape == (6, targets)


@pytest.mark.parametrize("rule", ["greedy", "hungarian", "routing"])
def test_rules_that_look_at_the_team_never_send_two_robots_to_one_target(rule: str) -> None:
    choices = make(rule)().allocate(view_of(8)).choices
    assigned = choices[choices != NO_TARGET].tolist()
    assert len(assigned) == len(set(assigned))


def test_hungarian_finds_the_least_sum_over_all_permutations() -> None:
    times = np.random.default_rng(1).integers(1, 9, (4, 6)).astype(float)
    best = min(sum(times[i, j] for i, j in enumerate(p)) for p in itertools.permutations(range(6), 4))
    assert times[np.arange(4), least_sum_pairs(times)].sum() == best


def test_hungarian_rather_serves_all_robots_than_some_of_them_sooner() -> None:
    choices = least_sum_pairs(np.array([[1.0, 50.0], [2.0, np.inf]]))
    assert choices.tolist() == [1, 0]


def test_hungarian_leaves_a_robot_without_any_way_at_home() -> None:
    choices = least_sum_pairs(np.array([[np.inf, np.inf], [2.0, 3.0]]))
    assert choices.tolist() == [NO_TARGET, 0]


def test_hungarian_gives_low_targets_to_low_robots_where_the_sum_is_the_same() -> None:
    assert least_sum_pairs(np.full((3, 5), 4.0)).tolist() == [0, 1, 2]


def test_routing_passes_a_near_target_by_when_another_robot_comes_along_there_anyway() -> None:
    belief = np.full((15, 3), CellState.FREE, dtype=np.uint8)
    for cell in ((3, 1), (4, 1), (12, 1)):
        belief[cell] = CellState.TARGET
    left, right = RobotState(1, RobotKind.UAV, (1, 1), 1.0), RobotState(2, RobotKind.UAV, (7, 1), 1.0)
    view = build_view(0, right, [left], belief, 6.0, 2, 64)
    assert view.targets[make("greedy")().allocate(view).choices[0]].tolist() == [4, 1]
    assert view.targets[make("routing")().allocate(view).choices[0]].tolist() == [12, 1]


def test_tours_visit_every_reachable_target_once() -> None:
    problem = problem_of(view_of(11))
    stops = sorted(itertools.chain.from_iterable(plan_on_lists(problem, 50)))
    assert stops == np.flatnonzero(np.isfinite(problem.first).any(axis=0)).tolist()


def test_search_improves_on_insertion_alone() -> None:
    def cost(rounds: int) -> float:
        total, ends = 0.0, []
        for robot, tour in enumerate(plan_on_lists(problem, rounds)):
            legs = problem.legs[problem.kinds[robot]] * problem.pace[robot]
            hops = (
                [problem.first[robot][tour[0]], *(legs[a][b] for a, b in itertools.pairwise(tour))] if tour else [0.0]
            )
            total += float(np.cumsum(hops).sum())
            ends.append(sum(hops))
        return total + 5 * max(ends)

    problem = problem_of(view_of(2, robots=2, targets=20))
    assert cost(200) < 0.97 * cost(0)


def test_registry_makes_each_rule_under_its_name() -> None:
    assert [make(name)().name for name in RULES] == RULES
    assert [name.removeprefix("central-") for name in BOUNDS] == [make(name)().name for name in BOUNDS]
    assert all(hears_all(name) for name in BOUNDS)
    assert not any(hears_all(name) for name in NAMES)


@pytest.mark.parametrize("name", ["", "gready", "central-nearest", "greedy:x"])
def test_unknown_name_is_refused_with_the_list_of_names(name: str) -> None:
    with pytest.raises(ConfigError, match="hungarian"):
        make(name)
