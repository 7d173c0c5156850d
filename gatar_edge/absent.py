"""Where robots are that were heard before and are out of range now: remembered, and moved on towards their goals.

A robot that should be heard and is not, is not there: one whose expected place lies within radio range of ego or of a
neighbour of ego's is left out, and no target is kept for it. Nor is one that must have come to its goal, while ego
hears more robots than have fallen silent: who lives and goes on is heard of again before long, and what most of the
team does not hear of may well be dead. To a robot that hears few, silence says little: it reckons with the others at
their goals.

A robot that died on its way to a goal out of earshot looks like one that goes on. So an allocator that remembers may
leave its target to it until it would have arrived, at most for `REMEMBER_S`; `tasks.abandoned` takes that target at
once where nothing else is left to do.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from msgspec.structs import replace

from gatar_edge.types import NS_PER_S, Cell, RobotState, TaskKind

REMEMBER_S = 30.0  # since a robot was last heard


def expected_cell(cell: Cell, goal: Cell, travelled: float) -> Cell:
    """Where a robot is that left `cell` straight for `goal` and has `travelled` so many cells; then it waits."""
    way = _way(cell, goal)
    share = min(1.0, travelled / way) if way else 1.0
    x, y = (math.floor(a + share * (b - a) + 0.5) for a, b in zip(cell, goal, strict=True))
    return x, y


def out_of_range(
    last_heard: Iterable[RobotState], near: Sequence[RobotState], heard: int, r_comm: float
) -> tuple[RobotState, ...]:
    """Of `last_heard`, robots as they were when they fell silent, those that may well be out of earshot now, by id.

    `near` are ego and its direct neighbours, `heard` is how many robots ego hears, over whatever number of hops.
    """
    found = []
    silent = [robot for robot in last_heard if robot.age_ns <= REMEMBER_S * NS_PER_S]
    hears_most = heard > len(silent)
    for robot in silent:
        goal = robot.task_cell if robot.task is not TaskKind.HOLD else robot.cell
        travelled = robot.age_ns / NS_PER_S * robot.speed_cells_s
        if hears_most and travelled > _way(robot.cell, goal):
            continue
        cell = expected_cell(robot.cell, goal, travelled)
        if all(math.dist(cell, other.cell) > r_comm for other in near):
            found.append(replace(robot, cell=cell))
    return tuple(sorted(found, key=lambda robot: robot.robot_id))


def _way(cell: Cell, goal: Cell) -> int:
    return abs(goal[0] - cell[0]) + abs(goal[1] - cell[1])
