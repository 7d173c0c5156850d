"""Robots out of range: remembered where they are going to, and given up where they should be heard."""

from __future__ import annotations

import pytest
from builders import observation, robot
from msgspec.structs import replace

from gatar_edge.absent import REMEMBER_S, expected_cell, out_of_range, patience_s
from gatar_edge.agent import Agent, Identity, Inbox
from gatar_edge.allocators.greedy import Greedy
from gatar_edge.allocators.routing import RoutingWithMemory
from gatar_edge.config import AgentConfig
from gatar_edge.keys import DEMO_KEY
from gatar_edge.message import decode, encode
from gatar_edge.types import NS_PER_S, Cell, GridSpec, Reason, RobotKind, RobotState, TaskKind
from gatar_edge.view import View

OPEN = [(x, y) for x in range(15) for y in range(15)]
EGO = robot(1, (3, 3))
LARGE = {"grid": GridSpec(width=48, height=48)}  # so that patience is as long as memory


def silent(cell: Cell, target: Cell | None, age_s: float, robot_id: int = 2, speed: float = 1.0) -> RobotState:
    return replace(robot(robot_id, cell, speed=speed, target=target), age_ns=int(age_s * NS_PER_S))


def agent(robot_id: int, **config: object) -> Agent:
    return Agent(Identity(robot_id, RobotKind.UAV, 1.0), AgentConfig(**config), Greedy(), DEMO_KEY)


def told(robot_id: int, cell: Cell, targets: list[Cell], **config: object) -> bytes:
    seen = observation(cell, OPEN, (), targets, robot_id=robot_id)
    return agent(robot_id, **config).tick(0, Inbox(seen)).message


def view_after(seconds: float, *messages: bytes, late: tuple[bytes, ...] = (), **config: object) -> View:
    """What robot 1 at (3, 3) decides on; `messages` reach it at 0, `late` ones now."""
    ego, now_ns = agent(1, **config), round(seconds * NS_PER_S)
    ego.tick(0, Inbox(observation((3, 3), OPEN), messages))
    seen = observation((3, 3), OPEN, t_ns=now_ns)
    ego.tick(now_ns, Inbox(seen, late))
    return ego.view(now_ns, seen)


@pytest.mark.parametrize(
    ("travelled", "cell"), [(0, (2, 2)), (1, (3, 2)), (3, (4, 3)), (6, (6, 4)), (60, (6, 4))], ids=str
)
def test_a_robot_is_expected_on_the_straight_way_to_its_goal_and_waits_there(travelled: float, cell: Cell) -> None:
    assert expected_cell((2, 2), (6, 4), travelled) == cell


def test_a_robot_at_its_goal_is_expected_there() -> None:
    assert expected_cell((2, 2), (2, 2), 5) == (2, 2)


def test_a_robot_out_of_range_moves_on_at_its_own_speed() -> None:
    for age_s, speed, cell in ((5, 1.0, (13, 3)), (2, 2.5, (13, 3)), (5, 0.4, (10, 3))):
        found = out_of_range([silent((8, 3), (14, 3), age_s, speed=speed)], [robot(1, (0, 3))], 30, 6)
        assert [other.cell for other in found] == [cell]


@pytest.mark.parametrize(
    ("heard", "cells", "r_comm", "patience"),
    [(1, 15 * 15, 6, 2.98), (11, 15 * 15, 6, 2.98), (1, 32 * 32, 6, 13.6), (1, 48 * 48, 6, 30), (0, 15 * 15, 6, 30),
     (1, 15 * 15, 4, 6.7), (1, 15 * 15, 0, 30)],
)  # fmt: skip
def test_who_hears_somebody_has_the_less_patience_the_more_of_the_world_the_radio_covers(
    heard: int, cells: int, r_comm: float, patience: float
) -> None:
    assert patience_s(heard, cells, r_comm) == pytest.approx(patience, rel=0.01)


def test_who_hears_nobody_reckons_with_robots_that_one_who_hears_somebody_gave_up() -> None:
    gone = told(2, (5, 3), [(14, 3)])
    assert [robot.robot_id for robot in view_after(9, gone).absent] == [2]
    assert view_after(9, gone, late=(told(3, (0, 3), []),)).absent == ()
    message, late = told(2, (5, 3), [(14, 3)], **LARGE), told(3, (0, 3), [], **LARGE)
    assert [robot.robot_id for robot in view_after(9, message, late=(late,), **LARGE).absent] == [2]


def test_a_robot_without_a_goal_is_expected_where_it_was() -> None:
    assert [other.cell for other in out_of_range([silent((12, 3), None, 9)], [EGO], 30, 6)] == [(12, 3)]


