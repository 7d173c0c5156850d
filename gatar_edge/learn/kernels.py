"""Compiled geometry for data generation: the same results as `gatar_edge.grid` and `view`, proved by parity tests.

The robot runs numpy; a million training views need the loops without Python round them. All grids are [W, H];
states are those of `CellState`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from gatar_edge.explore import FRONTIER_BLOCK
from gatar_edge.learn.jit import compiled
from gatar_edge.types import CellState

UNKNOWN, FREE, OBSTACLE = int(CellState.UNKNOWN), int(CellState.FREE), int(CellState.OBSTACLE)
TARGET, LOCALIZED = int(CellState.TARGET), int(CellState.LOCALIZED)
COORDINATE_BITS = 16  # of a cell in a queue: shifting is faster than dividing
LAST_COORDINATE = (1 << COORDINATE_BITS) - 1
_FLT_EPSILON = np.float32(1.1920929e-07)

Array = npt.NDArray[Any]


@compiled
def path_lengths(belief: Array, ugv: bool, x: int, y: int, out: Array, queue: Array) -> None:
    """Steps from (x, y) to every cell into `out` [W, H], -1 unreachable; `queue` holds at least W * H cells."""
    width, height = belief.shape
    if not ugv:
        for i in range(width):
            for j in range(height):
                out[i, j] = abs(i - x) + abs(j - y)
        return
    out[:] = -1
    out[x, y] = 0
    queue[0] = x << COORDINATE_BITS | y
    head, tail = 0, 1
    while head < tail:
        i, j = queue[head] >> COORDINATE_BITS, queue[head] & LAST_COORDINATE
        head += 1
        step = out[i, j] + 1
        for side in range(4):
            k = i + (side == 0) - (side == 1)
            m = j + (side == 2) - (side == 3)
            if 0 <= k < width and 0 <= m < height and out[k, m] < 0 and belief[k, m] != OBSTACLE:
                out[k, m] = step
                queue[tail] = k << COORDINATE_BITS | m
                tail += 1


@compiled
def next_step(lengths: Array, gx: int, gy: int) -> tuple[int, int]:
    """First cell on a shortest way from where `lengths` is 0 to the goal; the goal itself if it is there already."""
    width, height = lengths.shape
    x, y = gx, gy
    left = lengths[x, y]
    while left > 1:
        left -= 1
        for side in range(4):
            k = x + (side == 0) - (side == 1)
            m = y + (side == 2) - (side == 3)
            if 0 <= k < width and 0 <= m < height and lengths[k, m] == left:
                x, y = k, m
                break
    return x, y


@compiled
def field_of_view(obstacles: Array, ugv: bool, x: int, y: int, r_sense: float, out: Array, rows: Array) -> None:
    """What is seen from (x, y) into `out` bool [W, H]: a disc, and behind no obstacle for a UGV.

    Symmetric shadow-casting as libtcod computes it, in single precision, so that both agree in every cell; `rows`
    float32 [>= W + H, 3] is the stack of row segments (depth, low slope, high slope) still to scan.
    """
    width, height = obstacles.shape
    reach = int(r_sense)
    out[:] = False
    out[x, y] = True
    if not ugv:
        for i in range(max(0, x - reach), min(width, x + reach + 1)):
            for j in range(max(0, y - reach), min(height, y + reach + 1)):
                out[i, j] = (i - x) ** 2 + (j - y) ** 2 <= r_sense * r_sense
        return
    for quadrant in range(4):
        _scan_quadrant(obstacles, x, y, quadrant, r_sense, out, rows)


@compiled
def _rounded(value: np.float32) -> int:
    """Half away from zero, as C's roundf."""
    return int(np.floor(value + 0.5)) if value >= 0 else int(np.ceil(value - 0.5))


