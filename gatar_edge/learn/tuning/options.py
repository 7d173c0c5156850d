"""What ego may choose from when the network decides by chance, in each view of a batch, and where that leads it.

On the robot, one assignment over the graph is decoded, and `tasks.decide` gives way to who is nearer. Here ego draws
from its own scores instead, among what those two would leave it: no target that the decoded assignment gives to others,
none that another robot claims and is nearer to. The likeliest draw is what the robot would do, but in rare cases.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from gatar_edge.allocators.base import NO_TARGET
from gatar_edge.allocators.gatar import HABIT, decode
from gatar_edge.explore import FRONTIER_BLOCK
from gatar_edge.features import ViewArrays
from gatar_edge.grid import UNREACHABLE
from gatar_edge.learn.memory import FRESH
from gatar_edge.learn.views import Batch
from gatar_edge.types import CellState

Array = npt.NDArray[Any]


@dataclass(frozen=True, slots=True)
class Options:
    """Of B views with M candidates."""

    allowed: Array  # bool [B, M]; a row without any: nobody asks the network
    habit: Array  # float32 [B, M], added to a score's logarithm where ego is on its way there


def options_of(batch: Batch, scores: Array) -> Options:
    """From the network's probabilities [B, N, M + 1]."""
    view = batch.view
    valid: Array = batch.inputs["valid"]
    possible = valid > 0
    target = view.listed & (view.dark == 0)
    held = _held(view, target)
    claimed, nearer = _claims(view, target, possible)
    left = possible[:, 0] & ~_given_to_others(view, scores, possible, held, target)
    uncontested = left & ~nearer
    allowed = np.where(nearer.any(axis=1, keepdims=True), uncontested, left)
    stuck = ~allowed.any(axis=1) & ~_can_explore(view)
    allowed[stuck] = _nearest(view, possible[:, 0] & target & ~claimed)[stuck]
    return Options(allowed, (HABIT * held[:, 0]).astype(np.float32))


def goals_of(view: ViewArrays, choices: Array) -> Array:
    """The cell that each ego sets out for: int64 [B, 2], (-1, -1) for none; as `explore.settled` and the agent do."""
    rows, some = np.arange(len(choices)), choices != NO_TARGET
    column = np.maximum(choices, 0)
    goals = np.where(some[:, None], view.targets[rows, column], -1)
    heading = view.tasks[:, 0]
    x, y = np.maximum(heading, 0).T
    settled = some & (view.dark[rows, column] > 0) & (heading[:, 0] >= 0)
    settled &= (heading // FRONTIER_BLOCK == goals // FRONTIER_BLOCK).all(axis=1)
    settled &= (view.belief[rows, x, y] == CellState.UNKNOWN) & (view.distances[rows, 0, x, y] != UNREACHABLE)
    goals[settled] = heading[settled]
    return goals


def _held(view: ViewArrays, target: Array) -> Array:
    """Which candidates the robots are on their way to: bool [B, N, M], as `allocators.gatar.in_hand`."""
    tasks, cells = view.tasks[:, :, None], view.targets[:, None]
    block = (tasks // FRONTIER_BLOCK == cells // FRONTIER_BLOCK).all(axis=-1)
    same = np.where(target[:, None], (tasks == cells).all(axis=-1), block)
    held: Array = same & (tasks[..., 0] >= 0) & view.listed[:, None] & view.present[..., None]
    return held


def _claims(view: ViewArrays, target: Array, possible: Array) -> tuple[Array, Array]:
    """Targets that robots in earshot are on their way to, and those to which one of them is nearer: bool [B, M]."""
    rows = np.arange(len(target))[:, None, None]
    robots = np.arange(view.ids.shape[1])[:, None]
    lengths = view.distances[rows, robots, view.targets[:, None, :, 0], view.targets[:, None, :, 1]]
    times = np.where(possible, lengths / np.maximum(view.speeds[..., None], 1e-6), np.inf)
    others = view.present & (view.ages_s <= FRESH)
    others[:, 0] = False
    claims = (view.tasks[:, :, None] == view.targets[:, None]).all(axis=-1) & target[:, None] & others[..., None]
    first = (times < times[:, :1]) | ((times == times[:, :1]) & (view.ids < view.ids[:, :1])[..., None])
    return claims.any(axis=1), (claims & first).any(axis=1)


def _given_to_others(view: ViewArrays, scores: Array, possible: Array, held: Array, target: Array) -> Array:
    """Targets that the decoded assignment gives to others than ego: bool [B, M]."""
    taken = np.zeros(target.shape, dtype=np.bool_)
    for b in range(len(taken)):
        rows, listed = np.flatnonzero(view.present[b]), np.flatnonzero(view.listed[b])
        cut = np.ix_(rows, listed)
        order = np.argsort(view.ids[b, rows], kind="stable")
        choices = decode(scores[b][np.ix_(rows, np.append(listed, -1))], possible[b][cut], order, held[b][cut])[1:]
        taken[b, listed[choices[choices != NO_TARGET]]] = True
    return taken & target


def _can_explore(view: ViewArrays) -> Array:
    """Whether ego can reach anything unknown: bool [B]."""
    dark = (view.belief == CellState.UNKNOWN) & (view.distances[:, 0] != UNREACHABLE)
    can: Array = dark.any(axis=(1, 2))
    return can


def _nearest(view: ViewArrays, among: Array) -> Array:
    """Only ego's nearest one of those marked: bool [B, M]; as `tasks.abandoned`."""
    lengths = view.distances[np.arange(len(among))[:, None], 0, view.targets[..., 0], view.targets[..., 1]]
    lengths = np.where(among, lengths, np.iinfo(np.int32).max)
    nearest: Array = among & (np.arange(among.shape[1]) == lengths.argmin(axis=1)[:, None])
    return nearest