@pytest.mark.parametrize(("near", "kept"), [([EGO], 1), ([EGO, robot(3, (8, 3))], 0), ([robot(1, (6, 3))], 0)])
def test_a_robot_that_ego_or_a_neighbour_of_its_should_hear_is_not_there(near: list[RobotState], kept: int) -> None:
    assert len(out_of_range([silent((12, 3), None, 9)], near, 30, 6)) == kept


def test_a_robot_is_forgotten_after_half_a_minute() -> None:
    assert out_of_range([silent((12, 3), None, REMEMBER_S)], [EGO], 30, 6)
    assert not out_of_range([silent((12, 3), None, REMEMBER_S + 0.001)], [EGO], 30, 6)


def test_robots_out_of_range_come_by_id_whoever_was_heard_last() -> None:
    found = out_of_range([silent((12, 3), None, age, number) for age, number in ((4, 9), (5, 4), (6, 7))], [EGO], 30, 6)
    assert [other.robot_id for other in found] == [4, 7, 9]


def test_an_agent_reckons_with_a_robot_that_left_for_its_target() -> None:
    message = told(2, (5, 3), [(14, 3)])
    assert view_after(3, message).absent == ()  # still a neighbour
    assert view_after(4, message).absent == ()  # at (9, 3): it should be heard
    later = view_after(5, message)
    assert [other.robot_id for other in later.robots] == [1]
    assert [(other.robot_id, other.cell) for other in later.absent] == [(2, (10, 3))]
    assert [other.cell for other in view_after(30, message).absent] == [(14, 3)]
    assert view_after(30.001, message).absent == ()


def test_an_agent_keeps_nothing_for_a_robot_that_fell_silent_in_earshot() -> None:
    message = told(2, (5, 3), [])
    assert [other.robot_id for other in view_after(3, message).robots] == [1, 2]
    assert view_after(5, message).absent == ()


def test_a_neighbour_that_should_hear_a_robot_too_gives_it_up_for_ego() -> None:
    message = told(2, (5, 3), [(14, 3)], **LARGE)
    for cell, kept in (((8, 3), 0), ((0, 3), 1)):
        assert len(view_after(5, message, late=(told(3, cell, [], **LARGE),), **LARGE).absent) == kept


@pytest.mark.parametrize("kind", [TaskKind.TARGET, TaskKind.EXPLORE])
@pytest.mark.parametrize("cell", [(-1, -1), (15, 0), (0, 900)])
def test_a_robot_that_left_for_a_cell_outside_the_grid_is_not_reckoned_with(kind: TaskKind, cell: Cell) -> None:
    message = replace(decode(told(2, (9, 3), []), DEMO_KEY), task=kind, task_cell=cell)
    assert view_after(9, encode(message, DEMO_KEY)).absent == ()


def test_the_last_heard_count_where_the_graph_has_no_room_for_all() -> None:
    room = {"max_neighbors": 3, **LARGE}
    gone = [told(number, (5, 3), [(14, 3)], **room) for number in (4, 3, 2)]
    assert [other.robot_id for other in view_after(9, *gone, **room).absent] == [2, 3, 4]
    crowded = view_after(9, *gone, late=(told(5, (1, 3), [], **room),), **room)
    assert [other.robot_id for other in crowded.robots] == [1, 5]
    assert [other.robot_id for other in crowded.absent] == [2, 3]


@pytest.mark.parametrize(
    ("dark", "seconds", "reason"),
    [
        ([(0, 14)], 5, Reason.FRONTIER),
        ([(0, 14)], 30, Reason.FRONTIER),
        ([(0, 14)], 30.001, Reason.ALLOCATED),
        ([], 5, Reason.ABANDONED),
    ],
)
def test_the_target_of_a_robot_lost_out_of_earshot_waits_half_a_minute_while_there_is_something_else_to_do(
    dark: list[Cell], seconds: float, reason: Reason
) -> None:
    known = [cell for cell in OPEN if cell not in dark]
    other, ego = (Agent(Identity(n, RobotKind.UAV, 1.0), AgentConfig(), RoutingWithMemory(), DEMO_KEY) for n in (2, 1))
    left = other.tick(0, Inbox(observation((5, 3), known, (), [(14, 3)], robot_id=2))).message
    ego.tick(0, Inbox(observation((3, 3), [(3, 3)]), (left,)))
    now_ns = round(seconds * NS_PER_S)
    decision = ego.tick(now_ns, Inbox(observation((3, 3), [(3, 3)], t_ns=now_ns))).decision
    assert decision.assignment.reason is reason
    assert (decision.assignment.cell == (14, 3)) == (reason is not Reason.FRONTIER)
