"""Small worlds and views for tests."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gatar_edge.types import ByteGrid, Cell, Cells, CellState, Observation, RobotKind, RobotState, TaskKind
from gatar_edge.view import View, build_view

SIGNS = dict(zip("?.#Tx", CellState, strict=True))


def belief_of(picture: str) -> ByteGrid:
    """A belief drawn with north up: `?` unknown, `.` free, `#` obstacle, `T` target, `x` localized."""
    rows = [line.strip() for line in picture.strip().splitlines()]
    belief = np.array([[SIGNS[sign] for sign in row] for row in reversed(rows)], dtype=np.uint8).T.copy()
    belief.flags.writeable = False
    return belief


def robot(
    robot_id: int,
    cell: Cell,
    kind: RobotKind = RobotKind.UAV,
    speed: float = 1.0,
    target: Cell | None = None,
) -> RobotState:
    """A robot, on its way to `target` where one is given."""
    if target is None:
        return RobotState(robot_id, kind, cell, speed)
    return RobotState(robot_id, kind, cell, speed, TaskKind.TARGET, target)


def view_of(belief: ByteGrid, ego: RobotState, others: Sequence[RobotState] = (), r_comm: float = 6.0) -> View:
    """The view of `ego` at time 0."""
    return build_view(0, ego, others, belief, r_comm, 2, 64)


def cells(*pairs: Cell) -> Cells:
    """An array of cells."""
    return np.array(pairs, dtype=np.int16).reshape(-1, 2)


def observation(
    cell: Cell,
    seen: Sequence[Cell] = (),
    obstacles: Sequence[Cell] = (),
    targets: Sequence[Cell] = (),
    robot_id: int = 1,
    kind: RobotKind = RobotKind.UAV,
    t_ns: int = 0,
) -> Observation:
    """What a robot at `cell` saw; obstacles and targets count as seen."""
    return Observation(
        robot_id, kind, cell, cells(*seen, *obstacles, *targets), cells(*obstacles), cells(*targets), t_ns
    )
