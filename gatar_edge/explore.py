"""Where to go and look when there is no target for a robot: the nearest unknown cell that no other robot goes to."""

from __future__ import annotations

import numpy as np

from gatar_edge.allocators.base import NO_TARGET, Choices, in_id_order
from gatar_edge.belief import unknown
from gatar_edge.grid import UNREACHABLE
from gatar_edge.types import Cell
from gatar_edge.view import View


def frontier_for_ego(view: View, choices: Choices, r_sense: float) -> Cell | None:
    """The unknown cell that ego should go to, or None where nothing unknown can be reached.

    All robots of the view without a target get one in turn, shortest way first (ties by id, then cell); a robot's cell
    takes those within `r_sense` of it out of the pool for the robots after it, for it will see them. Where nothing is
    left in the pool, the nearest unknown cell serves, whoever else goes there.
    """
    dark = unknown(view.belief)
    if not dark.any():
        return None
    idle = [int(row) for row in in_id_order(view) if choices[row] == NO_TARGET]
    pool = dark.copy()
    while idle and pool.any():
        cells = np.argwhere(pool)
        ways = view.distances[np.ix_(idle, range(view.belief.shape[0]), range(view.belief.shape[1]))][:, pool]
        ways = np.where(ways == UNREACHABLE, np.iinfo(np.int32).max, ways)
        turn, nearest = divmod(int(ways.argmin()), len(cells))
        if ways[turn, nearest] == np.iinfo(np.int32).max:
            break
        cell = (int(cells[nearest][0]), int(cells[nearest][1]))
        if idle.pop(turn) == 0:
            return cell
        gap = cells - cells[nearest]
        covered = cells[(gap**2).sum(axis=1) <= r_sense * r_sense]
        pool[covered[:, 0], covered[:, 1]] = False
    return _nearest(view, dark)


def _nearest(view: View, dark: np.ndarray) -> Cell | None:
    cells = np.argwhere(dark)
    ways = view.distances[0][dark]
    ways = np.where(ways == UNREACHABLE, np.iinfo(np.int32).max, ways)
    nearest = int(ways.argmin())
    if ways[nearest] == np.iinfo(np.int32).max:
        return None
    return int(cells[nearest][0]), int(cells[nearest][1])
