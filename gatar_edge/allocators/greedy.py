"""The paper's expert: over all pairs of robot and known target, the shortest way first; remove both; repeat."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from gatar_edge.allocators.base import NO_TARGET, Allocation, Choices, in_id_order, scores_of
from gatar_edge.view import View, travel_times


def greedy_pairs(times: npt.NDArray[np.float64]) -> Choices:
    """Shortest time first over `times` [N, M] (inf: impossible); ties by row, then column: int32 [N]."""
    robots, targets = times.shape
    choices = [NO_TARGET] * robots
    taken = [False] * targets
    flat = times.ravel().tolist()
    left = min(robots, targets)
    for pair in times.argsort(axis=None, kind="stable").tolist():
        if not flat[pair] < math.inf:
            break
        robot, target = divmod(pair, targets)
        if choices[robot] == NO_TARGET and not taken[target]:
            choices[robot] = target
            taken[target] = True
            left -= 1
            if left == 0:
                break
    return np.array(choices, dtype=np.int32)


class Greedy:
    """Each robot replays the centralized greedy expert on its own view; unreachable pairs are left out."""

    name = "greedy"

    def allocate(self, view: View) -> Allocation:
        """See `allocators.base.Allocator`."""
        times = travel_times(view)
        order = in_id_order(view)
        choices = np.full(len(view.robots), NO_TARGET, dtype=np.int32)
        if times.shape[1]:
            choices[order] = greedy_pairs(times[order])
        return Allocation(choices, scores_of(times))
