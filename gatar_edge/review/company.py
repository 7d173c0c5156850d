"""The other robots of a recorded decision, in words and as data: those that were heard, and those out of range."""

from __future__ import annotations

from typing import Any

from gatar_edge.types import NS_PER_S, RobotKind, TaskKind

Json = dict[str, Any]


def neighbors_of(decision: Json) -> list[Json]:
    """The robots that it heard."""
    attention = decision["attention"]
    return [
        {
            **_robot(robot),
            "hops": decision["hops"][row],
            "attention": attention[row] if row < len(attention) else None,
        }
        for row, robot in enumerate(decision["robots"])
        if row > 0
    ]


def absent_of(decision: Json) -> list[Json]:
    """Robots out of range that the allocator reckoned with; `given` is the target that it keeps for each."""
    candidates = decision["candidates"]
    return [
        {**_robot(robot), "given": candidates[choice]["cell"] if choice >= 0 else None}
        for robot, choice in zip(decision.get("absent", ()), decision.get("kept_for_absent", ()), strict=True)
    ]


def _robot(robot: Json) -> Json:
    return {
        "robot_id": robot["robot_id"],
        "kind": robot["kind"],
        "name": f"{RobotKind(robot['kind']).name} {robot['robot_id']}",
        "cell": robot["cell"],
        "age_s": robot["age_ns"] / NS_PER_S,
        "task": robot["task"],
        "task_cell": robot["task_cell"],
    }


def neighbor_line(neighbor: Json) -> str:
    """One neighbour in words."""
    hops = (
        "in range" if neighbor["hops"] == 1 else f"{neighbor['hops']} hops away" if neighbor["hops"] > 1 else "far away"
    )
    attention = f", attention {neighbor['attention']:.0%}" if neighbor["attention"] is not None else ""
    age = f"{neighbor['age_s']:.1f} s old"
    return f"{neighbor['name']} at {cell_text(neighbor['cell'])}, {hops}, {age}, {_task_text(neighbor)}{attention}"


def absent_line(robot: Json) -> str:
    """One robot out of range in words."""
    gets = "" if robot["given"] is None else f"; the joint solution gives it {cell_text(robot['given'])}"
    expected = f"expected at {cell_text(robot['cell'])}"
    return f"{robot['name']}, silent for {robot['age_s']:.1f} s, {expected}, last heard {_task_text(robot)}{gets}"


def _task_text(robot: Json) -> str:
    match TaskKind(robot["task"]):
        case TaskKind.TARGET:
            return f"going for {cell_text(robot['task_cell'])}"
        case TaskKind.EXPLORE:
            return f"exploring towards {cell_text(robot['task_cell'])}"
        case TaskKind.HOLD:
            return "holding"


def cell_text(cell: list[int] | tuple[int, int]) -> str:
    """A cell as text."""
    return f"({cell[0]}, {cell[1]})"
