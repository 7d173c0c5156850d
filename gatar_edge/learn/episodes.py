"""Sequential episodes as in the paper: robots see, tell, are given targets by the expert, move; visited targets vanish.

Each robot's belief is what it would be in flight: its own view, remembered, and everything that robots within
`hop_limit` hops knew. Labels are the teacher's, whoever drives: those of the central greedy expert on the union of all
beliefs, or those of a teacher that plans on each robot's own view.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from gatar_edge.absent import REMEMBER_S
from gatar_edge.features import MAX_CANDIDATES
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
from gatar_edge.learn.plans import FORESIGHT, GREEDY, list_candidates, plan

Array = npt.NDArray[Any]

REMEMBER = int(REMEMBER_S)  # steps: a robot crosses one cell a second
FRESH = 3  # steps for which a neighbour counts where it was heard: `AgentConfig.max_age_s`
VOTES = 2  # candidates stored with their shares
NOBODY = 255  # age of a robot that another one does not reckon with
NO_PLAN = 254  # candidate that is not known
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
def _hear(
    hops: Array, loss: float, cells: Array, tasks: Array, step: int, ears: Array, heard: Array, last: Array
) -> None:
    """Who hears whom at this step into `ears` (hops, -1 where nothing came), and what is remembered of everybody.

    `heard` [N, N] is the step, `last` [N, N, 4] the cell and the goal of the newest message.
    """
    count = len(hops)
    for n in range(count):
        for m in range(count):
            ears[n, m] = hops[n, m]
            if hops[n, m] > 0 and loss > 0 and np.random.random() < loss:
                ears[n, m] = -1
            if ears[n, m] > 0:
                heard[n, m] = step
                last[n, m, :2] = cells[m]
                last[n, m, 2:] = tasks[m]


@compiled
def _reckon(
    n: int, cells: Array, speeds: Array, ears: Array, r_comm: float, remember: int, step: int, heard: Array,
    last: Array, out: Array,
) -> None:  # fmt: skip
    """With whom robot `n` reckons, and where, into `out` uint8 [N, 3]: cell and age in steps, `NOBODY` where not.

    As the agent does: what is fresh counts where it was heard; what fell silent, where it is expected, unless it should
    be heard there (`absent.out_of_range`).
    """
    for m in range(len(cells)):
        out[m] = NOBODY
        age = step - heard[n, m]
        if m == n:
            out[m, 0], out[m, 1], out[m, 2] = cells[n, 0], cells[n, 1], 0
            continue
        if heard[n, m] < 0 or age > max(remember, 0) or (age > 0 and remember == 0):
            continue
        x, y = last[n, m, 0], last[n, m, 1]
        if age > FRESH:
            gx, gy = last[n, m, 2], last[n, m, 3]
            way = abs(gx - x) + abs(gy - y)
            if gx >= 0 and way > 0:
                share_done = min(1.0, age * speeds[m] / way)
                x = int(np.floor(x + share_done * (gx - x) + 0.5))
                y = int(np.floor(y + share_done * (gy - y) + 0.5))
            audible = False
            for k in range(len(cells)):
                if k == n or ears[n, k] == 1:
                    audible |= (cells[k, 0] - x) ** 2 + (cells[k, 1] - y) ** 2 <= r_comm * r_comm
            if audible:
                continue
        out[m, 0], out[m, 1], out[m, 2] = x, y, age


@compiled
def _same(one: Array, other: Array) -> bool:
    return bool((one == other).all())


@compiled
def _plan_for(
    teacher: int, belief: Array, known: Array, kinds: Array, speeds: Array, goals: Array, votes: Array, plans: Array
) -> None:
    """Plan on one robot's view for all robots in it: goals [N, 2], most voted candidates [N, VOTES, 3], choices [N]."""
    width, height = belief.shape
    rows = np.flatnonzero(known[:, 2] != NOBODY)
    distances = np.empty((len(rows), width, height), dtype=np.int32)
    queue = np.empty(width * height, dtype=np.int64)
    for row in range(len(rows)):
        m = rows[row]
        path_lengths(belief, kinds[m] == 1, int(known[m, 0]), int(known[m, 1]), distances[row], queue)
    cells = np.empty((MAX_CANDIDATES, 2), dtype=np.int64)
    dark = np.empty(MAX_CANDIDATES, dtype=np.int64)
    targets, count = list_candidates(belief, distances, teacher == FORESIGHT, cells, dark)
    shares = np.zeros((len(rows), count + 1))
    choices = np.empty(len(rows), dtype=np.int64)
    plan(teacher, belief, distances, kinds[rows], speeds[rows], cells, dark, targets, count, shares, choices)
    goals[:] = -1
    plans[:] = NO_PLAN
    for row in range(len(rows)):
        plans[rows[row]] = choices[row] if choices[row] >= 0 else NO_LABEL
        if choices[row] >= 0:
            goals[rows[row]] = cells[choices[row]]
        _most_voted(shares[row], cells, votes[rows[row]])


@compiled
def _most_voted(shares: Array, cells: Array, votes: Array) -> None:
    """The candidates with the largest shares into `votes` uint8 [VOTES, 3]: cell (`NO_LABEL`: none) and share of 255."""
    left = shares.copy()
    for place in range(len(votes)):
        best = int(left.argmax())
        votes[place] = NO_LABEL
        votes[place, 2] = int(left[best] * 255)
        if best < len(cells) and best < len(left) - 1:
            votes[place, 0], votes[place, 1] = cells[best, 0], cells[best, 1]
        left[best] = 0


