"""The lower bound of all rules: any target that can be reached, by lot."""

from __future__ import annotations

import hashlib

import numpy as np

from gatar_edge.allocators.base import NO_TARGET, Allocation, in_id_order, scores_of
from gatar_edge.view import View, travel_times


class Random:
    """Each robot draws one of the targets it can reach. The lot hangs on time and id alone: a replay draws the same."""

    name = "random"

    def allocate(self, view: View) -> Allocation:
        """See `allocators.base.Allocator`."""
        times = travel_times(view)
        choices = np.full(len(view.robots), NO_TARGET, dtype=np.int32)
        for row in in_id_order(view):
            reachable = np.flatnonzero(np.isfinite(times[row]))
            if len(reachable):
                choices[row] = reachable[_lot(view.now_ns, view.robots[row].robot_id) % len(reachable)]
        return Allocation(choices, scores_of(times))


def _lot(now_ns: int, robot_id: int) -> int:
    return int.from_bytes(hashlib.blake2b(f"{now_ns} {robot_id}".encode(), digest_size=8).digest(), "big")
