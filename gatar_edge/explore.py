"""Where to go and look: the frontiers among which a learned allocator may choose, and the rule for all the others.

The rule: the nearest unknown cell that no other robot goes to.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from gatar_edge.allocators.base import NO_TARGET, Choices, in_id_order
from gatar_edge.belief import unknown
from gatar_edge.grid import UNREACHABLE
from gatar_edge.types import ByteGrid, Cell, CellState, IntGrid
from gatar_edge.view import View

FRONTIER_BLOCK = 4  # cells a side: a robot that enters a block sees all of it
MOST_FRONTIERS = 24  # of a view: those nearest to any of its robots
_NO_WAY = np.iinfo(np.int32).max
_FARTHEST = 2 * FRONTIER_BLOCK**6  # more than any square of a distance within a block times the number of its cells


def frontiers(
    belief: ByteGrid, distances: IntGrid, most: int = MOST_FRONTIERS
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Places to go and look: cells [K, 2], sorted by x, then y, and how many unknown cells lie round each [K].

    The grid is cut into blocks that never move, so that places stay while they are unknown. A block's place is its
    unknown cell nearest to the middle of its unknown cells. Of more than `most`, those count that the robots of
    `distances` [N, W, H] reach soonest (then by block).
    """
    width, height = belief.shape
    x, y = np.nonzero(belief == 0)
    if not len(x):
        return np.zeros((0, 2), dtype=np.int64), np.zeros(0, dtype=np.int64)
    across = -(-height // FRONTIER_BLOCK)
    block = x // FRONTIER_BLOCK * across + y // FRONTIER_BLOCK
    blocks = -(-width // FRONTIER_BLOCK) * across
    count = np.bincount(block, minlength=blocks)
    # in whole numbers, so that all processors agree: the distance to the middle times the number of cells
    gap = (x * count[block] - np.bincount(block, x, blocks).astype(np.int64)[block]) ** 2
    gap += (y * count[block] - np.bincount(block, y, blocks).astype(np.int64)[block]) ** 2
    order = np.argsort(block * _FARTHEST + gap, kind="stable")
    first = order[(np.cumsum(count) - count)[count > 0]]
    cells = np.stack([x[first], y[first]], axis=1)
    ways = distances[:, cells[:, 0], cells[:, 1]]
    soonest = np.where(ways == UNREACHABLE, _NO_WAY, ways).min(axis=0)
    reached = np.flatnonzero(soonest < _NO_WAY)
    kept = reached[np.argsort(soonest[reached], kind="stable")[:most]]
    kept = kept[np.argsort(first[kept])]  # `x` and `y` are in order
    return cells[kept], count[block[first[kept]]]


def settled(view: View, frontier: Cell, heading: Cell) -> Cell:
    """Where ego goes to look at `frontier`'s block: on to `heading` while that is in the block, unknown and reachable.

    A block's place moves with each of its cells that is seen: who follows it steps aside and back.
    """
    same = all(a // FRONTIER_BLOCK == b // FRONTIER_BLOCK for a, b in zip(frontier, heading, strict=True))
    good = same and view.belief[heading] == CellState.UNKNOWN and view.distances[0][heading] != UNREACHABLE
    return heading if good else frontier


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
        ways = view.distances[idle][:, pool]
        ways = np.where(ways == UNREACHABLE, _NO_WAY, ways)
        turn, nearest = divmod(int(ways.argmin()), len(cells))
        if ways[turn, nearest] == _NO_WAY:
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
    ways = np.where(ways == UNREACHABLE, _NO_WAY, ways)
    nearest = int(ways.argmin())
    if ways[nearest] == _NO_WAY:
        return None
    return int(cells[nearest][0]), int(cells[nearest][1])
