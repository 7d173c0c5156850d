"""Plan whole tours for the team over all known targets, and go to the first stop of the own one.

The strongest classical rule here: it sees that a target now near lies on somebody's way later.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from gatar_edge.allocators import tours
from gatar_edge.allocators.base import NO_TARGET, Allocation, in_id_order, scores_of
from gatar_edge.allocators.tours import Plan, Problem
from gatar_edge.grid import UNREACHABLE
from gatar_edge.types import RobotKind
from gatar_edge.view import View, target_legs, travel_times, with_absent

Tours = list[list[int]]
Planner = Callable[[Problem, int], Tours]  # a problem of arrays, rounds of search -> targets of each robot in order


class Routing:
    """Each robot plans the same tours on its own view. `planner` may be the compiled twin of `plan_on_lists`."""

    name = "routing"

    def __init__(self, planner: Planner | None = None, rounds: int = tours.ROUNDS) -> None:
        self._planner = planner if planner is not None else plan_on_lists
        self._rounds = rounds

    def allocate(self, view: View) -> Allocation:
        """See `allocators.base.Allocator`."""
        times = travel_times(view)
        choices = np.full(len(view.robots), NO_TARGET, dtype=np.int32)
        if np.isfinite(times).any():
            order = in_id_order(view)
            for row, tour in zip(order, self._planner(problem_of(view), self._rounds), strict=True):
                if tour:
                    choices[row] = tour[0]
        return Allocation(choices, scores_of(times))


class RoutingWithMemory(Routing):
    """The same, reckoning also with robots that are out of range: what the field model knows, without a network."""

    name = "routing+memory"

    def allocate(self, view: View) -> Allocation:
        """See `allocators.base.Allocator`."""
        whole = with_absent(view)
        joint = super().allocate(whole).choices
        rows = {robot.robot_id: row for row, robot in enumerate(whole.robots)}
        return Allocation(
            choices=joint[[rows[robot.robot_id] for robot in view.robots]],
            scores=scores_of(travel_times(view)),
            absent=view.absent,
            kept_for_absent=tuple(int(joint[rows[robot.robot_id]]) for robot in view.absent),
        )


def problem_of(view: View) -> Problem:
    """The view as arrays, robots by id: every robot of a graph plans the same tours."""
    order = in_id_order(view)
    robots = [view.robots[row] for row in order]
    kinds = np.array([robot.kind for robot in robots], dtype=np.int64)
    pace = np.array([1 / robot.speed_cells_s for robot in robots])
    lengths = view.lengths[order]
    first = np.where(lengths == UNREACHABLE, np.inf, lengths * pace[:, None])
    return Problem(first, legs_between(view), kinds, pace)


def legs_between(view: View) -> npt.NDArray[np.float64]:
    """Cells from target to target by kind of robot: float64 [2, M, M], inf where there is no way or no such robot."""
    legs = np.full((len(RobotKind), len(view.targets), len(view.targets)), np.inf)
    for kind in {robot.kind for robot in view.robots}:
        legs[kind] = target_legs(view, kind)
    return legs


def plan_on_lists(problem: Problem, rounds: int) -> Tours:
    """Plan without a compiler: slower, and equal to the last bit."""
    robots, targets = problem.first.shape
    plan = Plan(
        tour=[[0] * targets for _ in range(robots)],
        count=[0] * robots,
        sums=[0.0] * robots,
        ends=[0.0] * robots,
        kept=[[0] * targets for _ in range(robots)],
        kept_count=[0] * robots,
        removed=[0] * targets,
    )
    tours.solve(Problem(*(array.tolist() for array in problem)), plan, rounds)
    return [plan.kept[robot][: plan.kept_count[robot]] for robot in range(robots)]
