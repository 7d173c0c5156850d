"""States on which a model and its network are compared: any number of robots and candidates, any connection.

Random ones cover every size; flown ones are what robots really meet, with tasks in hand and robots out of range.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from itertools import count, cycle, islice

import numpy as np

from gatar_edge.allocators.base import Allocation
from gatar_edge.allocators.routing import RoutingWithMemory
from gatar_edge.config import AgentConfig
from gatar_edge.features import Inputs, arrays_of, features_of
from gatar_edge.grid import passable, path_lengths
from gatar_edge.sim_sitl.faults import LinkFaults
from gatar_edge.sim_sitl.grid_mission import GridMission, fly
from gatar_edge.sim_sitl.world import VALIDATION_SEEDS, Team, random_obstacles, random_world
from gatar_edge.types import CellState, GridSpec, RobotKind, RobotState
from gatar_edge.view import View, hop_counts, known

SIZE = 20  # cells a side: larger than the window, so that candidates lie outside it too
ISOLATED, CONNECTED = 0.0, 1000.0  # r_comm
FLOWN = (("6A6G", 0.0), ("3A3G", 0.3), ("1A1G", 0.0))  # teams and message loss of missions, in turn
FLOWN_SIZE = 15  # cells a side of a mission's world


def random_view(robots: int, candidates: int, seed: int, r_comm: float) -> View:
    """A view of a partly known random world, with exactly so many robots and candidates."""
    rng = np.random.default_rng([seed, robots, candidates])
    obstacles = random_obstacles(SIZE, SIZE, rng)
    belief = np.where(obstacles, CellState.OBSTACLE, CellState.FREE).astype(np.uint8)
    belief[rng.random(belief.shape) < 0.3] = CellState.UNKNOWN
    places = rng.permutation(SIZE * SIZE)[: robots + candidates]
    cells = np.stack([places // SIZE, places % SIZE], axis=1)
    targets = cells[robots:]
    targets = targets[np.lexsort((targets[:, 1], targets[:, 0]))]
    belief[targets[:, 0], targets[:, 1]] = CellState.TARGET
    ids = rng.permutation(robots) + 1
    ids[1:] = np.sort(ids[1:])
    team = tuple(
        RobotState(int(ids[n]), RobotKind(int(rng.integers(2))), (int(cells[n, 0]), int(cells[n, 1])), 1.0)
        for n in range(robots)
    )
    distances = np.stack([path_lengths(robot.kind, robot.cell, passable(robot.kind, belief)) for robot in team])
    lengths = distances[:, targets[:, 0], targets[:, 1]]
    hops = hop_counts(team, r_comm, 2)
    return View(0, team, known(hops), belief, targets.astype(np.int16), distances, lengths)


def random_state(robots: int, candidates: int, seed: int, r_comm: float) -> Inputs:
    """Input of a network for `random_view`."""
    return features_of(arrays_of(random_view(robots, candidates, seed, r_comm)))


class _Watched:
    """Flies by a rule and keeps what it was asked."""

    name = "watched"

    def __init__(self, views: list[View]) -> None:
        self._rule = RoutingWithMemory()
        self._views = views

    def allocate(self, view: View) -> Allocation:
        self._views.append(view)
        return self._rule.allocate(view)


def flown_views(most: int) -> Iterator[View]:
    """Views of robots in missions, as many as asked for: one mission after another, on validation worlds."""
    return islice(_flown(), most)


def _flown() -> Iterator[View]:
    config = AgentConfig(grid=GridSpec(width=FLOWN_SIZE, height=FLOWN_SIZE))
    for seed, (name, loss) in zip(count(VALIDATION_SEEDS), cycle(FLOWN), strict=False):
        views: list[View] = []
        world = random_world(Team.parse(name), None, FLOWN_SIZE, FLOWN_SIZE, seed)
        fly(GridMission(world, config, LinkFaults(loss)), partial(_Watched, views))
        yield from views
