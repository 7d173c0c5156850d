"""What one robot knows of the world: a grid of `CellState`, from its own eyes and its neighbours' messages.

Pure functions over read-only arrays: each returns a new belief. Knowledge only grows (`CellState` is ordered by
precedence), but for own eyes, which may correct what was heard.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import numpy.typing as npt

from gatar_edge.types import BoolGrid, ByteGrid, Cell, Cells, CellState, GridSpec, Observation

WINDOW = 15  # cells a side of what one message carries
# As array elements, read once: a member of an enum costs as much as a small array's comparison.
_UNKNOWN, _FREE, _OBSTACLE, _TARGET, _LOCALIZED = (np.uint8(state) for state in CellState)
_CellsKey = tuple[str, bytes]  # dtype and data of [n, 2]


def nothing_known(grid: GridSpec) -> ByteGrid:
    """A belief without any knowledge: uint8 [W, H]."""
    return _frozen(np.zeros((grid.width, grid.height), dtype=np.uint8))


def observed(belief: ByteGrid, observation: Observation) -> ByteGrid:
    """The belief after an own observation: the same array where nothing is new.

    A target under the robot is localized by its visit.
    """
    index, states = _drawn(*map(_key, (observation.seen, observation.obstacles, observation.targets)), belief.shape)
    known = belief.reshape(-1)[index]
    # a target in view keeps looking like one after somebody's visit: only the memory of the visit tells
    states = np.where(known == _LOCALIZED, known, states)
    x, y = observation.cell
    here = 0 <= x < belief.shape[0] and 0 <= y < belief.shape[1]
    if not np.count_nonzero(known != states) and not (here and belief[x, y] == _TARGET):
        return belief
    new = belief.copy()
    new.reshape(-1)[index] = states
    if here and new[x, y] == _TARGET:
        new[x, y] = _LOCALIZED
    return _frozen(new)


def same_sight(one: Observation, other: Observation) -> bool:
    """Whether two observations show the same by being made of the same arrays, as the perception's are."""
    return (
        one.cell == other.cell
        and one.seen is other.seen
        and one.obstacles is other.obstacles
        and one.targets is other.targets
    )


def merged(belief: ByteGrid, origin: Cell, window: ByteGrid) -> ByteGrid:
    """The belief after hearing `window` [w, h] of states, whose cell [0, 0] is `origin`. Parts outside are ignored."""
    x0, y0 = max(0, origin[0]), max(0, origin[1])
    x1 = min(belief.shape[0], origin[0] + window.shape[0])
    y1 = min(belief.shape[1], origin[1] + window.shape[1])
    if x0 >= x1 or y0 >= y1:
        return belief
    heard = window[x0 - origin[0] : x1 - origin[0], y0 - origin[1] : y1 - origin[1]]
    if not np.count_nonzero(heard > belief[x0:x1, y0:y1]):  # several times as fast as all()
        return belief
    new = belief.copy()
    np.maximum(new[x0:x1, y0:y1], heard, out=new[x0:x1, y0:y1])
    return _frozen(new)


def window_at(belief: ByteGrid, origin: Cell) -> ByteGrid:
    """The `WINDOW` x `WINDOW` cells of the belief from `origin` on; unknown outside the grid."""
    x0, y0 = max(0, origin[0]), max(0, origin[1])
    part = belief[x0 : origin[0] + WINDOW, y0 : origin[1] + WINDOW]
    if part.shape == (WINDOW, WINDOW):
        return part
    window = np.zeros((WINDOW, WINDOW), dtype=np.uint8)
    window[x0 - origin[0] : x0 - origin[0] + part.shape[0], y0 - origin[1] : y0 - origin[1] + part.shape[1]] = part
    return _frozen(window)


def window_origin(belief: ByteGrid, cell: Cell, sequence: int) -> Cell:
    """Which window to broadcast: turn about, the one round the robot and one of the others in which something is known.

    The window stays inside the grid, so that in a world of 15 x 15 every message carries all that the robot knows.
    """
    limit = (max(0, belief.shape[0] - WINDOW), max(0, belief.shape[1] - WINDOW))
    around = (min(max(cell[0] - WINDOW // 2, 0), limit[0]), min(max(cell[1] - WINDOW // 2, 0), limit[1]))
    if limit == (0, 0) or sequence % 2 == 0:
        return around
    origins = [
        (min(x, limit[0]), min(y, limit[1]))
        for x in range(0, belief.shape[0], WINDOW)
        for y in range(0, belief.shape[1], WINDOW)
    ]
    known = [o for o in origins if belief[o[0] : o[0] + WINDOW, o[1] : o[1] + WINDOW].any()]
    return known[sequence // 2 % len(known)] if known else around


def known_targets(belief: ByteGrid) -> Cells:
    """Targets seen and not yet localized: int16 [m, 2], sorted by x, then y."""
    return np.array((belief == _TARGET).nonzero(), dtype=np.int16).T.copy()


def unknown(belief: ByteGrid) -> BoolGrid:
    """Cells that nobody has told of: bool [W, H]."""
    dark: BoolGrid = belief == _UNKNOWN
    return dark


def _key(cells: Cells) -> _CellsKey:
    return cells.dtype.str, cells.tobytes()


@lru_cache(maxsize=256)  # a robot stays in a cell for several ticks, and sees the same
def _drawn(
    seen: _CellsKey, obstacles: _CellsKey, targets: _CellsKey, shape: tuple[int, ...]
) -> tuple[npt.NDArray[np.intp], ByteGrid]:
    """Places in the flat grid and what is seen in them, a target before an obstacle; cells outside are ignored."""
    states: dict[int, np.uint8] = {}
    for (dtype, data), state in ((seen, _FREE), (obstacles, _OBSTACLE), (targets, _TARGET)):
        for x, y in np.frombuffer(data, dtype).reshape(-1, 2).tolist():
            if 0 <= x < shape[0] and 0 <= y < shape[1]:
                states[x * shape[1] + y] = state
    return np.array(list(states), dtype=np.intp), np.array(list(states.values()), dtype=np.uint8)


def _frozen(array: ByteGrid) -> ByteGrid:
    array.flags.writeable = False
    return array
