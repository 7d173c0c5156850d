"""Whom a robot must keep away from where it comes to rest."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

from gatar_edge.neighbors import Neighbor
from gatar_edge.separation import occupied
from gatar_edge.types import GridSpec, RobotKind, TaskKind

GRID = GridSpec(15, 15, 10.0)


def neighbor(robot_id: int, kind: RobotKind = RobotKind.UGV, task: TaskKind = TaskKind.TARGET, **more: Any) -> Neighbor:
    message = {"robot_id": robot_id, "kind": kind, "task": task, "cell": (1, 1), "task_cell": (4, 4)}
    return Neighbor(cast(Any, SimpleNamespace(**message, speed_cells_s=1.0, **more)), 0)


def places(robot_id: int, kind: RobotKind, *neighbors: Neighbor) -> list[tuple[float, float]]:
    return [place.point_m for place in occupied(robot_id, kind, neighbors, GRID)]


def test_one_that_stands_keeps_its_cell() -> None:
    assert places(2, RobotKind.UGV, neighbor(9, task=TaskKind.HOLD)) == [(15.0, 15.0)]
    standing = occupied(2, RobotKind.UGV, (neighbor(9, task=TaskKind.HOLD), neighbor(1)), GRID)
    assert [place.stands for place in standing] == [True, False]


def test_of_two_on_their_way_the_one_with_the_lower_id_goes() -> None:
    assert places(2, RobotKind.UGV, neighbor(1)) == [(45.0, 45.0)]
    assert places(1, RobotKind.UGV, neighbor(2)) == []


def test_what_flies_is_in_no_ones_way_on_the_ground_nor_the_other_way_round() -> None:
    assert places(2, RobotKind.UGV, neighbor(1, RobotKind.UAV)) == []
    assert places(2, RobotKind.UAV, neighbor(1), neighbor(3, RobotKind.UAV)) == []
