"""Neighbours as robots of a decision: who of those that were heard takes part in it."""

from __future__ import annotations

from collections.abc import Iterable

from gatar_edge.neighbors import Neighbor
from gatar_edge.types import GridSpec, RobotState, TaskKind


def taking_part(neighbors: Iterable[Neighbor], grid: GridSpec, now_ns: int) -> list[RobotState]:
    """Those that can move and are on the grid: one that does not know its place yet, or claims another, is left out."""
    return [_state_of(neighbor, now_ns) for neighbor in neighbors if _moves_on(grid, neighbor)]


def remembered(neighbors: Iterable[Neighbor], grid: GridSpec, now_ns: int) -> list[RobotState]:
    """The same of those that fell silent, as they were then; where they went must lie on the grid too."""
    return [
        _state_of(neighbor, now_ns)
        for neighbor in neighbors
        if _moves_on(grid, neighbor)
        and (neighbor.message.task is TaskKind.HOLD or grid.has(neighbor.message.task_cell))
    ]


def _moves_on(grid: GridSpec, neighbor: Neighbor) -> bool:
    return neighbor.message.speed_cells_s > 0 and grid.has(neighbor.message.cell)


def _state_of(neighbor: Neighbor, now_ns: int) -> RobotState:
    m = neighbor.message
    return RobotState(m.robot_id, m.kind, m.cell, m.speed_cells_s, m.task, m.task_cell, now_ns - neighbor.heard_ns)
