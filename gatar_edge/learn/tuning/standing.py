"""How a mission stands, to one who sees everything: what the critic estimates the steps from that it still takes."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from gatar_edge.learn.jit import compiled
from gatar_edge.learn.kernels import UNKNOWN, path_lengths
from gatar_edge.learn.plans import first_times
from gatar_edge.learn.teachers import legs_between, tours_of

Array = npt.NDArray[Any]

STANDING = 12  # numbers
SHORT = 5.0  # steps: the last ones of a mission count apart
ROUNDS = 30  # of the search for tours


@compiled
def stand(
    truth: Array, left: Array, beliefs: Array, kinds: Array, speeds: Array, cells: Array, r_comm: float, loss: float,
    out: Array,
) -> None:  # fmt: skip
    """Fill `out` [STANDING]: the steps of tours by one who knows all, what is left, and what nobody has seen yet.

    `truth` uint8 [W, H] knows every cell, `left` bool [W, H] are the targets to be had, `beliefs` [N, W, H].
    """
    robots = len(kinds)
    targets, hidden, dark = 0, 0, 0
    for i in range(left.shape[0]):
        for j in range(left.shape[1]):
            unseen = (beliefs[:, i, j] == UNKNOWN).all()
            dark += unseen
            targets += left[i, j]
            hidden += unseen and left[i, j]
    latest, mean = _tours(truth, left, kinds, speeds, cells)
    out[0] = 1.0
    out[1], out[2], out[3] = latest, min(latest, SHORT), mean
    out[4], out[5], out[6] = targets / robots, hidden / robots, dark / robots
    out[7], out[8], out[9] = np.sqrt(hidden), np.sqrt(dark), 1.0 if hidden else 0.0
    out[10], out[11] = latest / (1 + r_comm), latest * loss


@compiled
def _tours(truth: Array, left: Array, kinds: Array, speeds: Array, cells: Array) -> tuple[float, float]:
    """When the last robot, and the robots on average, come to the ends of tours over the targets `left`, in steps."""
    targets = np.argwhere(left)
    if len(targets) == 0:
        return 0.0, 0.0
    distances = np.empty((len(kinds), *left.shape), dtype=np.int32)
    queue = np.empty(left.size, dtype=np.int64)
    for n in range(len(kinds)):
        path_lengths(truth, kinds[n] == 1, cells[n, 0], cells[n, 1], distances[n], queue)
    legs = np.empty((2, len(targets), len(targets)))
    legs_between(truth, targets, legs)
    _, plan = tours_of(first_times(distances, speeds, targets, len(targets)), legs, kinds, 1 / speeds, ROUNDS)
    return plan.ends.max(), plan.ends.mean()
