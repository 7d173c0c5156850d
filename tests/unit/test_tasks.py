"""From a proposal to what the robot does."""

from __future__ import annotations

import numpy as np
from builders import belief_of, robot, view_of

from gatar_edge.allocators.base import NO_TARGET, Allocation
from gatar_edge.allocators.greedy import Greedy
from gatar_edge.allocators.nearest import Nearest
from gatar_edge.tasks import MOST_CHANGES, Rules, Task, contested, decide, to_command
from gatar_edge.types import Cell, Goto, Hold, Mission, Reason, RobotKind, TaskKind
from gatar_edge.view import View

FOLLOW = Rules(keep=False)
ROW = belief_of("T......T")  # targets at (0, 0) and (7, 0)


def decided(view: View, task: Task | None = None, *, keep: bool = True) -> tuple[TaskKind, Cell, Reason]:
    assignment = decide(view, Greedy().allocate(view), task or Task(), Rules(keep=keep))
    return assignment.kind, assignment.cell, assignment.reason


def test_a_free_robot_takes_what_the_allocator_gives_it() -> None:
    assert decided(view_of(ROW, robot(1, (2, 0)))) == (TaskKind.TARGET, (0, 0), Reason.ALLOCATED)


def test_a_task_is_kept_though_another_target_is_nearer() -> None:
    view = view_of(ROW, robot(1, (2, 0), target=(7, 0)))
    assert decided(view, Task(TaskKind.TARGET, (7, 0))) == (TaskKind.TARGET, (7, 0), Reason.KEPT)


def test_without_keeping_the_allocator_is_followed() -> None:
    view = view_of(ROW, robot(1, (2, 0), target=(7, 0)))
    assert decided(view, Task(TaskKind.TARGET, (7, 0)), keep=False)[1] == (0, 0)


def test_a_robot_that_changed_its_mind_too_often_goes_to_the_end_of_its_task() -> None:
    other = _only(0)
    task = Task(TaskKind.TARGET, (7, 0), (), MOST_CHANGES)
    far = view_of(ROW, robot(1, (5, 0), target=(7, 0)))
    near = view_of(ROW, robot(1, (3, 0), target=(7, 0)))
    assert decide(far, other, task, FOLLOW).cell == (7, 0)
    assert decide(near, other, task, FOLLOW).cell == (0, 0)


def test_patience_is_renewed_when_a_task_ends() -> None:
    tired = Task(TaskKind.TARGET, (7, 0), (), MOST_CHANGES)
    there = decide(view_of(belief_of("T......x"), robot(1, (7, 0))), _only(0), tired, FOLLOW)
    assert tired.followed_by(there, given_up=False).changes == 0


def test_a_task_that_goes_on_changes_nothing() -> None:
    tired = Task(TaskKind.TARGET, (7, 0), (), 2)
    on = decide(view_of(ROW, robot(1, (5, 0), target=(7, 0))), _only(1), tired, FOLLOW)
    assert tired.followed_by(on, given_up=False).changes == 2


def test_plans_that_flip_at_every_step_do_not_keep_a_robot_from_arriving() -> None:
    cell, task, steps = (3, 0), Task(), 0
    while cell not in ((0, 0), (7, 0)):
        assert steps < 20
        assignment = decide(view_of(ROW, robot(1, cell)), _only(steps % 2), task, FOLLOW)
        task = task.followed_by(assignment, given_up=task.kind is TaskKind.TARGET and assignment.cell != task.cell)
        cell = assignment.path[assignment.path.index(cell) + 1]
        steps += 1


def test_a_task_ends_when_the_target_is_localized() -> None:
    view = view_of(belief_of("T......x"), robot(1, (6, 0)))
    assert decided(view, Task(TaskKind.TARGET, (7, 0)))[1] == (0, 0)


def test_a_task_ends_when_the_target_turns_out_unreachable() -> None:
    view = view_of(belief_of("T.....#T"), robot(1, (5, 0), RobotKind.UGV))
    assert decided(view, Task(TaskKind.TARGET, (7, 0)))[1] == (0, 0)


def test_a_nearer_neighbour_that_claims_the_task_gets_it() -> None:
    view = view_of(ROW, robot(1, (4, 0), target=(7, 0)), [robot(2, (6, 0), target=(7, 0))])
    assert decided(view, Task(TaskKind.TARGET, (7, 0)))[1] == (0, 0)