@compiled
def _keep_tasks(n: int, belief: Array, cells: Array, kinds: Array, ears: Array, tasks: Array, goals: Array) -> None:
    """A target once taken is kept, as on the robot, unless somebody nearer is on the way to it."""
    x, y = tasks[n, 0], tasks[n, 1]
    if x < 0 or belief[x, y] != TARGET:
        return
    own = abs(cells[n, 0] - x) + abs(cells[n, 1] - y)
    for m in range(len(cells)):
        if m != n and ears[n, m] > 0 and tasks[m, 0] == x and tasks[m, 1] == y:
            other = abs(cells[m, 0] - x) + abs(cells[m, 1] - y)
            if other < own or (other == own and m < n):
                return
    goals[n] = tasks[n]


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
    left = np.zeros((width, height), dtype=np.bool_)
    for m in range(len(places)):
        here[places[m, 0], places[m, 1]] = True
        left[places[m, 0], places[m, 1]] = True
    own = np.zeros((count, width, height), dtype=np.uint8)
    beliefs = np.zeros((count, width, height), dtype=np.uint8)
    union = np.zeros((width, height), dtype=np.uint8)
    hops = np.empty((count, count), dtype=np.int64)
    ears = np.empty((count, count), dtype=np.int64)
    heard = np.full((count, count), -1, dtype=np.int64)
    last = np.full((count, count, 4), -1, dtype=np.int64)
    goals = np.empty((count, 2), dtype=np.int64)
    team_goals = np.empty((count, count, 2), dtype=np.int64)  # by whose plan
    team_votes = np.empty((count, count, VOTES, 3), dtype=np.uint8)
    seen = np.empty((width, height), dtype=np.bool_)
    rows = np.empty((width + height + 8, 3), dtype=np.float32)
    distance = np.empty((width, height), dtype=np.int32)
    queue = np.empty(width * height, dtype=np.int64)
    everybody = np.ones(count, dtype=np.bool_)
    tasks = np.full((count, 2), -1, dtype=np.int64)
    way = np.zeros(count)
    remember = REMEMBER if teacher == FORESIGHT else 0
    for step in range(packed.shape[0]):
        for n in range(count):
            field_of_view(obstacles, kinds[n] == 1, cells[n, 0], cells[n, 1], r_sense, seen, rows)
            observe(own[n], obstacles, here, seen, cells[n, 0], cells[n, 1])
            left[cells[n, 0], cells[n, 1]] = False
        hop_counts(cells, r_comm, hop_limit, hops)
        _hear(hops, loss, cells, tasks, step, ears, heard, last)
        share(own, ears, beliefs)
        own[:] = beliefs
        for n in range(count):
            pack(beliefs[n], packed[step, n])
            _reckon(n, cells, speeds, ears, r_comm, remember, step, heard, last, known[step, n])
        if teacher == GREEDY:
            union[:] = 0
            for n in range(count):
                union[:] = np.maximum(union, beliefs[n])
            assign(union, kinds, speeds, cells, everybody, goals)
            for n in range(count):
                _labels_of_goals(beliefs[n], known[step, n], goals, votes[step, n], plans[step, n], n)
        else:
            for n in range(count):
                twin = -1
                for m in range(n):
                    if twin < 0 and _same(known[step, n], known[step, m]) and _same(beliefs[n], beliefs[m]):
                        twin = m
                if twin < 0:
                    twin = n
                    _plan_for(
                        teacher, beliefs[n], known[step, n], kinds, speeds, team_goals[n], team_votes[n], plans[step, n]
                    )
                else:
                    team_goals[n], team_votes[n], plans[step, n] = team_goals[twin], team_votes[twin], plans[step, twin]
                goals[n] = team_goals[twin, n]
                votes[step, n] = team_votes[twin, n]
        for n in range(count):
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
        if teacher != GREEDY:
            for n in range(count):
                _keep_tasks(n, beliefs[n], cells, kinds, ears, tasks, goals)
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


@compiled
def _labels_of_goals(belief: Array, known: Array, goals: Array, votes: Array, plans: Array, n: int) -> None:
    """The central expert's goals as labels of one robot's view.

    "No target" is a label only where ego knows fewer targets than robots: else the expert knew of robots and targets
    that ego cannot know of, and a team that learns to wait for them waits in vain.
    """
    cells = np.empty((MAX_CANDIDATES, 2), dtype=np.int64)
    count = list_targets(belief, cells)
    reckoned = (known[:, 2] != NOBODY).sum()
    plans[:] = NO_PLAN
    for m in range(len(goals)):
        if known[m, 2] == NOBODY:
            continue
        if goals[m, 0] < 0 and count < reckoned:
            plans[m] = NO_LABEL
        for k in range(count):
            if cells[k, 0] == goals[m, 0] and cells[k, 1] == goals[m, 1]:
                plans[m] = k
    votes[:] = NO_LABEL
    votes[:, 2] = 0
    votes[0, 2] = 255 if plans[n] != NO_PLAN else 0
    if goals[n, 0] >= 0:
        votes[0, 0], votes[0, 1] = goals[n, 0], goals[n, 1]
