"""Ground truth: obstacles, targets, starting places, and what a robot sees of them. Everything from one seed.

Seeds of worlds are disjoint by purpose, so that nothing is tuned or trained on what it is judged by:

    0 ..         999 999   test (also what `gatar sim --seed` flies)
    1 000 000 .. 1 999 999 validation: choosing settings
    2 000 000 ..           training
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from gatar_edge.errors import ConfigError, WorldError
from gatar_edge.grid import UNREACHABLE, as_cells, field_of_view, path_lengths
from gatar_edge.types import BoolGrid, Cell, Cells, Observation, RobotKind

VALIDATION_SEEDS = 1_000_000
TRAINING_SEEDS = 2_000_000

BLOCK = 5  # cells a side
# Obstacles in each of the 3 x 3 blocks, [x][y]: the paper's non-uniform densities of 0, 3 and 5 a block.
TEMPLATES = (
    ((0, 0, 0), (3, 3, 3), (5, 5, 5)),  # denser towards the east
    ((0, 3, 5), (0, 3, 5), (0, 3, 5)),  # denser towards the north
    ((0, 3, 0), (3, 5, 3), (0, 3, 0)),  # dense centre
    ((5, 3, 5), (3, 0, 3), (5, 3, 5)),  # dense corners
    ((5, 3, 0), (3, 5, 3), (0, 3, 5)),  # dense diagonal
    ((5, 0, 5), (0, 3, 0), (5, 0, 5)),  # chequered
)


@dataclass(frozen=True, slots=True)
class Team:
    """Kinds of the robots, UAVs first; the id of a robot is its index plus one."""

    kinds: tuple[RobotKind, ...]

    @staticmethod
    def parse(text: str) -> Team:
        """Read a team such as 3A3G: aerial, then ground robots. Raises ConfigError."""
        match = re.fullmatch(r"([0-9]{1,3})A([0-9]{1,3})G", text.strip().upper())
        count = (int(match[1]), int(match[2])) if match else (0, 0)
        if not 1 <= sum(count) <= 64:
            raise ConfigError(f"team {text!r} is not of the form 3A3G (aerial, ground; 1 to 64 robots together)")
        return Team((RobotKind.UAV,) * count[0] + (RobotKind.UGV,) * count[1])

    @property
    def ids(self) -> tuple[int, ...]:
        return tuple(range(1, len(self.kinds) + 1))

    def __str__(self) -> str:
        return f"{self.kinds.count(RobotKind.UAV)}A{self.kinds.count(RobotKind.UGV)}G"


@dataclass(frozen=True, slots=True)
class World:
    """One mission's truth."""

    obstacles: BoolGrid  # [W, H]
    targets: Cells  # [M, 2], sorted by x, then y
    starts: tuple[Cell, ...]  # by robot index
    team: Team
    seed: int

    @property
    def shape(self) -> tuple[int, int]:
        return self.obstacles.shape[0], self.obstacles.shape[1]


def random_obstacles(width: int, height: int, rng: np.random.Generator) -> BoolGrid:
    """A map of 5 x 5 blocks after one of the six density templates, stretched to the size: bool [W, H]."""
    template = TEMPLATES[rng.integers(len(TEMPLATES))]
    obstacles = np.zeros((width, height), dtype=np.bool_)
    blocks = (-(-width // BLOCK), -(-height // BLOCK))
    for bx in range(blocks[0]):
        for by in range(blocks[1]):
            count = template[bx * 3 // blocks[0]][by * 3 // blocks[1]]
            cells = rng.permutation(BLOCK * BLOCK)[:count]
            x, y = bx * BLOCK + cells // BLOCK, by * BLOCK + cells % BLOCK
            inside = (x < width) & (y < height)
            obstacles[x[inside], y[inside]] = True
    return obstacles


def populate(obstacles: BoolGrid, team: Team, targets: int, seed: int, rng: np.random.Generator) -> World:
    """Put robots and targets on different free cells. Raises WorldError where there are too few."""
    free = as_cells(~obstacles)
    wanted = len(team.kinds) + targets
    if wanted > len(free):
        raise WorldError(
            f"{len(team.kinds)} robots and {targets} targets do not fit on {len(free)} free cells: larger map or fewer"
        )
    chosen = free[rng.permutation(len(free))[:wanted]]
    starts = tuple((int(x), int(y)) for x, y in chosen[: len(team.kinds)])
    places = chosen[len(team.kinds) :]
    places = places[np.lexsort((places[:, 1], places[:, 0]))]
    return World(obstacles, places, starts, team, seed)


def random_world(team: Team, targets: int | None, width: int, height: int, seed: int) -> World:
    """The paper's generator: the same seed gives the same world. `targets` None: 20 to 30, by the seed."""
    if not (5 <= width <= 1024 and 5 <= height <= 1024):
        raise WorldError(f"world of {width} x {height} cells: each side must be 5 to 1024")
    if targets is not None and not 0 <= targets <= 10_000:
        raise WorldError(f"{targets} targets: must be 0 to 10000")
    if seed < 0:
        raise WorldError(f"seed {seed}: must not be negative")
    rng = np.random.default_rng(seed)
    count = int(rng.integers(20, 31)) if targets is None else targets
    return populate(random_obstacles(width, height, rng), team, count, seed, rng)


def observe(world: World, robot_id: int, cell: Cell, r_sense: float, t_ns: int) -> Observation:
    """What robot `robot_id` sees from `cell`. Targets look the same before and after a visit."""
    kind = world.team.kinds[robot_id - 1]
    truth = (world.obstacles.tobytes(), world.targets.tobytes(), world.shape)
    return Observation(robot_id, kind, cell, *_in_view(kind, cell, r_sense, *truth), t_ns=t_ns)


@lru_cache(maxsize=1024)  # a robot stays in a cell for several ticks, and the truth is what it is
def _in_view(
    kind: RobotKind, cell: Cell, r_sense: float, obstacles: bytes, targets: bytes, shape: tuple[int, int]
) -> tuple[Cells, Cells, Cells]:
    """Cells, obstacles and targets in view from `cell`, read-only."""
    blocked = np.frombuffer(obstacles, dtype=np.bool_).reshape(shape)
    there = np.frombuffer(targets, dtype=np.int16).reshape(-1, 2)
    seen = field_of_view(kind, cell, blocked, r_sense)
    found = as_cells(seen), as_cells(seen & blocked), there[seen[there[:, 0], there[:, 1]]]
    for cells in found:
        cells.flags.writeable = False
    return found


def reachable_cells(world: World, robot_id: int) -> BoolGrid:
    """Where one robot can ever get from its start: bool [W, H]."""
    kind, start = world.team.kinds[robot_id - 1], world.starts[robot_id - 1]
    free = np.ones(world.shape, dtype=np.bool_) if kind is RobotKind.UAV else ~world.obstacles
    reached: BoolGrid = path_lengths(kind, start, free) != UNREACHABLE
    return reached


def reachable_targets(world: World, by: Iterable[int] | None = None) -> Cells:
    """Targets that at least one robot of the team, or of those with the ids `by`, can reach from its start: int16
    [m, 2].
    """
    reached = np.zeros(world.shape, dtype=np.bool_)
    for robot_id in world.team.ids if by is None else by:
        reached |= reachable_cells(world, robot_id)
    return world.targets[reached[world.targets[:, 0], world.targets[:, 1]]]
