"""How the robots of an episode see and move, and who drives them: the expert, their own view, or slips."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from gatar_edge.learn.jit import compiled
from gatar_edge.learn.kernels import (
    LOCALIZED,
    TARGET,
    UNKNOWN,
    field_of_view,
    greedy,
    list_targets,
    next_step,
    observe,
    path_lengths,
)

Array = npt.NDArray[Any]

DRIVEN_BY_EXPERT, DRIVEN_BY_OWN_VIEW, DRIVEN_WITH_SLIPS = 0, 1, 2
SLIP = 0.3  # share of decisions that are any known target


@compiled
def look(obstacles: Array, here: Array, kinds: Array, cells: Array, r_sense: float, own: Array, left: Array) -> None:
    """Everybody takes in what it sees; `here` bool [W, H] are the targets, `left` those that nobody has visited."""
    width, height = obstacles.shape
    seen = np.empty((width, height), dtype=np.bool_)
    rows = np.empty((width + height + 8, 3), dtype=np.float32)
    for n in range(len(kinds)):
        field_of_view(obstacles, kinds[n] == 1, cells[n, 0], cells[n, 1], r_sense, seen, rows)
        observe(own[n], obstacles, here, seen, cells[n, 0], cells[n, 1])
        left[cells[n, 0], cells[n, 1]] = False


@compiled
def move(
    obstacles: Array, kinds: Array, speeds: Array, goals: Array, beliefs: Array, way: Array, cells: Array, own: Array,
    left: Array,
) -> None:  # fmt: skip
    """Everybody goes as far as its speed lets it in one step; `way` [N] keeps parts of a cell."""
    width, height = obstacles.shape
    distance = np.empty((width, height), dtype=np.int32)
    queue = np.empty(width * height, dtype=np.int64)
    for n in range(len(kinds)):
        way[n] += speeds[n]
        while way[n] >= 1:
            way[n] -= 1
            _drive(beliefs[n], kinds[n] == 1, obstacles, cells[n], goals[n], distance, queue)
            left[cells[n, 0], cells[n, 1]] = False
            if own[n, cells[n, 0], cells[n, 1]] == TARGET:
                own[n, cells[n, 0], cells[n, 1]] = LOCALIZED


@compiled
def choose_goals(
    driver: int, beliefs: Array, kinds: Array, speeds: Array, cells: Array, hops: Array, expert: Array
) -> Array:
    """Where each robot goes: as the expert says, as its own view says, or as the expert says with slips."""
    goals = expert.copy()
    if driver == DRIVEN_BY_EXPERT:
        return goals
    own = np.empty_like(goals)
    targets = np.empty((beliefs.shape[1] * beliefs.shape[2], 2), dtype=np.int64)
    for n in range(len(kinds)):
        if driver == DRIVEN_BY_OWN_VIEW:
            assign(beliefs[n], kinds, speeds, cells, hops[n] >= 0, own)
            goals[n] = own[n]
        elif np.random.random() < SLIP:
            count = list_targets(beliefs[n], targets)
            if count:
                goals[n] = targets[np.random.randint(count)]
    return goals


@compiled
def assign(belief: Array, kinds: Array, speeds: Array, cells: Array, members: Array, goals: Array) -> None:
    """Greedy over `belief` among the robots with `members` true; targets' cells into `goals` [N, 2], -1 where none."""
    width, height = belief.shape
    targets = np.empty((width * height, 2), dtype=np.int64)
    count = list_targets(belief, targets)
    rows = np.flatnonzero(members)
    times = np.empty((len(rows), count))
    distance = np.empty((width, height), dtype=np.int32)
    queue = np.empty(width * height, dtype=np.int64)
    for row in range(len(rows)):
        n = rows[row]
        path_lengths(belief, kinds[n] == 1, cells[n, 0], cells[n, 1], distance, queue)
        for m in range(count):
            steps = distance[targets[m, 0], targets[m, 1]]
            times[row, m] = steps / speeds[n] if steps >= 0 else np.inf
    choices = np.empty(len(rows), dtype=np.int64)
    greedy(times, choices)
    goals[:] = -1
    for row in range(len(rows)):
        if choices[row] >= 0:
            goals[rows[row]] = targets[choices[row]]


@compiled
def _drive(belief: Array, ugv: bool, obstacles: Array, cell: Array, goal: Array, distance: Array, queue: Array) -> None:
    """Move one robot one cell towards its goal, or towards the nearest unknown cell, as its own belief lets it."""
    path_lengths(belief, ugv, cell[0], cell[1], distance, queue)
    gx, gy = goal[0], goal[1]
    if gx < 0 or distance[gx, gy] < 0:
        gx, gy, best = -1, -1, 2**30
        ties = 0
        for i in range(belief.shape[0]):
            for j in range(belief.shape[1]):
                if belief[i, j] == UNKNOWN and 0 <= distance[i, j] <= best:
                    ties = ties + 1 if distance[i, j] == best else 1
                    if np.random.randint(ties) == 0:
                        gx, gy = i, j
                    best = distance[i, j]
    if gx >= 0:
        x, y = next_step(distance, gx, gy)
        if not (ugv and obstacles[x, y]):  # a second cell in one step may not have been seen
            cell[0], cell[1] = x, y
