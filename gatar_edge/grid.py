"""Geometry on the grid: what can be seen from a cell, how long the way is, and the way itself.

All motion is 4-connected. A robot plans with what it knows: unknown cells count as free until they are seen.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import lru_cache, partial

import numpy as np

from gatar_edge.types import BoolGrid, ByteGrid, Cell, Cells, CellState, IntGrid, RobotKind

UNREACHABLE = -1
CACHE_BYTES = 32 << 20  # of lengths that are remembered, for flying and for driving each
MOST_CACHED = 1024  # of small grids
_OBSTACLE = np.uint8(CellState.OBSTACLE)


def as_cells(mask: BoolGrid) -> Cells:
    """Cells where `mask` [W, H] is true, int16 [n, 2], sorted by x, then y: the order by which ties are broken."""
    return np.argwhere(mask).astype(np.int16)


def passable(kind: RobotKind, belief: ByteGrid) -> BoolGrid:
    """Where a robot may go, as far as is known: bool [W, H]. Obstacles stop only ground robots."""
    if kind is RobotKind.UAV:
        return np.ones(belief.shape, dtype=np.bool_)
    free: BoolGrid = belief != _OBSTACLE
    return free


def path_lengths(kind: RobotKind, cell: Cell, free: BoolGrid) -> IntGrid:
    """Steps from `cell` to every cell: int32 [W, H], read-only, `UNREACHABLE` (-1) where there is no way."""
    if kind is RobotKind.UAV:
        return manhattan(cell, free.shape)
    return _driving(free.shape)(cell, free.tobytes())


def lengths_from(places: Iterable[tuple[RobotKind, Cell]], free: BoolGrid) -> list[IntGrid]:
    """`path_lengths` of several robots that know the same."""
    flying, driving, known = _flying(free.shape), _driving(free.shape), free.tobytes()
    return [flying(cell) if kind is RobotKind.UAV else driving(cell, known) for kind, cell in places]


def manhattan(cell: Cell, shape: tuple[int, ...]) -> IntGrid:
    """4-connected distance with nothing in the way: int32 [W, H], read-only."""
    return _flying(shape)(cell)


# What is known changes less often than it is asked about, and robots that know the same ask the same. A robot has one
# grid: another size begins a new memory, so that together they never hold more than `CACHE_BYTES`.
@lru_cache(maxsize=1)
def _driving(shape: tuple[int, ...]) -> Callable[[Cell, bytes], IntGrid]:
    return lru_cache(_cached(shape, cell_bytes=5))(partial(_driving_lengths, shape=shape))  # with the map, in the key


@lru_cache(maxsize=1)
def _flying(shape: tuple[int, ...]) -> Callable[[Cell], IntGrid]:
    return lru_cache(_cached(shape, cell_bytes=4))(partial(_flying_lengths, shape=shape))


def _cached(shape: tuple[int, ...], cell_bytes: int) -> int:
    """How many maps of this size to remember."""
    return min(MOST_CACHED, CACHE_BYTES // (cell_bytes * shape[0] * shape[1]))


def _driving_lengths(cell: Cell, free: bytes, shape: tuple[int, ...]) -> IntGrid:
    """Breadth first, one distance at a time, a set of cells being the bits of one number.

    Not tcod's dijkstra2d: version 21.2 leaks 4 KB a call, and is no faster on maps of up to 200 x 200 cells.
    """
    column = shape[1] + 1  # with a closed cell behind its last one, so that no step leads into the next column
    padded = np.zeros((shape[0], column), dtype=np.bool_)
    padded[:, :-1] = np.frombuffer(free, dtype=np.bool_).reshape(shape)
    ahead = int.from_bytes(np.packbits(padded, bitorder="little").tobytes(), "little")
    front = 1 << cell[0] * column + cell[1]  # a robot whose own cell is believed blocked can still leave it
    digits: list[int] = []  # of the distance plus one: in which cells each binary digit is 1
    steps = 0
    while front:
        steps += 1
        if steps >> len(digits):
            digits.append(0)
        for place in range(len(digits)):
            if steps >> place & 1:
                digits[place] |= front
        ahead &= ~front
        front = (front << 1 | front >> 1 | front << column | front >> column) & ahead
    distance = np.zeros(padded.size, dtype=np.int32)
    for place, cells in enumerate(digits):
        packed = np.frombuffer(cells.to_bytes(padded.size // 8 + 1, "little"), dtype=np.uint8)
        distance |= np.unpackbits(packed, count=padded.size, bitorder="little").astype(np.int32) << place
    lengths = np.ascontiguousarray(distance.reshape(padded.shape)[:, :-1]) - 1
    lengths.flags.writeable = False
    return lengths


def _flying_lengths(cell: Cell, shape: tuple[int, ...]) -> IntGrid:
    x = np.abs(np.arange(shape[0], dtype=np.int32) - cell[0])
    y = np.abs(np.arange(shape[1], dtype=np.int32) - cell[1])
    lengths: IntGrid = x[:, None] + y[None, :]
    lengths.flags.writeable = False
    return lengths


def path_to(goal: Cell, lengths: IntGrid) -> tuple[Cell, ...]:
    """The shortest path that `lengths` (from `path_lengths`) holds: cells from the start to `goal`, both included.

    Walks downhill from the goal and prefers to go straight on: few corners. Empty where there is no way.
    """
    if lengths[goal] == UNREACHABLE:
        return ()
    cell, step = goal, (0, 0)
    path = [cell]
    for left in range(int(lengths[goal]) - 1, -1, -1):
        steps = [step, (1, 0), (-1, 0), (0, 1), (0, -1)] if step != (0, 0) else _first_steps(lengths, goal)
        for dx, dy in steps:
            x, y = cell[0] + dx, cell[1] + dy
            if 0 <= x < lengths.shape[0] and 0 <= y < lengths.shape[1] and lengths[x, y] == left:
                cell, step = (x, y), (dx, dy)
                break
        path.append(cell)
    return tuple(reversed(path))


def simplify(path: tuple[Cell, ...]) -> tuple[Cell, ...]:
    """The corners of a 4-connected path and its end, without its start: what a ground robot must drive through.

    Legs between corners run along one axis through exactly the path's cells, and the first one stays within them from
    anywhere in the start cell: nothing cuts an obstacle's corner. A path of one cell gives that cell, an empty one
    none.
    """
    if len(path) < 2:
        return path
    turns = [
        here
        for before, here, after in zip(path, path[1:], path[2:], strict=False)
        if (here[0] - before[0], here[1] - before[1]) != (after[0] - here[0], after[1] - here[1])
    ]
    return (*turns, path[-1])


def _first_steps(lengths: IntGrid, goal: Cell) -> list[tuple[int, int]]:
    """Leave the goal along the longer axis towards the start first."""
    start = np.argwhere(lengths == 0)[0]
    dx, dy = int(start[0]) - goal[0], int(start[1]) - goal[1]
    along_x = [(1, 0), (-1, 0)] if dx >= 0 else [(-1, 0), (1, 0)]
    along_y = [(0, 1), (0, -1)] if dy >= 0 else [(0, -1), (0, 1)]
    return along_x + along_y if abs(dx) >= abs(dy) else along_y + along_x


def field_of_view(kind: RobotKind, cell: Cell, obstacles: BoolGrid, r_sense: float) -> BoolGrid:
    """Cells that a robot sees from `cell`: bool [W, H], a disc of radius `r_sense` cells.

    Obstacles hide what is behind them from a UGV (symmetric shadow-casting: if A sees B, B sees A), not from a UAV.
    """
    dx = np.arange(obstacles.shape[0]) - cell[0]
    dy = np.arange(obstacles.shape[1]) - cell[1]
    disc: BoolGrid = (dx * dx)[:, None] + (dy * dy)[None, :] <= r_sense * r_sense
    if kind is RobotKind.UAV:
        return disc
    import tcod.constants  # 0.1 s and 11 MB that a daemon does not need
    import tcod.map

    reach = int(r_sense)
    x0, y0 = max(0, cell[0] - reach), max(0, cell[1] - reach)
    around = np.s_[x0 : cell[0] + reach + 1, y0 : cell[1] + reach + 1]
    seen = np.zeros(obstacles.shape, dtype=np.bool_)
    seen[around] = tcod.map.compute_fov(
        ~obstacles[around],
        (cell[0] - x0, cell[1] - y0),
        radius=0,
        light_walls=True,
        algorithm=tcod.constants.FOV_SYMMETRIC_SHADOWCAST,
    )
    return seen & disc
