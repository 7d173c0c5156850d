"""One robot's mind, alone and among others."""

from __future__ import annotations

import numpy as np
import pytest
from builders import observation
from msgspec.structs import replace

from gatar_edge.agent import Agent, Identity, Inbox
from gatar_edge.allocators.base import Allocation, Allocator
from gatar_edge.allocators.greedy import Greedy
from gatar_edge.config import AgentConfig
from gatar_edge.errors import ModelError
from gatar_edge.keys import DEMO_KEY
from gatar_edge.message import decode, encode
from gatar_edge.types import NS_PER_S, Cell, Decision, Goto, Hold, Mission, Reason, RobotKind, TaskKind
from gatar_edge.view import View

OPEN = [(x, y) for x in range(15) for y in range(15)]


def agent(robot_id: int = 1, kind: RobotKind = RobotKind.UAV, allocator: Allocator | None = None) -> Agent:
    return Agent(Identity(robot_id, kind, 1.0), AgentConfig(), allocator or Greedy(), DEMO_KEY)


def sees(cell: Cell, targets: list[Cell], t_s: float = 0.0, robot_id: int = 1) -> Inbox:
    return Inbox(observation(cell, OPEN, (), targets, robot_id=robot_id, t_ns=int(t_s * NS_PER_S)))


def comparable(decision: Decision) -> Decision:
    return replace(decision, latency_ns=0)


def test_what_comes_in_decides_what_goes_out() -> None:
    outboxes = [agent().tick(0, sees((3, 3), [(5, 3), (9, 9)])) for _ in range(2)]
    assert outboxes[0].command == Goto((5, 3))
    assert outboxes[0] == outboxes[1]


def test_a_ground_robot_is_told_a_path() -> None:
    command = agent(kind=RobotKind.UGV).tick(0, sees((3, 3), [(5, 3)])).command
    assert command == Mission(((5, 3),))


def test_a_robot_without_eyes_stands_still_and_says_so() -> None:
    out = agent().tick(0, Inbox())
    assert (out.command, out.decision.assignment.reason) == (Hold("no_perception"), Reason.NO_PERCEPTION)


def test_an_old_observation_stops_the_robot() -> None:
    robot = agent()
    robot.tick(0, sees((3, 3), [(5, 3)]))
    assert robot.tick(3 * NS_PER_S, Inbox()).decision.assignment.kind is TaskKind.TARGET
    assert robot.tick(3 * NS_PER_S + 1, Inbox()).decision.assignment.reason is Reason.NO_PERCEPTION


@pytest.mark.parametrize("kind", RobotKind)
@pytest.mark.parametrize("cell", [(-1, -1), (3, 15), (15, 3), (-1, 3)])
def test_a_robot_off_the_grid_stands_still_until_it_is_on_it_again(kind: RobotKind, cell: Cell) -> None:
    robot = agent(kind=kind)
    robot.tick(0, sees((3, 3), [(5, 3)]))
    off = robot.tick(NS_PER_S, sees(cell, [(5, 3)], t_s=1))
    assert (off.command, off.decision.assignment.reason) == (Hold("no_perception"), Reason.NO_PERCEPTION)
    assert decode(off.message, DEMO_KEY).speed_cells_s == 0  # the others take its targets
    assert robot.tick(2 * NS_PER_S, sees((3, 3), [(5, 3)], t_s=2)).decision.assignment.cell == (5, 3)


def test_a_neighbour_with_a_shorter_way_gets_the_target() -> None:
    other = agent(2)
    told = other.tick(0, sees((5, 3), [(6, 3)], robot_id=2)).message
    mine = agent(1).tick(0, Inbox(sees((3, 3), [(6, 3), (0, 0)]).observation, (told,)))
    assert mine.decision.assignment.cell == (0, 0)


def test_what_a_neighbour_saw_can_be_chosen() -> None:
    told = agent(2).tick(0, sees((8, 3), [(9, 3), (2, 3)], robot_id=2)).message
    blind_inbox = Inbox(observation((3, 3), [(3, 3)]), (told,))
    assert agent(1).tick(0, blind_inbox).command == Goto((2, 3))


