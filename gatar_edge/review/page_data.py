"""What travels inside the page: gathered by `story`, small whatever the mission's length."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from gatar_edge.review.company import Json
from gatar_edge.review.info import Figures
from gatar_edge.types import ByteGrid, CellState

BUCKETS = 300  # points of a chart
NS_PER_MS = 1_000_000


@dataclass(slots=True)
class RobotStory:
    """What one robot did, as flat lists of numbers."""

    track: list[float] = field(default_factory=list)  # t, x, y, ...: true places, or those of its decisions
    tasks: list[list[Any]] = field(default_factory=list)  # [t, kind, x, y, event]
    paths: list[list[int]] = field(default_factory=list)  # [t, x0, y0, x1, y1, ...] corners only
    links: list[list[int]] = field(default_factory=list)  # [t, id, ...] robots heard directly
    absent: list[list[int]] = field(default_factory=list)  # [t, id, kind, x, y, ...] robots out of range, reckoned with
    belief: list[list[int]] = field(default_factory=list)  # [t, cell * 8 + state, ...] of cells that changed
    known: ByteGrid | None = None
    previous: Json | None = None
    vehicle: list[list[Any]] = field(default_factory=list)  # [t, mode, phase, battery]


@dataclass(slots=True)
class Story:
    """What has been gathered of a mission so far."""

    start_ns: int
    figures: Figures
    robots: defaultdict[int, RobotStory] = field(default_factory=lambda: defaultdict(RobotStory))
    events: list[Json] = field(default_factory=list)
    events_left_out: int = 0
    truth: ByteGrid | None = None
    visits: list[list[Any]] = field(default_factory=list)  # [t, robot, x, y, step]
    faults: list[list[Any]] = field(default_factory=list)
    lines: list[list[Any]] = field(default_factory=list)
    has_truth_tracks: bool = False
    latencies: list[list[float]] = field(default_factory=list)  # [t, ms] as sampled
    ages: list[list[float]] = field(default_factory=list)  # [t, s, robots heard]
    radio: list[list[float]] = field(default_factory=list)  # [t, messages, bytes]
    stride: int = 1


def page_data(story: Story, summary: Json, name: str) -> Json:
    """The data of one mission's page."""
    info = story.figures.run_info
    config = info.get("config", {})
    grid = config.get("grid", {"width": 15, "height": 15, "cell_m": 10.0})
    kinds = {robot["robot_id"]: robot["kind"] for robot in info.get("robots", ())}
    return {
        "name": name,
        "run": summary["run"],
        "result": summary["result"],
        "robot_figures": summary["robots"],
        "health": summary["health"],
        "finished": summary["finished"],
        "duration": (story.figures.last_ns - story.start_ns) // NS_PER_MS,
        "step_ms": float(info.get("step_s", 1.0)) * 1000,
        "grid": {"w": grid["width"], "h": grid["height"], "cell_m": grid["cell_m"]},
        "r_sense": config.get("r_sense", 4.0),
        "r_comm": config.get("r_comm", 6.0),
        "truth": None if story.truth is None else "".join(map(str, story.truth.reshape(-1).tolist())),
        "targets": [] if story.truth is None else np.argwhere(story.truth == CellState.TARGET).tolist(),
        "visits": story.visits,
        "robots": [_robot(number, kinds.get(number, 0), story.robots[number]) for number in sorted(story.robots)],
        "events": story.events,
        "events_left_out": story.events_left_out,
        "faults": story.faults,
        "lines": story.lines,
        "latency": buckets(story.latencies, BUCKETS),
        "ages": buckets(story.ages, BUCKETS),
        "radio": story.radio,
    }


def _robot(number: int, kind: int, robot: RobotStory) -> Json:
    return {
        "id": number,
        "kind": kind,
        "track": robot.track,
        "tasks": robot.tasks,
        "paths": robot.paths,
        "links": robot.links,
        "absent": robot.absent,
        "belief": robot.belief,
        "vehicle": robot.vehicle,
    }


def buckets(rows: list[list[float]], most: int) -> list[list[float]]:
    """Rows [t, value, ...] gathered into at most `most` spans: [t, median, 99th percentile, means of the rest]."""
    if not rows:
        return []
    table = np.array(rows)
    span = max(1.0, (table[-1, 0] - table[0, 0] + 1) / most)
    which = ((table[:, 0] - table[0, 0]) // span).astype(int)
    found = []
    for bucket in np.unique(which):
        part = table[which == bucket]
        low, high = np.percentile(part[:, 1], (50, 99))
        found.append(
            [int(part[0, 0]), round(float(low), 4), round(float(high), 4), *part[:, 2:].mean(axis=0).round(2).tolist()]
        )
    return found


def corners(path: list[list[int]]) -> list[int]:
    """The first and last cell of a path and those where it turns, flat."""
    flat: list[int] = []
    for index, cell in enumerate(path):
        if 0 < index < len(path) - 1:
            before, after = path[index - 1], path[index + 1]
            if (cell[0] - before[0], cell[1] - before[1]) == (after[0] - cell[0], after[1] - cell[1]):
                continue
        flat.extend(cell)
    return flat


def rounded(value: float | None) -> float | None:
    """Four digits are enough for the eye."""
    return None if value is None else float(f"{value:.4g}")
