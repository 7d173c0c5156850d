"""Whom a robot must keep away from: what its neighbours tell, as places for the safety gate.

UAVs fly in layers, one each; ground robots share one, so only they are in each other's way. One that stands keeps its
cell, and nobody drives through it. Of two that want the same place the one with the lower id goes: were both to give
way, neither would get there.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from gatar_edge.neighbors import Neighbor
from gatar_edge.types import Cell, GridSpec, RobotKind, TaskKind

GROUND_M = 0.0


class Place(NamedTuple):
    """Where a robot is, or will be."""

    point_m: tuple[float, float]  # along the grid's axes
    altitude_m: float  # above home
    stands: bool = False  # there, for as long as is known


def occupied(robot_id: int, kind: RobotKind, neighbors: Iterable[Neighbor], grid: GridSpec) -> tuple[Place, ...]:
    """The places to keep away from; none for a UAV."""
    if kind is not RobotKind.UGV:
        return ()
    cells: list[tuple[Cell, bool]] = []
    for neighbor in neighbors:
        message = neighbor.message
        if message.kind is not RobotKind.UGV:
            continue
        if message.task is TaskKind.HOLD or message.speed_cells_s == 0:
            cells.append((message.cell, True))
        elif message.robot_id < robot_id:
            cells.append((message.task_cell, False))
    return tuple(
        Place(((x + 0.5) * grid.cell_m, (y + 0.5) * grid.cell_m), GROUND_M, stands) for (x, y), stands in cells
    )
