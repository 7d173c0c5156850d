"""Greedy without communication, the paper's simplest rival: everybody goes to its own nearest target."""

from __future__ import annotations

import numpy as np

from gatar_edge.allocators.base import NO_TARGET, Allocation, scores_of
from gatar_edge.view import View, travel_times


class Nearest:
    """Each robot's nearest known target, whatever the others do; ties by cell."""

    name = "nearest"

    def allocate(self, view: View) -> Allocation:
        """See `allocators.base.Allocator`."""
        times = travel_times(view)
        choices = np.full(len(view.robots), NO_TARGET, dtype=np.int32)
        if times.shape[1]:
            nearest = times.argmin(axis=1).astype(np.int32)
            reachable = np.isfinite(times.min(axis=1))
            choices[reachable] = nearest[reachable]
        return Allocation(choices, scores_of(times))
