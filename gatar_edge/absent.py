"""Where robots are that were heard before and are out of range now: remembered on their way to their goals.

A robot that should be heard and is not, is not there: one whose expected place lies within radio range of ego or of a
neighbour of ego's is left out, and no target is kept for it. Nor is one reckoned with that must have come to its goal:
it has visited its target and set out for another one, or it died on the way; nobody here knows where it is. A robot
that died on its way to a goal out of earshot looks like one that goes on: it is reckoned with until it would have
arrived, `REMEMBER_S` have passed, or somebody comes near enough to miss it. Until then an allocator that remembers may
leave its target to it; `tasks.abandoned` takes that target at once where nothing else is left to do.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from msgspec.structs import replace

from gatar_edge.types import NS_PER_S, Cell, RobotState, TaskKind

REMEMBER_S = 30.0  # since a robot was last heard


def expected_cell(cell: Cell, goal: Cell, travelled: float) -> Cell | None:
    """Where a robot is that left `cell` straight for `goal` and has `travelled` so many cells; None: it is past."""
    way = abs(goal[0] - cell[0]) + abs(goal[1] - cell[1])
    if travelled > way:
        return None
    share = travelled / way if way else 0.0
    x, y = (math.floor(a + share * (b - a) + 0.5) for a, b in zip(cell, goal, strict=True))
    return x, y


def out_of_range(last_heard: Iterable[RobotState], near: Sequence[RobotState], r_comm: float) -> tuple[RobotState, ...]:
    """Of `last_heard`, robots as they were when they fell silent, those that may well be out of earshot now, by id.

    `near` are ego and its direct neighbours.
    """
    found = []
    for robot in last_heard:
        if robot.age_ns > REMEMBER_S * NS_PER_S:
            continue
        goal = robot.task_cell if robot.task is not TaskKind.HOLD else robot.cell
        cell = expected_cell(robot.cell, goal, robot.age_ns / NS_PER_S * robot.speed_cells_s)
        if cell is not None and all(math.dist(cell, other.cell) > r_comm for other in near):
            found.append(replace(robot, cell=cell))
    return tuple(sorted(found, key=lambda robot: robot.robot_id))