def test_a_neighbour_not_heard_for_long_leaves_the_graph() -> None:
    robot = agent(1)
    robot.tick(0, Inbox(observation((3, 3), OPEN), (agent(2).tick(0, sees((5, 3), [], robot_id=2)).message,)))
    later = robot.tick(4 * NS_PER_S, Inbox(observation((3, 3), OPEN, t_ns=4 * NS_PER_S)))
    assert [r.robot_id for r in later.decision.robots] == [1]


def test_messages_are_passed_on_once_for_neighbours_of_neighbours() -> None:
    told = agent(3).tick(0, sees((9, 3), [], robot_id=3)).message
    out = agent(2).tick(0, Inbox(None, (told, told)))
    assert len(out.relays) == 1
    assert decode(out.relays[0], DEMO_KEY).hops == 1
    assert agent(1).tick(0, Inbox(None, out.relays)).relays == ()


def test_a_message_fits_a_tunnel_payload() -> None:
    assert len(agent().tick(0, sees((3, 3), [(5, 3)])).message) <= 128


def test_a_robot_that_is_not_heard_cannot_change_the_decision() -> None:
    """Decentralized: two robots far away and unheard may do what they like."""
    heard = agent(2).tick(0, sees((5, 3), [(6, 3)], robot_id=2)).message
    unheard = [agent(3).tick(0, sees((14, 14), targets, robot_id=3)) for targets in ([], [(4, 3)])]
    decisions = [
        agent(1).tick(0, Inbox(observation((3, 3), OPEN, (), [(6, 3), (0, 0)]), (heard,))).decision for _ in unheard
    ]
    assert comparable(decisions[0]) == comparable(decisions[1])


def test_the_order_in_which_neighbours_are_heard_changes_nothing() -> None:
    told = [agent(i).tick(0, sees((i, 9), [(i, 10)], robot_id=i)).message for i in (2, 3, 4)]
    seen = observation((3, 3), OPEN, (), [(3, 5)])
    first, second = (agent(1).tick(0, Inbox(seen, tuple(order))).decision for order in (told, told[::-1]))
    assert comparable(first) == comparable(second)


@pytest.mark.parametrize("cell", [(-1, -1), (15, 0), (900, 3)])
def test_a_neighbour_outside_the_grid_takes_no_part(cell: Cell) -> None:
    message = decode(agent(2).tick(0, sees((5, 3), [], robot_id=2)).message, DEMO_KEY)
    lost = encode(replace(message, cell=cell), DEMO_KEY)
    out = agent(1).tick(0, Inbox(observation((3, 3), OPEN, (), [(6, 3)]), (lost,)))
    assert [r.robot_id for r in out.decision.robots] == [1]


class Broken:
    """An allocator that errs."""

    name = "broken"

    def __init__(self, error: Exception) -> None:
        self.error = error

    def allocate(self, view: View) -> Allocation:
        raise self.error


class NotFinite(Greedy):
    """An allocator whose scores are not numbers."""

    name = "nan"

    def allocate(self, view: View) -> Allocation:
        return replace(super().allocate(view), scores=np.full(view.lengths.shape, np.nan, dtype=np.float32))


@pytest.mark.parametrize("allocator", [Broken(ModelError("no scores")), Broken(RuntimeError("ort")), NotFinite()])
def test_when_the_model_errs_greedy_decides_and_the_record_says_why(allocator: Allocator) -> None:
    decision = agent(allocator=allocator).tick(0, sees((3, 3), [(5, 3)])).decision
    assert (decision.assignment.cell, decision.allocator) == ((5, 3), "greedy")
    assert decision.fallback


def test_a_target_left_before_it_was_reached_is_a_retask() -> None:
    robot = agent(1)
    robot.tick(0, sees((3, 3), [(8, 3)]))
    told = agent(2).tick(0, sees((7, 3), [(8, 3)], robot_id=2)).message
    assert robot.tick(1, Inbox(sees((3, 3), [(8, 3)]).observation, (told,))).decision.retask


def test_reaching_a_target_is_no_retask() -> None:
    robot = agent(1)
    robot.tick(0, sees((3, 3), [(4, 3)]))
    assert not robot.tick(1, sees((4, 3), [(4, 3)])).decision.retask
