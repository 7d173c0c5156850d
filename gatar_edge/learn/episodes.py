"""Sequential episodes as in the paper: robots see, tell, are given targets by the expert, move; visited targets vanish.

Each robot's belief is what it would be in flight: its own view, remembered, and everything that robots within
`hop_limit` hops knew. Labels are the teacher's, whoever drives: those of the central greedy expert on the union of all
beliefs, or those of a teacher that plans on each robot's own view.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from gatar_edge.learn.jit import compiled
from gatar_edge.learn.kernels import in_range, over_relays, pack
from gatar_edge.learn.labels import label_by_expert, label_by_plans, record
from gatar_edge.learn.memory import REMEMBER, hear, keep_task, reckon, share
from gatar_edge.learn.moves import choose_goals, look, move
from gatar_edge.learn.plans import FORESIGHT, GREEDY

Array = npt.NDArray[Any]


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
    loss: float,
    teacher: int,
    driver: int,
    seed: int,
    packed: Array,
    robots: Array,
    known: Array,
    votes: Array,
    plans: Array,
) -> int:
    """Fly one world to its end or until the arrays are full, one row a step; returns steps.

    `places` int64 [M, 2], `starts` int64 [N, 2], `kinds` int64 [N], `speeds` float64 [N] in cells a step. Filled:
    `packed` uint8 [S, N, B] beliefs; `robots` uint8 [S, N, 8] x, y, label x, label y, flags, x and y of the task from
    the step before, and the speed in sixteenths; `known` uint8 [S, N, N, 3] where each robot reckons with each other;
    `votes` uint8 [S, N, VOTES, 3]; `plans` uint8 [S, N, N] candidate of each robot in each robot's plan.
    """
    np.random.seed(seed)
    width, height = obstacles.shape
    count = len(kinds)
    cells = starts.copy()
    here = np.zeros((width, height), dtype=np.bool_)
    for m in range(len(places)):
        here[places[m, 0], places[m, 1]] = True
    left = here.copy()
    own = np.zeros((count, width, height), dtype=np.uint8)
    beliefs = np.zeros((count, width, height), dtype=np.uint8)
    hops = np.empty((count, count), dtype=np.int64)
    ears = np.empty((count, count), dtype=np.int64)
    dead = np.zeros(count, dtype=np.bool_)
    heard = np.full((count, count), -1, dtype=np.int64)
    last = np.full((count, count, 4), -1, dtype=np.int64)
    goals = np.empty((count, 2), dtype=np.int64)
    tasks = np.full((count, 2), -1, dtype=np.int64)
    way = np.zeros(count)
    remember = REMEMBER if teacher == FORESIGHT else 0
    for step in range(packed.shape[0]):
        take_in(
            obstacles, here, kinds, speeds, cells, dead, tasks, r_sense, r_comm, hop_limit, loss, remember, step,
            own, left, hops, ears, heard, last, beliefs, packed[step], known[step],
        )  # fmt: skip
        if teacher == GREEDY:
            label_by_expert(beliefs, known[step], kinds, speeds, cells, goals, votes[step], plans[step])
        else:
            label_by_plans(teacher, beliefs, known[step], kinds, speeds, goals, votes[step], plans[step])
        record(beliefs, cells, tasks, speeds, goals, robots[step])
        if not left.any():
            return step + 1
        goals = choose_goals(driver, beliefs, kinds, speeds, cells, hops, goals)
        if teacher != GREEDY:
            for n in range(count):
                keep_task(n, beliefs[n], cells, ears, tasks, goals)
        tasks[:] = goals
        move(obstacles, kinds, speeds, goals, beliefs, way, cells, own, left)
    return int(packed.shape[0])


@compiled
def take_in(
    obstacles: Array, here: Array, kinds: Array, speeds: Array, cells: Array, dead: Array, tasks: Array,
    r_sense: float, r_comm: float, hop_limit: int, loss: float, remember: int, step: int,
    own: Array, left: Array, hops: Array, ears: Array, heard: Array, last: Array, beliefs: Array, packed: Array,
    known: Array,
) -> None:  # fmt: skip
    """One step of a team up to its decision: everybody looks, tells and hears, but the `dead` [N] say and hear nothing.

    Changed are `own` beliefs [N, W, H], targets `left` [W, H], and what was `heard` and `last` told (`memory.hear`);
    filled are `hops` and `ears` [N, N], merged `beliefs` and the same `packed`, and `known` (`memory.reckon`).
    """
    look(obstacles, here, kinds, cells, r_sense, own, left)
    in_range(cells, r_comm, hops)
    for n in range(len(kinds)):
        if dead[n]:
            hops[n], hops[:, n], hops[n, n] = -1, -1, 0
    over_relays(hop_limit, hops)
    hear(hops, loss, cells, tasks, step, ears, heard, last)
    share(own, ears, beliefs)
    own[:] = beliefs
    for n in range(len(kinds)):
        pack(beliefs[n], packed[n])
        reckon(n, cells, speeds, ears, r_comm, obstacles.size, remember, step, heard, last, known[n])
