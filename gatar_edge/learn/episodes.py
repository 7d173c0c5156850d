"""Sequential episodes as in the paper: robots see, tell, are given targets by the expert, move; visited targets vanish.

Each robot's belief is what it would be in flight: its own view, remembered, and everything that robots within
`hop_limit` hops knew. The label is the central greedy expert's choice on the union of all beliefs, whoever drives.
"""

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
    hop_counts,
    list_targets,
    next_step,
    observe,
    pack,
    path_lengths,
)

Array = npt.NDArray[Any]

NO_LABEL = 255  # in place of a cell's coordinate: the expert gives this robot nothing
KNOWABLE = 1  # flag: the label's target is in the robot's own belief
DRIVEN_BY_EXPERT, DRIVEN_BY_OWN_VIEW, DRIVEN_WITH_SLIPS = 0, 1, 2
SLIP = 0.3  # share of decisions that are any known target


@compiled
def share(beliefs: Array, hops: Array, out: Array) -> None:
    """Everybody hears everybody within the hop limit: [N, W, H] -> the merged beliefs in `out`."""
    count = beliefs.shape[0]
    for n in range(count):
        out[n] = beliefs[n]
        for m in range(count):
            if m != n and hops[n, m] > 0:
                for i in range(beliefs.shape[1]):
                    for j in range(beliefs.shape[2]):
                        out[n, i, j] = max(out[n, i, j], beliefs[m, i, j])


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


@compiled
def _choose_goals(
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
def episode(
    obstacles: Array,
    places: Array,
    starts: Array,
    kinds: Array,
    speeds: Array,
    r_sense: float,
    r_comm: float,
    hop_limit: int,
    driver: int,
    seed: int,
    packed: Array,
    robots: Array,
) -> int:
    """Fly one world to its end or until `packed` uint8 [S, N, B] and `robots` uint8 [S, N, 8] are full; returns steps.

    `places` int64 [M, 2], `starts` int64 [N, 2], `kinds` int64 [N], `speeds` float64 [N] in cells a step. `robots`
    holds x, y, label x, label y, flags, x and y of the task from the step before, and the speed in sixteenths.
    """
    np.random.seed(seed)
    width, height = obstacles.shape
    count = len(kinds)
    cells = starts.copy()
    here = np.zeros((width, height), dtype=np.bool_)
    left = np.zeros((width, height), dtype=np.bool_)
    for m in range(len(places)):
        here[places[m, 0], places[m, 1]] = True
        left[places[m, 0], places[m, 1]] = True
    own = np.zeros((count, width, height), dtype=np.uint8)
    beliefs = np.zeros((count, width, height), dtype=np.uint8)
    union = np.zeros((width, height), dtype=np.uint8)
    hops = np.empty((count, count), dtype=np.int64)
    goals = np.empty((count, 2), dtype=np.int64)
    seen = np.empty((width, height), dtype=np.bool_)
    rows = np.empty((width + height + 8, 3), dtype=np.float32)
    distance = np.empty((width, height), dtype=np.int32)
    queue = np.empty(width * height, dtype=np.int64)
    everybody = np.ones(count, dtype=np.bool_)
    tasks = np.full((count, 2), -1, dtype=np.int64)
    way = np.zeros(count)
    for step in range(packed.shape[0]):
        for n in range(count):
            field_of_view(obstacles, kinds[n] == 1, cells[n, 0], cells[n, 1], r_sense, seen, rows)
            observe(own[n], obstacles, here, seen, cells[n, 0], cells[n, 1])
            left[cells[n, 0], cells[n, 1]] = False
        hop_counts(cells, r_comm, hop_limit, hops)
        share(own, hops, beliefs)
        own[:] = beliefs
        union[:] = 0
        for n in range(count):
            union[:] = np.maximum(union, beliefs[n])
        assign(union, kinds, speeds, cells, everybody, goals)
        for n in range(count):
            pack(beliefs[n], packed[step, n])
            robots[step, n, 0], robots[step, n, 1] = cells[n, 0], cells[n, 1]
            robots[step, n, 2:4] = NO_LABEL
            robots[step, n, 4] = 0
            robots[step, n, 5], robots[step, n, 6] = tasks[n, 0] & 255, tasks[n, 1] & 255
            robots[step, n, 7] = int(speeds[n] * 16)
            if goals[n, 0] >= 0:
                robots[step, n, 2], robots[step, n, 3] = goals[n, 0], goals[n, 1]
                if beliefs[n, goals[n, 0], goals[n, 1]] == TARGET:
                    robots[step, n, 4] = KNOWABLE
        if not left.any():
            return step + 1
        goals = _choose_goals(driver, beliefs, kinds, speeds, cells, hops, goals)
        tasks[:] = goals
        for n in range(count):
            way[n] += speeds[n]
            while way[n] >= 1:
                way[n] -= 1
                _drive(beliefs[n], kinds[n] == 1, obstacles, cells[n], goals[n], distance, queue)
                left[cells[n, 0], cells[n, 1]] = False
                if own[n, cells[n, 0], cells[n, 1]] == TARGET:
                    own[n, cells[n, 0], cells[n, 1]] = LOCALIZED
    return int(packed.shape[0])
