"""What the teachers' plans leave in a data set: labels of the robots of each view, and ego's first choices."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from gatar_edge.features import MAX_CANDIDATES
from gatar_edge.learn.jit import compiled
from gatar_edge.learn.kernels import TARGET, list_targets, path_lengths
from gatar_edge.learn.memory import NOBODY
from gatar_edge.learn.moves import assign
from gatar_edge.learn.plans import FORESIGHT, list_candidates, plan

Array = npt.NDArray[Any]

VOTES = 2  # candidates stored with their shares
NO_PLAN = 254  # candidate that is not known
NO_LABEL = 255  # in place of a cell's coordinate: the expert gives this robot nothing
KNOWABLE = 1  # flag: the label's target is in the robot's own belief


@compiled
def label_by_expert(
    beliefs: Array, known: Array, kinds: Array, speeds: Array, cells: Array, goals: Array, votes: Array, plans: Array
) -> None:
    """Labels of one step by the central greedy expert, on the union of all beliefs; its `goals` [N, 2]."""
    count = len(kinds)
    union = np.zeros(beliefs.shape[1:], dtype=np.uint8)
    for n in range(count):
        union[:] = np.maximum(union, beliefs[n])
    assign(union, kinds, speeds, cells, np.ones(count, dtype=np.bool_), goals)
    for n in range(count):
        _labels_of_goals(beliefs[n], known[n], goals, votes[n], plans[n], n)


@compiled
def label_by_plans(
    teacher: int, beliefs: Array, known: Array, kinds: Array, speeds: Array, goals: Array, votes: Array, plans: Array
) -> None:
    """Labels of one step by a teacher that plans on each robot's own view; robots of one view share one plan."""
    count = len(kinds)
    team_goals = np.empty((count, count, 2), dtype=np.int64)  # by whose plan
    team_votes = np.empty((count, count, VOTES, 3), dtype=np.uint8)
    for n in range(count):
        twin = -1
        for m in range(n):
            if twin < 0 and _same(known[n], known[m]) and _same(beliefs[n], beliefs[m]):
                twin = m
        if twin < 0:
            twin = n
            _plan_for(teacher, beliefs[n], known[n], kinds, speeds, team_goals[n], team_votes[n], plans[n])
        else:
            team_goals[n], team_votes[n], plans[n] = team_goals[twin], team_votes[twin], plans[twin]
        goals[n] = team_goals[twin, n]
        votes[n] = team_votes[twin, n]


@compiled
def record(beliefs: Array, cells: Array, tasks: Array, speeds: Array, goals: Array, robots: Array) -> None:
    """One step's rows of `robots.npy` (see `gatar_edge.learn.dataset`)."""
    for n in range(len(cells)):
        robots[n, 0], robots[n, 1] = cells[n, 0], cells[n, 1]
        robots[n, 2:4] = NO_LABEL
        robots[n, 4] = 0
        robots[n, 5], robots[n, 6] = tasks[n, 0] & 255, tasks[n, 1] & 255
        robots[n, 7] = int(speeds[n] * 16)
        if goals[n, 0] >= 0:
            robots[n, 2], robots[n, 3] = goals[n, 0], goals[n, 1]
            if beliefs[n, goals[n, 0], goals[n, 1]] == TARGET:
                robots[n, 4] = KNOWABLE


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
    plan(teacher, belief, distances, kinds[rows], speeds[rows], cells, targets, count, shares, choices)
    goals[:] = -1
    plans[:] = NO_PLAN
    for row in range(len(rows)):
        plans[rows[row]] = choices[row] if choices[row] >= 0 else NO_LABEL
        if choices[row] >= 0:
            goals[rows[row]] = cells[choices[row]]
        _most_voted(shares[row], cells, votes[rows[row]])


@compiled
def _most_voted(shares: Array, cells: Array, votes: Array) -> None:
    """Candidates with the largest shares into `votes` uint8 [VOTES, 3]: cell (`NO_LABEL`: none) and share of 255."""
    left = shares.copy()
    for place in range(len(votes)):
        best = int(left.argmax())
        votes[place] = NO_LABEL
        votes[place, 2] = int(left[best] * 255)
        if best < len(cells) and best < len(left) - 1:
            votes[place, 0], votes[place, 1] = cells[best, 0], cells[best, 1]
        left[best] = 0


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
