"""Whom a robot must keep away from where it comes to rest: what its neighbours tell, as places for the safety gate.

UAVs fly in layers, one each; ground robots share one, so only they are in each other's way. One that stands keeps its
cell. Of two that want the same place the one with the lower id goes: were both to give way, neither would get there.
"""

from __future__ import annotations

from collections.abc import Iterable

from gatar_edge.neighbors import Neighbor
from gatar_edge.types import GridSpec, RobotKind, TaskKind

GROUND_M = 0.0

Place = tuple[tuple[float, float], float]  # metres along the grid's axes, and above home


def occupied(robot_id: int, kind: RobotKind, neighbors: Iterable[Neighbor], grid: GridSpec) -> tuple[Place, ...]:
    """The places to keep away from; none for a UAV."""
    if kind is not RobotKind.UGV:
        return ()
    cells = []
    for neighbor in neighbors:
        message = neighbor.message
        if message.kind is not RobotKind.UGV:
            continue
        if message.task is TaskKind.HOLD or message.speed_cells_s == 0:
            cells.append(message.cell)
        elif message.robot_id < robot_id:
            cells.append(message.task_cell)
    return tuple((((x + 0.5) * grid.cell_m, (y + 0.5) * grid.cell_m), GROUND_M) for x, y in cells)
