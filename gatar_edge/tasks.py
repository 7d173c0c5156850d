"""From what an allocator proposes to what the robot does: the second stage of the paper's two, with its task keeping.

The allocator proposes, this decides. The proposal is followed where nobody nearer claims it; the robot explores where
there is none, and holds where nothing is left to see. A target once taken is kept to its end - until it is reached,
vanishes, becomes unreachable, or a neighbour with a shorter way claims it - by `Rules.keep` from the first moment on
(but for an allocator that is steady by itself), else once `MOST_CHANGES` were given up in a row: plans that flip
between equals would never arrive anywhere.
"""

from __future__ import annotations

from dataclasses import dataclass

import msgspec
import numpy as np
import numpy.typing as npt

from gatar_edge.allocators.base import NO_TARGET, Allocation
from gatar_edge.explore import frontier_for_ego, settled
from gatar_edge.grid import UNREACHABLE, manhattan, passable, path_to, simplify
from gatar_edge.types import Assignment, Cell, Goto, Hold, IntGrid, Mission, Reason, RobotKind, TaskKind, VehicleCommand
from gatar_edge.view import View, travel_times

MOST_CHANGES = 3  # targets given up since one ended, before only a nearer one is worth another change


class Task(msgspec.Struct, frozen=True):
    """What the robot is doing, and the path on which it is doing it."""

    kind: TaskKind = TaskKind.HOLD
    cell: Cell = (-1, -1)
    path: tuple[Cell, ...] = ()
    changes: int = 0  # targets given up since one ended

    def followed_by(self, assignment: Assignment, *, given_up: bool) -> Task:
        """The next task; `given_up` says that this one's target is still to be had."""
        ended = self.kind is TaskKind.TARGET and not given_up and assignment.cell != self.cell
        changes = 0 if ended else self.changes + given_up
        return Task(assignment.kind, assignment.cell, assignment.path, changes)


@dataclass(frozen=True, slots=True)
class Rules:
    """How readily a robot changes its mind."""

    keep: bool = True
    r_sense: float = 4.0


def decide(view: View, allocation: Allocation, task: Task, rules: Rules) -> Assignment:
    """What ego (row 0 of the view) does now."""
    taken = contested(view)
    index = proposed(view, allocation, taken)
    held = _index_of(view, task.cell) if task.kind is TaskKind.TARGET else NO_TARGET
    if held != NO_TARGET and view.lengths[0, held] != UNREACHABLE and not taken[held]:
        nearer = index != NO_TARGET and view.lengths[0, index] < view.lengths[0, held]
        if (rules.keep and not allocation.steady) or (task.changes >= MOST_CHANGES and not nearer):
            index = held
    if index != NO_TARGET:
        cell = _cell(view, index)
        reason = Reason.KEPT if task.kind is TaskKind.TARGET and task.cell == cell else Reason.ALLOCATED
        return _assign(view, TaskKind.TARGET, cell, reason, task, allocation)
    frontier = allocation.frontier
    if frontier is None or view.distances[0][frontier] == UNREACHABLE:
        frontier = frontier_for_ego(view, allocation.choices, rules.r_sense)
    elif task.kind is TaskKind.EXPLORE:
        frontier = settled(view, frontier, task.cell)
    if frontier is None:
        index = abandoned(view)
        if index != NO_TARGET:
            return _assign(view, TaskKind.TARGET, _cell(view, index), Reason.ABANDONED, task, allocation)
        return Assignment(TaskKind.HOLD, view.robots[0].cell, Reason.NOTHING_LEFT, (), allocation.xy)
    return _assign(view, TaskKind.EXPLORE, frontier, Reason.FRONTIER, task, allocation)


def contested(view: View) -> npt.NDArray[np.bool_]:
    """Targets that another robot of the view is on its way to, and nearer (ties by id): bool [M]."""
    taken = np.zeros(len(view.targets), dtype=np.bool_)
    claims = [(row, robot) for row, robot in enumerate(view.robots) if row and robot.task is TaskKind.TARGET]
    if not claims:
        return taken
    time, ego = travel_times(view).item, view.robots[0]
    index_of = {(x, y): index for index, (x, y) in enumerate(view.targets.tolist())}
    for row, robot in claims:
        index = index_of.get(robot.task_cell)
        if index is not None and (time(row, index), robot.robot_id) < (time(0, index), ego.robot_id):
            taken[index] = True
    return taken


def proposed(view: View, allocation: Allocation, taken: npt.NDArray[np.bool_]) -> int:
    """The allocator's choice for ego; where that is contested, ego's best-scored target that nobody else gets."""
    choice = int(allocation.choices[0])
    if choice == NO_TARGET or (not taken[choice] and view.lengths[0, choice] != UNREACHABLE):
        return choice
    open_to_ego = ~taken & (view.lengths[0] != UNREACHABLE)
    others = np.array([*allocation.choices[1:], *allocation.kept_for_absent], dtype=np.int64)
    open_to_ego[others[others != NO_TARGET]] = False
    if not open_to_ego.any():
        return NO_TARGET
    return int(np.where(open_to_ego, allocation.scores[0], -np.inf).argmax())


def abandoned(view: View) -> int:
    """Ego's nearest target that no other robot of the view is on its way to, or NO_TARGET.

    Views differ: each of two robots can believe that a target is the other's. A robot with nothing else to do does not
    wait for what nobody claims, so that no mission waits for ever.
    """
    times = travel_times(view)[0].copy()
    for robot in view.robots[1:]:
        index = _index_of(view, robot.task_cell) if robot.task is TaskKind.TARGET else NO_TARGET
        if index != NO_TARGET:
            times[index] = np.inf
    return int(times.argmin()) if times.size and np.isfinite(times.min()) else NO_TARGET


def to_command(kind: RobotKind, assignment: Assignment) -> VehicleCommand:
    """What the vehicle is told: a UAV flies straight there, a UGV drives through the corners of the path."""
    if assignment.kind is TaskKind.HOLD:
        return Hold(assignment.reason.value)
    return Goto(assignment.cell) if kind is RobotKind.UAV else Mission(simplify(assignment.path))


def _assign(view: View, kind: TaskKind, cell: Cell, reason: Reason, task: Task, allocation: Allocation) -> Assignment:
    path = task.path if _still_good(view, cell, task) else path_to(cell, _ways(view))
    return Assignment(kind, cell, reason, path, allocation.xy)


def _ways(view: View) -> IntGrid:
    """Ego's distances to walk down along: a UAV flies also over cells in which it could not end."""
    ego = view.robots[0]
    return manhattan(ego.cell, view.belief.shape) if ego.kind is RobotKind.UAV else view.distances[0]


def _still_good(view: View, goal: Cell, task: Task) -> bool:
    """The old path leads there, the robot is on it, nothing has turned up on it, and there is no shorter one now.

    A path that stays the same needs no new mission on board.
    """
    here = view.robots[0].cell
    if task.cell != goal or here not in task.path:
        return False
    ahead = task.path[task.path.index(here) :]
    free = passable(view.robots[0].kind, view.belief)
    return len(ahead) - 1 <= view.distances[0][goal] and all(free[cell] for cell in ahead)


def _index_of(view: View, cell: Cell) -> int:
    targets, wanted = view.targets.tolist(), [*cell]
    return targets.index(wanted) if wanted in targets else NO_TARGET


def _cell(view: View, index: int) -> Cell:
    return int(view.targets[index, 0]), int(view.targets[index, 1])
