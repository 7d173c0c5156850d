"""What a mission will still take, estimated by a line through what missions took; and what each step was worth."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from gatar_edge.learn.ranks import ALONE, Ranks
from gatar_edge.learn.tuning.standing import STANDING

Array = npt.NDArray[Any]

FORGET = 0.7  # what earlier missions weigh, from one fit to the next
RIDGE = 1.0
LAMBDA = 0.95  # of generalised advantage estimation: how far ahead outcomes are believed rather than the estimate


class Critic:
    """Least squares over standings, one line for each kind of mission. All its state is `sums`."""

    def __init__(self, sums: dict[str, Array] | None = None) -> None:
        self.sums = dict(sums or {})

    def estimate(self, kind: str, standing: Array, took: Array, ranks: Ranks = ALONE) -> Array:
        """Steps still to come by earlier missions of this kind, or by these where there are none; then learn of these.

        `standing` [S, STANDING] and the steps `took` [S] from there to the end; all `ranks` learn of all ranks' rows.
        """
        rows = np.column_stack([standing, took])
        sums = ranks.sum(rows.T @ rows)
        line = _line(self.sums.get(kind, sums))
        self.sums[kind] = self.sums.get(kind, 0) * FORGET + sums
        estimates: Array = standing @ line
        return estimates


def _line(sums: Array) -> Array:
    line: Array = np.linalg.solve(sums[:STANDING, :STANDING] + RIDGE * np.eye(STANDING), sums[:STANDING, STANDING])
    return line


def advantages(estimates: Array, alive: Array, cut: Array) -> Array:
    """How many steps each step of each mission saved, against what was expected: [T, B].

    `estimates` [T, B] of the steps still to come, `alive` [T, B] whether the mission was under way; of those that were
    `cut` [B], as much was left at the end as at the last step. Generalised advantage estimation (Schulman et al. 2016)
    with a cost of 1 a step and no discount.
    """
    steps, count = alive.shape
    lost = np.zeros((steps + 1, count))
    after = np.where(cut, np.where(alive[-1], estimates[-1], 0.0), 0.0)
    for t in range(steps - 1, -1, -1):
        surprise = 1 + after - estimates[t]
        lost[t] = np.where(alive[t], surprise + LAMBDA * lost[t + 1], 0.0)
        after = np.where(alive[t], estimates[t], after)
    return -lost[:steps]
