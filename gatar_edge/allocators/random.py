"""The lower bound of all rules: any target that can be reached, by lot."""

from __future__ import annotations

import hashlib

import numpy as np

from gatar_edge.allocators.base import NO_TARGET, Allocation, scores_of
from gatar_edge.types import Cell
from gatar_edge.view import View, travel_times


class Random:
    """Each robot takes, of the targets it can reach, the one whose lot is the lowest.

    A lot hangs on robot and cell alone: a replay draws the same, and a robot does not change its mind at every step.
    """

    name = "random"

    def allocate(self, view: View) -> Allocation:
        """See `allocators.base.Allocator`."""
        times = travel_times(view)
        cells = [(int(x), int(y)) for x, y in view.targets]
        choices = np.full(len(view.robots), NO_TARGET, dtype=np.int32)
        for row, robot in enumerate(view.robots):
            reachable = np.flatnonzero(np.isfinite(times[row])).tolist()
            lots = [_lot(robot.robot_id, cell) for cell in cells]
            choices[row] = min(reachable, key=lots.__getitem__, default=NO_TARGET)
        return Allocation(choices, scores_of(times))


def _lot(robot_id: int, cell: Cell) -> bytes:
    return hashlib.blake2b(f"{robot_id} {cell}".encode(), digest_size=8).digest()