@compiled
def _scan_quadrant(obstacles: Array, x: int, y: int, quadrant: int, r_sense: float, out: Array, rows: Array) -> None:
    width, height = obstacles.shape
    sign = 1 if quadrant < 2 else -1
    eastward = quadrant in (0, 2)
    rows[0, 0], rows[0, 1], rows[0, 2] = 1, -1, 1
    top = 1
    while top > 0:
        top -= 1
        depth, low, high = int(rows[top, 0]), rows[top, 1], rows[top, 2]
        edge = (x if eastward else y) + sign * depth
        if depth > r_sense or edge < 0 or edge >= (width if eastward else height):
            continue
        first = _rounded(np.float32(np.float32(depth) * low) * np.float32(1 + _FLT_EPSILON))
        last = _rounded(np.float32(np.float32(depth) * high) * np.float32(1 - _FLT_EPSILON))
        before_wall = False
        for column in range(first, last + 1):
            i = edge if eastward else x + sign * column
            j = y + sign * column if eastward else edge
            if not (0 <= i < width and 0 <= j < height):
                continue
            wall = obstacles[i, j]
            symmetric = column >= np.float32(depth) * low and column <= np.float32(depth) * high
            if (wall or symmetric) and depth * depth + column * column <= r_sense * r_sense:
                out[i, j] = True
            slope = np.float32(2 * column - 1) / np.float32(2 * depth)
            if before_wall and not wall:
                low = slope
            if column != first and not before_wall and wall:
                rows[top, 0], rows[top, 1], rows[top, 2] = depth + 1, low, slope
                top += 1
            before_wall = wall
        if not before_wall:
            rows[top, 0], rows[top, 1], rows[top, 2] = depth + 1, low, high
            top += 1


@compiled
def observe(belief: Array, obstacles: Array, targets: Array, seen: Array, x: int, y: int) -> None:
    """What was seen enters the own belief, as `belief.observed` says; `targets` bool [W, H]."""
    width, height = belief.shape
    for i in range(width):
        for j in range(height):
            if seen[i, j] and belief[i, j] != LOCALIZED:
                if targets[i, j]:
                    belief[i, j] = TARGET
                elif obstacles[i, j]:
                    belief[i, j] = OBSTACLE
                else:
                    belief[i, j] = FREE
    if belief[x, y] == TARGET:
        belief[x, y] = LOCALIZED


@compiled
def hop_counts(cells: Array, r_comm: float, hop_limit: int, out: Array) -> None:
    """Hops in the radius graph into `out` [N, N]: 0 itself, -1 beyond `hop_limit`; `cells` [N, 2]."""
    in_range(cells, r_comm, out)
    over_relays(hop_limit, out)


@compiled
def in_range(cells: Array, r_comm: float, out: Array) -> None:
    """The radius graph into `out` [N, N]: 0 itself, 1 within `r_comm`, -1 beyond; `cells` [N, 2]."""
    count = cells.shape[0]
    out[:] = -1
    for n in range(count):
        for m in range(count):
            dx = int(cells[n, 0]) - int(cells[m, 0])
            dy = int(cells[n, 1]) - int(cells[m, 1])
            if dx * dx + dy * dy <= r_comm * r_comm:
                out[n, m] = 1
        out[n, n] = 0


@compiled
def over_relays(hop_limit: int, out: Array) -> None:
    """Add to the graph `out` [N, N] of those in range how many hops it is to others, up to `hop_limit`."""
    count = out.shape[0]
    for hop in range(2, hop_limit + 1):
        for n in range(count):
            for m in range(count):
                if out[n, m] == -1:
                    for k in range(count):
                        if out[n, k] == hop - 1 and out[k, m] == 1:
                            out[n, m] = hop
                            break


@compiled
def greedy(times: Array, out: Array) -> None:
    """The paper's expert over `times` [N, M] (inf unreachable; overwritten): shortest first, ties by row and column."""
    robots, targets = times.shape
    out[:] = -1
    for _ in range(min(robots, targets)):
        best, row, column = np.inf, -1, -1
        for n in range(robots):
            if out[n] < 0:
                for m in range(targets):
                    if times[n, m] < best:
                        best, row, column = times[n, m], n, m
        if row < 0:
            return
        out[row] = column
        times[:, column] = np.inf


