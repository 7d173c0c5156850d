"""City maps in the Moving AI Lab's `.map` format, and windows of them as worlds.

type octile
height 256
width 256
map
..@@..      one row of `width` signs for each of `height` lines, the northernmost first
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gatar_edge.errors import WorldError
from gatar_edge.sim_sitl.world import Team, World, populate
from gatar_edge.types import BoolGrid

FREE_SIGNS = b".GS"  # ground, passable terrain, swamp
BLOCKED_SIGNS = b"@OTW"  # out of bounds twice, trees, water
MOST_BYTES = 4 * 2**20
MOST_SIDE = 2048
LEAST_FREE = 0.3  # share of a window's cells, or it is redrawn: a window inside a block of houses is no world
WINDOW_TRIES = 1000


def read_map(path: Path) -> BoolGrid:
    """Obstacles of a map, bool [W, H], y north. Raises WorldError, naming the file and the line."""
    try:
        with path.open("rb") as file:
            content = file.read(MOST_BYTES + 1)
    except OSError as error:
        raise WorldError(f"map {path} cannot be read: {error.strerror}") from error
    if len(content) > MOST_BYTES:
        raise WorldError(f"map {path} is larger than {MOST_BYTES} bytes: cut it, worlds are windows of it anyway")
    lines = content.splitlines()
    width, height = _size(path, lines[:4])
    rows = lines[4 : 4 + height]
    if len(rows) < height:
        raise WorldError(f"map {path} ends after {len(rows)} of {height} rows")
    for number, row in enumerate(rows, start=5):
        if len(row) != width:
            raise WorldError(f"map {path}, line {number}: {len(row)} signs, the header says {width}")
        if strange := row.translate(None, FREE_SIGNS + BLOCKED_SIGNS):
            sign = strange[:1].decode("ascii", "backslashreplace")
            raise WorldError(f"map {path}, line {number}: sign {sign!r} is not of the format ({_known()})")
    signs = np.frombuffer(b"".join(rows), dtype=np.uint8).reshape(height, width)
    return ~np.isin(signs, np.frombuffer(FREE_SIGNS, dtype=np.uint8))[::-1].T


def window_world(city: BoolGrid, window: int, team: Team, targets: int, seed: int) -> World:
    """A random window of `window` x `window` cells with robots and targets on free cells; the same for the same seed.

    Raises WorldError where the map is smaller than the window or nowhere free enough.
    """
    if not 5 <= window <= min(city.shape):
        raise WorldError(f"window of {window} cells: must be 5 to {min(city.shape)}, the shorter side of the map")
    rng = np.random.default_rng(seed)
    for _ in range(WINDOW_TRIES):
        x, y = (int(rng.integers(side - window + 1)) for side in city.shape)
        part = city[x : x + window, y : y + window].copy()
        if (~part).mean() >= LEAST_FREE:
            return populate(part, team, targets, seed, rng)
    raise WorldError(f"no window of {window} cells with {LEAST_FREE:.0%} free cells in {WINDOW_TRIES} draws")


def _size(path: Path, header: list[bytes]) -> tuple[int, int]:
    words = [line.split() for line in header]
    shape = {line[0]: line[1] for line in words[1:3] if len(line) == 2}
    if len(words) < 4 or words[0][:1] != [b"type"] or words[3] != [b"map"] or shape.keys() != {b"height", b"width"}:
        raise WorldError(f"map {path} does not begin with the lines type, height, width, map: not of the .map format")
    try:
        width, height = int(shape[b"width"]), int(shape[b"height"])
    except ValueError:
        width = height = 0
    if not (5 <= width <= MOST_SIDE and 5 <= height <= MOST_SIDE):
        raise WorldError(f"map {path}: width and height must be numbers of 5 to {MOST_SIDE}")
    return width, height


def _known() -> str:
    return (FREE_SIGNS + BLOCKED_SIGNS).decode("ascii")
