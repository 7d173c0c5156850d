"""Where robots are that were heard before and are out of range now: remembered, and moved on towards their goals.

A robot that should be heard and is not, is not there: one whose expected place lies within radio range of ego or of a
neighbour of ego's is left out, and no target is kept for it.

A robot that died elsewhere looks like one that goes on, and nobody would take over its target. Only time tells: the
less of the world lies out of earshot, the sooner a robot that lives is heard again. So ego's patience is as long as
the world is large, in discs of the radio's range, and ends at `REMEMBER_S`. A robot that hears nobody has it that
long in any world: it would take the whole mission for its own, and silence tells it least.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from msgspec.structs import replace

from gatar_edge.types import NS_PER_S, Cell, RobotState, TaskKind

REMEMBER_S = 30.0  # since a robot was last heard
PATIENCE_S = 1.5  # for each disc of radio range that the world has room for


def expected_cell(cell: Cell, goal: Cell, travelled: float) -> Cell:
    """Where a robot is that left `cell` straight for `goal` and has `travelled` so many cells; then it waits."""
    way = abs(goal[0] - cell[0]) + abs(goal[1] - cell[1])
    share = min(1.0, travelled / way) if way else 1.0
    x, y = (math.floor(a + share * (b - a) + 0.5) for a, b in zip(cell, goal, strict=True))
    return x, y


def patience_s(heard: int, cells: int, r_comm: float) -> float:
    """How long ego reckons with a robot that fell silent, if it hears so many others, in a world of so many cells."""
    disc = math.pi * r_comm**2
    return min(REMEMBER_S, PATIENCE_S * cells / disc) if heard and disc else REMEMBER_S


def out_of_range(
    last_heard: Iterable[RobotState], near: Sequence[RobotState], for_s: float, r_comm: float
) -> tuple[RobotState, ...]:
    """Of `last_heard`, robots as they were when they fell silent, those that may well be out of earshot now, by id.

    `near` are ego and its direct neighbours, `for_s` is ego's patience.
    """
    found = []
    for robot in last_heard:
        if robot.age_ns > for_s * NS_PER_S:
            continue
        goal = robot.task_cell if robot.task is not TaskKind.HOLD else robot.cell
        cell = expected_cell(robot.cell, goal, robot.age_ns / NS_PER_S * robot.speed_cells_s)
        if all(math.dist(cell, other.cell) > r_comm for other in near):
            found.append(replace(robot, cell=cell))
    return tuple(sorted(found, key=lambda robot: robot.robot_id))
