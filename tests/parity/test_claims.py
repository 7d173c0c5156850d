"""What the paper's Table 1 claims for GATAR, each shown on the model that is shipped."""

import numpy as np
import pytest
from builders import belief_of, robot, view_of

from gatar_edge.allocators.base import NO_TARGET
from gatar_edge.allocators.gatar import Gatar
from gatar_edge.allocators.greedy import Greedy
from gatar_edge.export.states import random_view
from gatar_edge.features import ROBOT_FEATURES, features
from gatar_edge.policy import GREEDY_MODEL
from gatar_edge.types import CellState, RobotKind
from gatar_edge.view import build_view, travel_times

UAV, UGV = RobotKind.UAV, RobotKind.UGV
POCKET = belief_of("""
    ...........
    ...........
    ...........
    ...#...#...
    ...#...#...
    ...#.T.#...
    ...#####...
    ...........
    ...........
    ...........
    .....T.....
""")
OPEN_FIELD = "\n".join(["." * 21] * 6)


@pytest.fixture(scope="module")
def model():
    return Gatar(GREEDY_MODEL)


def goals(view, allocation):
    """The target of each robot, by id."""
    return {
        one.robot_id: None if choice == NO_TARGET else tuple(view.targets[choice].tolist())
        for one, choice in zip(view.robots, allocation.choices.tolist(), strict=True)
    }


@pytest.mark.parametrize("kinds", [(UAV, UGV), (UGV, UAV)])
def test_heterogeneous_the_robot_that_flies_takes_the_target_inside_the_walls(model, kinds):
    team = [robot(1, (2, 5), kinds[0]), robot(2, (8, 5), kinds[1])]
    view = view_of(POCKET, team[0], team[1:])
    taken = goals(view, model.allocate(view))
    assert taken[1 + kinds.index(UAV)] == (5, 5)
    assert taken[1 + kinds.index(UGV)] == (5, 0)


@pytest.mark.parametrize("robots", [2, 4, 12, 30, 60])
def test_scalable_one_model_sends_any_number_of_robots_about_as_far_as_greedy_does(model, robots):
    way = {"model": 0.0, "greedy": 0.0}
    for seed in range(4):
        view = random_view(robots, robots, seed, 1000.0)
        times = travel_times(view)
        for name, rule in (("model", model), ("greedy", Greedy())):
            choices = rule.allocate(view).choices
            rows = np.flatnonzero(choices != NO_TARGET)
            assert len(set(choices[rows].tolist())) == len(rows)
            assert len(rows) >= 0.8 * robots
            way[name] += float(times[rows, choices[rows]].mean())
    assert way["model"] < 1.15 * way["greedy"]


def test_long_range_a_robot_two_hops_away_changes_the_decision(model):
    belief = belief_of(OPEN_FIELD).copy()
    for cell in ((0, 2), (13, 3), (15, 2)):
        belief[cell] = CellState.TARGET
    ego, between, far = robot(1, (8, 2)), robot(2, (13, 2)), robot(3, (18, 2))
    told, untold = view_of(belief, ego, [between, far], r_comm=5.5), view_of(belief, ego, [between], r_comm=5.5)
    assert told.hops[0].tolist() == [0, 1, 2]
    assert goals(untold, model.allocate(untold))[1] == (15, 2)
    assert goals(told, model.allocate(told)) == {1: (0, 2), 2: (13, 3), 3: (15, 2)}


@pytest.mark.parametrize("seed", range(5))
def test_decentralized_a_robot_outside_the_graph_changes_no_bit(model, seed):
    rng = np.random.default_rng(seed)
    inputs = features(random_view(5, 8, seed, 1000.0))
    inputs["hops"] = inputs["hops"].copy()
    inputs["hops"][4, :4] = inputs["hops"][:4, 4] = -1
    other = {name: array.copy() for name, array in inputs.items()}
    other["maps"][4] = rng.random(other["maps"][4].shape)
    other["pairs"][4] = rng.normal(size=other["pairs"][4].shape)
    other["valid"][4] = 1 - other["valid"][4]
    news = np.arange(len(ROBOT_FEATURES)) != ROBOT_FEATURES.index("rank")  # its place among the ids is no news from it
    other["robots"][4, news] = rng.normal(size=news.sum())
    one, two = model.policy.run(inputs), model.policy.run(other)
    assert one.scores[:4].tobytes() == two.scores[:4].tobytes()
    assert one.xy.tobytes() == two.xy.tobytes()
    assert one.attention[:4].tobytes() == two.attention[:4].tobytes()


@pytest.mark.parametrize("seed", range(5))
def test_multi_target_robots_that_decide_apart_take_different_targets(model, seed):
    shared = random_view(8, 20, seed, 1000.0)
    taken = []
    for ego in shared.robots:
        others = [one for one in shared.robots if one is not ego]
        view = build_view(0, ego, others, shared.belief, 1000.0, 2, 64)
        taken.append(goals(view, model.allocate(view))[ego.robot_id])
    found = [cell for cell in taken if cell is not None]
    assert len(found) == len(set(found)) >= 7
