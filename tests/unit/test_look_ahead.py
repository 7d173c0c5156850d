"""A robot whose model looks ahead: it goes and looks where the model says, says so, and does not change its mind."""

from __future__ import annotations

import numpy as np
import pytest
from builders import belief_of, observation, robot, view_of
from learning import ahead_model

from gatar_edge.agent import Agent, Identity, Inbox
from gatar_edge.allocators.gatar import HABIT, Gatar, decode, in_hand
from gatar_edge.allocators.routing import RoutingWithMemory
from gatar_edge.config import AgentConfig
from gatar_edge.explore import frontiers
from gatar_edge.keys import DEMO_KEY
from gatar_edge.message import decode as decode_message
from gatar_edge.types import NS_PER_S, Reason, RobotKind, RobotState, TaskKind
from gatar_edge.view import build_view

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def gatar() -> Gatar:
    return Gatar(ahead_model())


def one_robot(*scores: float, held: int | None = None) -> int:
    """What a robot alone chooses by its scores, the last of them for nothing at all."""
    count = len(scores) - 1
    held_by = None if held is None else np.arange(count)[None] == held
    possible, order = np.ones((1, count), dtype=np.bool_), np.zeros(1, dtype=np.int64)
    return int(decode(np.array([scores], dtype=np.float32), possible, order, held_by)[0])


def test_between_equals_a_robot_keeps_what_it_is_on_its_way_to() -> None:
    assert one_robot(0.4, 0.4, 0.2) == 0
    assert one_robot(0.4, 0.4, 0.2, held=1) == 1
    assert one_robot(0.42, 0.38, 0.2, held=1) == 1


def test_a_robot_changes_its_mind_for_what_is_clearly_better() -> None:
    worth = float(np.exp(HABIT))
    assert one_robot(0.2 * worth * 0.99, 0.2, 0.1, held=1) == 1
    assert one_robot(0.2 * worth * 1.01, 0.2, 0.1, held=1) == 0


def test_two_robots_keep_what_they_hold_though_the_other_way_round_were_as_good() -> None:
    scores, possible = np.full((2, 3), 1 / 3, dtype=np.float32), np.ones((2, 2), dtype=np.bool_)
    for held in ([[True, False], [False, True]], [[False, True], [True, False]]):
        assert decode(scores, possible, np.arange(2), np.array(held)).tolist() == np.argmax(held, axis=1).tolist()


def test_a_frontier_is_the_same_in_all_its_block_and_a_target_only_where_it_is() -> None:
    view = view_of(
        belief_of("T.......????\n" + "............\n" * 3),
        robot(1, (0, 0), target=(0, 3)),
        [
            RobotState(2, RobotKind.UAV, (1, 0), 1.0, TaskKind.EXPLORE, (10, 1)),
            RobotState(3, RobotKind.UAV, (2, 0), 1.0, TaskKind.EXPLORE, (1, 2)),
            RobotState(4, RobotKind.UAV, (3, 0), 1.0, TaskKind.TARGET, (9, 3)),
        ],
    )
    places = np.concatenate([view.targets, frontiers(view.belief, view.distances)[0]])
    assert places.tolist() == [[0, 3], [9, 3]]
    assert in_hand(view, places).tolist() == [[True, False], [False, True], [False, False], [False, False]]


def test_where_no_target_is_known_the_model_says_where_to_look(gatar: Gatar) -> None:
    view = view_of(belief_of("........????????\n" * 12), robot(1, (3, 3)))
    allocation = gatar.allocate(view)
    assert allocation.choices.tolist() == [-1]
    assert allocation.scores.shape == (1, 0)
    assert allocation.frontier in {(int(x), int(y)) for x, y in frontiers(view.belief, view.distances)[0]}


def test_robots_out_of_range_get_no_choice_but_count(gatar: Gatar) -> None:
    belief = belief_of("....T...????????\n" + "........????????\n" * 7)
    ego, gone = robot(1, (3, 3)), RobotState(2, RobotKind.UAV, (12, 3), 1.0, age_ns=9 * NS_PER_S)
    alone, both = (build_view(0, ego, (), belief, 6, 2, 64, absent) for absent in ((), (gone,)))
    one, two = gatar.allocate(alone), gatar.allocate(both)
    assert len(two.choices) == len(two.attention) == 1
    assert two.scores.shape == (1, 1)
    assert one.scores != two.scores


@pytest.mark.parametrize("name", ["gatar", "routing+memory"])
def test_what_is_kept_for_a_robot_out_of_range_is_told(gatar: Gatar, name: str) -> None:
    belief = belief_of("................\n" * 7 + "T..............T")
    gone = robot(2, (15, 1), target=(15, 0))
    view = build_view(0, robot(3, (1, 0), target=(0, 0)), (), belief, 6, 2, 64, (gone,))
    allocation = gatar.allocate(view) if name == "gatar" else RoutingWithMemory().allocate(view)
    assert allocation.absent == (gone,)
    assert len(allocation.choices) == 1
    assert sorted((int(allocation.choices[0]), *allocation.kept_for_absent)) == [0, 1]


def test_a_place_to_look_becomes_the_robots_task_and_its_message_tells_it(gatar: Gatar) -> None:
    ego = Agent(Identity(1, RobotKind.UAV, 1.0), AgentConfig(), gatar, DEMO_KEY)
    seen = [(x, y) for x in range(6) for y in range(6)]
    out = ego.tick(0, Inbox(observation((3, 3), seen)))
    view = ego.view(0, observation((3, 3), seen))
    places = {(int(x), int(y)) for x, y in frontiers(view.belief, view.distances)[0]}
    assert out.decision.fallback == ""
    assert (out.decision.assignment.kind, out.decision.assignment.reason) == (TaskKind.EXPLORE, Reason.FRONTIER)
    assert out.decision.assignment.cell in places
    message = decode_message(out.message, DEMO_KEY)
    assert (message.task, message.task_cell) == (TaskKind.EXPLORE, out.decision.assignment.cell)


def test_a_robot_on_its_way_to_look_stays_on_it_while_it_sees_nothing_new(gatar: Gatar) -> None:
    ego = Agent(Identity(1, RobotKind.UAV, 1.0), AgentConfig(), gatar, DEMO_KEY)
    seen = [(x, y) for x in range(6) for y in range(6)]
    cells = {ego.tick(t, Inbox(observation((3, 3), seen, t_ns=t))).decision.assignment.cell for t in range(5)}
    assert len(cells) == 1
