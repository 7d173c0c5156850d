"""What each teacher would have one robot's team do: a plan over the candidates of that robot's view, compiled.

A view is the robots that ego reckons with (rows, sorted by id), what ego knows, and the candidates: known targets in
order of cells, and behind them, for the teacher that looks further, frontiers.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from gatar_edge.explore import FRONTIER_BLOCK, MOST_FRONTIERS
from gatar_edge.features import MAX_CANDIDATES, PRIOR_CELLS, PRIOR_TARGETS
from gatar_edge.learn.jit import compiled
from gatar_edge.learn.kernels import (
    FREE,
    LOCALIZED,
    TARGET,
    UNKNOWN,
    greedy,
    list_frontiers,
    list_targets,
)
from gatar_edge.learn.teachers import legs_between, routing

Array = npt.NDArray[Any]

GREEDY, ROUTING, FORESIGHT = 0, 1, 2
TEACHERS = {"greedy": GREEDY, "routing": ROUTING, "foresight": FORESIGHT}  # as in `dataset.TEACHERS`
SAMPLES = 8  # completions of the unknown that foresight plans for
ROUNDS = 100  # of the search for tours
NONE = -1


@compiled
def list_candidates(belief: Array, distances: Array, frontier: bool, cells: Array, dark: Array) -> tuple[int, int]:
    """Candidates into `cells` [MAX_CANDIDATES, 2] and their unknown cells into `dark`; how many targets, how many all.

    `distances` [N, W, H] are those of the robots that count for "nearest".
    """
    targets = list_targets(belief, cells)
    dark[:targets] = 0
    room = min(MOST_FRONTIERS, MAX_CANDIDATES - targets)
    if not frontier or room <= 0:
        return targets, targets
    return targets, targets + list_frontiers(belief, distances, room, cells[targets:], dark[targets:])


@compiled
def first_times(distances: Array, speeds: Array, cells: Array, count: int) -> Array:
    """Seconds from each robot to each of the first `count` cells: float64 [N, count], inf where there is no way."""
    times = np.empty((len(speeds), count))
    for n in range(len(speeds)):
        for m in range(count):
            steps = distances[n, cells[m, 0], cells[m, 1]]
            times[n, m] = steps / speeds[n] if steps >= 0 else np.inf
    return times


@compiled
def plan(
    teacher: int, belief: Array, distances: Array, kinds: Array, speeds: Array, cells: Array, targets: int,
    count: int, votes: Array, choices: Array,
) -> None:  # fmt: skip
    """Shares of each candidate for each robot into `votes` [N, count + 1] (last: none); one plan into `choices` [N].

    `targets` of the `count` candidates `cells` are targets, the rest frontiers.
    """
    votes[:] = 0
    if teacher == FORESIGHT:
        _foresee(belief, distances, kinds, speeds, cells, targets, count, votes)
        _agree(votes, distances, cells, targets, count, choices)
        return
    choices[:] = NONE
    if targets:
        times = first_times(distances, speeds, cells, targets)
        if teacher == GREEDY:
            greedy(times, choices)
        else:
            legs = np.empty((2, targets, targets))
            legs_between(belief, cells[:targets], legs)
            routing(times, legs, kinds, 1 / speeds, ROUNDS, choices)
    for n in range(len(kinds)):
        votes[n, choices[n] if choices[n] >= 0 else count] = 1


@compiled
def hidden_density(belief: Array) -> float:
    """Targets that an unknown cell is expected to hold, by what was seen: as the feature `hidden` counts them."""
    found, seen = 0, 0
    for i in range(belief.shape[0]):
        for j in range(belief.shape[1]):
            found += belief[i, j] == TARGET or belief[i, j] == LOCALIZED
            seen += belief[i, j] == TARGET or belief[i, j] == LOCALIZED or belief[i, j] == FREE
    return float((found + PRIOR_TARGETS) / (seen + PRIOR_CELLS))


@compiled
def _foresee(
    belief: Array, distances: Array, kinds: Array, speeds: Array, cells: Array, targets: int, count: int, votes: Array
) -> None:
    """Tours over the known targets and those that the unknown may hide, for `SAMPLES` draws of the hidden ones."""
    width, height = belief.shape
    density = hidden_density(belief)
    across = (height + FRONTIER_BLOCK - 1) // FRONTIER_BLOCK
    owner = np.full((width + FRONTIER_BLOCK) * (height + FRONTIER_BLOCK), -1, dtype=np.int64)  # by block
    for m in range(targets, count):
        owner[cells[m, 0] // FRONTIER_BLOCK * across + cells[m, 1] // FRONTIER_BLOCK] = m
    stops = np.empty((2 * MAX_CANDIDATES, 2), dtype=np.int64)
    origin = np.empty(2 * MAX_CANDIDATES, dtype=np.int64)  # candidate of each stop
    stops[:targets] = cells[:targets]
    for m in range(targets):
        origin[m] = m
    choices = np.empty(len(kinds), dtype=np.int64)
    for _ in range(SAMPLES):
        many = targets
        for i in range(width):
            for j in range(height):
                if belief[i, j] == UNKNOWN and many < len(stops):
                    m = owner[i // FRONTIER_BLOCK * across + j // FRONTIER_BLOCK]
                    if m >= 0 and np.random.random() < density:
                        stops[many, 0], stops[many, 1] = i, j
                        origin[many] = m
                        many += 1
        if many:
            times = first_times(distances, speeds, stops, many)
            legs = np.empty((2, many, many))
            legs_between(belief, stops[:many], legs)
            routing(times, legs, kinds, 1 / speeds, ROUNDS, choices)
        else:
            choices[:] = NONE
        for n in range(len(kinds)):
            votes[n, origin[choices[n]] if choices[n] >= 0 else count] += 1 / SAMPLES


@compiled
def _agree(votes: Array, distances: Array, cells: Array, targets: int, count: int, choices: Array) -> None:
    """One plan from the votes: most votes first (ties: the shorter way), a target for one robot only."""
    choices[:] = NONE
    taken = np.zeros(count, dtype=np.bool_)
    for _ in range(len(choices)):
        best, row, column = 0.0, -1, -1
        for n in range(len(choices)):
            for m in range(count):
                steps = distances[n, cells[m, 0], cells[m, 1]]
                if choices[n] == NONE and not taken[m] and votes[n, m] > 0 and steps >= 0:
                    value = votes[n, m] + 1e-3 / (1 + steps)
                    if value > best:
                        best, row, column = value, n, m
        if row < 0:
            return
        choices[row] = column
        taken[column] = column < targets
