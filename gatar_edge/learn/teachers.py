"""Teachers over arrays: first stops of the routing rule for thousands of views, compiled.

One view is N robots and M targets: `first` [N, M] seconds from robot to target and `legs` [2, M, M] cells from target
to target for each kind of robot, both inf where there is no way; `kinds` [N]; `pace` [N] seconds a cell. Robots stand
in the order of their ids and targets in that of their cells: this is how ties are broken on the robot, so the labels
are what `allocators.routing.Routing` chooses on the same view, to the last one.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from gatar_edge.allocators.tours import Plan, Problem
from gatar_edge.learn.compiled import compiled_tours
from gatar_edge.learn.jit import compiled
from gatar_edge.learn.kernels import path_lengths
from gatar_edge.types import RobotKind

_solve = compiled_tours().solve
_KINDS = len(RobotKind)

Array = npt.NDArray[Any]


@compiled
def routing(first: Array, legs: Array, kinds: Array, pace: Array, rounds: int, out: Array) -> float:
    """First stop of each robot into `out` int64 [N], -1 where it has none; returns the plan's cost in seconds.

    More `rounds` than `tours.ROUNDS` think longer than a robot could.
    """
    cost, plan = tours_of(first, legs, kinds, pace, rounds)
    for robot in range(len(kinds)):
        out[robot] = plan.kept[robot, 0] if plan.kept_count[robot] > 0 else -1
    return cost


@compiled
def tours_of(first: Array, legs: Array, kinds: Array, pace: Array, rounds: int) -> tuple[float, Plan]:
    """The routing rule's plan for one view, and its cost in seconds."""
    robots, targets = first.shape
    plan = Plan(
        np.zeros((robots, targets), np.int64),
        np.zeros(robots, np.int64),
        np.zeros(robots),
        np.zeros(robots),
        np.zeros((robots, targets), np.int64),
        np.zeros(robots, np.int64),
        np.zeros(targets, np.int64),
    )
    cost: float = _solve(Problem(first, legs, kinds, pace), plan, rounds)
    return cost, plan


@compiled
def legs_between(belief: Array, targets: Array, legs: Array) -> None:
    """Cells from target to target by kind into `legs` float64 [2, M, M], on what `belief` uint8 [W, H] knows."""
    width, height = belief.shape
    distance = np.empty((width, height), dtype=np.int32)
    queue = np.empty(width * height, dtype=np.int64)
    for kind in range(_KINDS):
        for a in range(len(targets)):
            path_lengths(belief, kind == 1, targets[a, 0], targets[a, 1], distance, queue)
            for b in range(len(targets)):
                steps = distance[targets[b, 0], targets[b, 1]]
                legs[kind, a, b] = steps if steps >= 0 else np.inf


@compiled
def routing_on_view(
    belief: Array, lengths: Array, targets: Array, kinds: Array, speeds: Array, rounds: int, out: Array
) -> float:
    """As `routing`, from `lengths` int [N, M] cells (-1 unreachable), `targets` int [M, 2] and `speeds` [N] cells/s."""
    robots, count = lengths.shape
    legs = np.empty((_KINDS, count, count))
    legs_between(belief, targets, legs)
    pace = np.empty(robots)
    first = np.empty((robots, count))
    for n in range(robots):
        pace[n] = 1 / speeds[n]
        for m in range(count):
            first[n, m] = lengths[n, m] * pace[n] if lengths[n, m] >= 0 else np.inf
    cost: float = routing(first, legs, kinds, pace, rounds, out)
    return cost


@compiled
def routing_labels(
    beliefs: Array, lengths: Array, targets: Array, counts: Array, kinds: Array, speeds: Array, rounds: int, out: Array
) -> None:
    """A batch of views into `out` int64 [B, N]: `beliefs` [B, W, H], `lengths` [B, N, M], `targets` [B, M, 2].

    `counts` [B, 2] are the robots and targets of each view, the rest only fills up; `kinds` and `speeds` are
    [B, N].
    """
    for b in range(len(beliefs)):
        robots, count = counts[b, 0], counts[b, 1]
        out[b] = -1
        routing_on_view(
            beliefs[b],
            lengths[b, :robots, :count],
            targets[b, :count],
            kinds[b, :robots],
            speeds[b, :robots],
            rounds,
            out[b, :robots],
        )