@compiled
def list_targets(belief: Array, out: Array) -> int:
    """Known targets in order of x, then y, into `out` [>= M, 2]; returns how many, at most all that fit."""
    count = 0
    for i in range(belief.shape[0]):
        for j in range(belief.shape[1]):
            if belief[i, j] == TARGET and count < out.shape[0]:
                out[count, 0], out[count, 1] = i, j
                count += 1
    return count


@compiled
def list_frontiers(belief: Array, distances: Array, most: int, cells: Array, dark: Array) -> int:
    """`explore.frontiers` for the robots of `distances` [N, W, H] into `cells` [>= most, 2] and `dark` [>= most]."""
    width, height = belief.shape
    across = (height + FRONTIER_BLOCK - 1) // FRONTIER_BLOCK
    blocks = (width + FRONTIER_BLOCK - 1) // FRONTIER_BLOCK * across
    count = np.zeros(blocks, dtype=np.int64)
    place = np.full((blocks, 2), -1, dtype=np.int64)
    _block_places(belief, across, count, place)
    never = 2**31 - 1
    soonest = np.full(blocks, never, dtype=np.int64)
    for block in range(blocks):
        if count[block]:
            for n in range(distances.shape[0]):
                way = distances[n, place[block, 0], place[block, 1]]
                if 0 <= way < soonest[block]:
                    soonest[block] = way
    chosen = np.zeros(blocks, dtype=np.bool_)
    for block in np.argsort(soonest, kind="mergesort")[:most]:
        chosen[block] = soonest[block] < never
    found = 0
    for i in range(width):  # in order of the cells, not of the blocks
        for j in range(height):
            block = i // FRONTIER_BLOCK * across + j // FRONTIER_BLOCK
            if chosen[block] and place[block, 0] == i and place[block, 1] == j:
                cells[found, 0], cells[found, 1] = i, j
                dark[found] = count[block]
                found += 1
    return found


@compiled
def _block_places(belief: Array, across: int, count: Array, place: Array) -> None:
    """Unknown cells of each block into `count` [K], and the one nearest to their middle into `place` [K, 2]."""
    width, height = belief.shape
    sums = np.zeros((len(count), 2), dtype=np.int64)
    for i in range(width):
        for j in range(height):
            if belief[i, j] == UNKNOWN:
                block = i // FRONTIER_BLOCK * across + j // FRONTIER_BLOCK
                count[block] += 1
                sums[block, 0] += i
                sums[block, 1] += j
    nearest = np.empty(len(count), dtype=np.int64)
    for i in range(width):
        for j in range(height):
            if belief[i, j] == UNKNOWN:
                block = i // FRONTIER_BLOCK * across + j // FRONTIER_BLOCK
                gap = (i * count[block] - sums[block, 0]) ** 2 + (j * count[block] - sums[block, 1]) ** 2
                if place[block, 0] < 0 or gap < nearest[block]:
                    place[block, 0], place[block, 1] = i, j
                    nearest[block] = gap


@compiled
def pack(belief: Array, out: Array) -> None:
    """Three bits a cell, lowest bit first: uint8 [W, H] -> uint8 [ceil(3 W H / 8)]."""
    cells = belief.reshape(-1)
    word, bits, byte = np.int64(0), 0, 0
    for cell in range(len(cells)):
        word |= np.int64(cells[cell]) << bits
        bits += 3
        if bits >= 8:
            out[byte] = word & 255
            word, bits, byte = word >> 8, bits - 8, byte + 1
    if bits:
        out[byte] = word


@compiled
def unpack(packed: Array, out: Array) -> None:
    """The inverse of `pack`."""
    bit = 0
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            value = np.int64(packed[bit >> 3])
            if (bit & 7) > 5:
                value |= np.int64(packed[(bit >> 3) + 1]) << 8
            out[i, j] = (value >> (bit & 7)) & 7
            bit += 3