def test_a_farther_neighbour_that_claims_the_task_does_not() -> None:
    view = view_of(ROW, robot(1, (5, 0), target=(7, 0)), [robot(2, (3, 0), target=(7, 0))])
    assert decided(view, Task(TaskKind.TARGET, (7, 0)))[1] == (7, 0)


def test_of_two_equally_near_the_smaller_id_has_the_claim() -> None:
    view = view_of(ROW, robot(2, (6, 0), target=(7, 0)), [robot(1, (6, 0), target=(7, 0))])
    assert contested(view).tolist() == [False, True]
    mirrored = view_of(ROW, robot(1, (6, 0), target=(7, 0)), [robot(2, (6, 0), target=(7, 0))])
    assert contested(mirrored).tolist() == [False, False]


def test_a_contested_proposal_gives_way_to_the_next_best_target_that_nobody_gets() -> None:
    view = view_of(ROW, robot(1, (5, 0)), [robot(2, (6, 0), target=(7, 0))])
    assignment = decide(view, Nearest().allocate(view), Task(), Rules())
    assert assignment.cell == (0, 0)


def test_a_contested_proposal_does_not_give_way_to_a_target_that_a_robot_out_of_range_gets() -> None:
    view = view_of(belief_of("T..T...T"), robot(1, (5, 0)), [robot(2, (6, 0), target=(7, 0))])
    choices, scores = np.array([2, NO_TARGET], dtype=np.int32), np.array([[1, 2, 3]] * 2, dtype=np.float32)
    gone = (robot(3, (20, 0), target=(3, 0)), robot(4, (30, 0)))
    alone = Allocation(choices, scores)
    reckoning = Allocation(choices, scores, absent=gone, kept_for_absent=(1, NO_TARGET))
    assert decide(view, alone, Task(), FOLLOW).cell == (3, 0)
    assert decide(view, reckoning, Task(), FOLLOW).cell == (0, 0)


def test_without_a_target_the_robot_explores_the_nearest_unknown_cell() -> None:
    assert decided(view_of(belief_of("..??"), robot(1, (0, 0)))) == (TaskKind.EXPLORE, (2, 0), Reason.FRONTIER)


def test_a_surplus_robot_explores_though_a_target_is_known() -> None:
    view = view_of(belief_of("T.?....?"), robot(2, (4, 0)), [robot(1, (1, 0))])
    assert decided(view)[0] is TaskKind.EXPLORE


def test_with_nothing_left_to_see_the_robot_holds() -> None:
    view = view_of(belief_of("..x"), robot(1, (1, 0)))
    assert decided(view) == (TaskKind.HOLD, (1, 0), Reason.NOTHING_LEFT)


def test_an_unreachable_proposal_is_never_followed() -> None:
    view = view_of(belief_of("..#T"), robot(1, (0, 0), RobotKind.UGV))
    wrong = Allocation(np.array([0], dtype=np.int32), np.zeros((1, 1), dtype=np.float32))
    assert decide(view, wrong, Task(), Rules()).kind is TaskKind.HOLD


def test_the_path_stays_the_same_while_it_is_good() -> None:
    belief = belief_of("....\n....\n...T")
    first = decide(view_of(belief, robot(1, (0, 2), RobotKind.UGV)), _only(0), Task(), Rules())
    here = first.path[2]
    task = Task(first.kind, first.cell, first.path)
    assert decide(view_of(belief, robot(1, here, RobotKind.UGV)), _only(0), task, Rules()).path is first.path


def test_an_obstacle_on_the_path_changes_the_path() -> None:
    old = ((0, 0), (1, 0), (2, 0), (3, 0))
    view = view_of(belief_of("....\n.#.T"), robot(1, (0, 0), RobotKind.UGV))
    assignment = decide(view, _only(0), Task(TaskKind.TARGET, (3, 0), old), Rules())
    assert (1, 0) not in assignment.path
    assert len(assignment.path) == 6


def test_aerial_robots_fly_straight_ground_robots_drive_the_path() -> None:
    view = view_of(ROW, robot(1, (2, 0)))
    assignment = decide(view, _only(0), Task(), Rules())
    assert to_command(RobotKind.UAV, assignment) == Goto((0, 0))
    assert to_command(RobotKind.UGV, assignment) == Mission(((0, 0),))
    idle = decide(view_of(belief_of(".."), robot(1, (0, 0))), _only(NO_TARGET), Task(), Rules())
    assert to_command(RobotKind.UGV, idle) == Hold("nothing_left")


def _only(choice: int) -> Allocation:
    return Allocation(np.array([choice], dtype=np.int32), np.zeros((1, 2), dtype=np.float32))
