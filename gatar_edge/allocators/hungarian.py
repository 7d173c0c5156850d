"""The assignment with the least sum of travel times: optimal for this moment, blind to what comes after."""

from __future__ import annotations

import lap
import numpy as np
import numpy.typing as npt

from gatar_edge.allocators.base import NO_TARGET, Allocation, Choices, in_id_order, scores_of
from gatar_edge.view import View, travel_times

TIE_WEIGHT = 1e-6  # share of the largest time by which ties may bend the costs


def least_sum_pairs(times: npt.NDArray[np.float64]) -> Choices:
    """As many pairs of `times` [N, M] (inf: impossible) as can be, with the least sum of times: int32 [N].

    Of solutions with the same sum the one with low rows on low columns is taken, so that every robot takes the same.
    """
    robots, targets = times.shape
    choices = np.full(robots, NO_TARGET, dtype=np.int32)
    possible = np.isfinite(times)
    if not possible.any():
        return choices
    largest = float(times[possible].max()) + 1.0
    # dearer than any solution that does without: an impossible pair is only taken where nothing else is left
    cost = np.where(possible, times, largest * (min(robots, targets) + 1))
    rank = np.outer(np.arange(robots, 0, -1), np.arange(1, targets + 1))
    cost += rank * (TIE_WEIGHT / rank.sum())
    _, columns, _ = lap.lapjv(cost, extend_cost=True)
    rows = np.flatnonzero(columns >= 0)
    rows = rows[possible[rows, columns[rows]]]
    choices[rows] = columns[rows]
    return choices


class Hungarian:
    """Each robot solves the same linear assignment on its own view, at every decision."""

    name = "hungarian"

    def allocate(self, view: View) -> Allocation:
        """See `allocators.base.Allocator`."""
        times = travel_times(view)
        order = in_id_order(view)
        choices = np.full(len(view.robots), NO_TARGET, dtype=np.int32)
        if times.shape[1]:
            choices[order] = least_sum_pairs(times[order])
        return Allocation(choices, scores_of(times))
