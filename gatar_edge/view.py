"""One robot's picture at a decision: its K-hop graph, the targets it knows, and how far everybody has to go.

Built from the own belief and the neighbours' messages alone. Ego stands first, the rest by id: the order of robots
changes float sums, and every robot of a graph must break ties alike.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache, partial
from operator import attrgetter

import numpy as np
import numpy.typing as npt

from gatar_edge.belief import known_targets
from gatar_edge.grid import UNREACHABLE, lengths_from, passable, path_lengths
from gatar_edge.types import BoolGrid, ByteGrid, Cell, Cells, IntGrid, RobotKind, RobotState

Hops = npt.NDArray[np.int8]
FAR_HOPS = 2  # of robots that are remembered but not heard


@dataclass(frozen=True, slots=True, eq=False)  # it holds arrays: one view is equal to itself alone
class View:
    """Input of every allocator."""

    now_ns: int
    robots: tuple[RobotState, ...]  # N robots, ego first, the rest sorted by id
    graph: Callable[[], Hops]  # gives `hops`: most allocators do not ask for them
    belief: ByteGrid  # [W, H]
    targets: Cells  # [M, 2], known and not localized, sorted by x, then y
    distances: IntGrid  # [N, W, H], steps from each robot to each cell, -1 unreachable
    lengths: IntGrid  # [N, M], `distances` at the targets
    absent: tuple[RobotState, ...] = ()  # heard before, out of range now, where they are expected; sorted by id

    @property
    def hops(self) -> Hops:
        """Hops between the robots, [N, N]: 0 itself, 1 neighbour, ... hop_limit; -1 farther."""
        return self.graph()


def build_view(
    now_ns: int,
    ego: RobotState,
    others: Sequence[RobotState],
    belief: ByteGrid,
    r_comm: float,
    hop_limit: int,
    most: int,
    absent: tuple[RobotState, ...] = (),
) -> View:
    """The view of `ego`, with at most `most` targets: the nearest to ego where more are known."""
    robots = (ego, *sorted(others, key=_robot_id))
    distances = distances_of(robots, belief)
    targets = known_targets(belief)
    if len(targets) > most:
        way = distances[0, targets[:, 0], targets[:, 1]]
        nearest = np.argsort(np.where(way == UNREACHABLE, np.iinfo(np.int32).max, way), kind="stable")[:most]
        targets = targets[np.sort(nearest)]
    lengths = distances[:, targets[:, 0], targets[:, 1]]
    graph = partial(hop_counts, robots, r_comm, hop_limit)
    return View(now_ns, robots, graph, belief, targets, distances, lengths, absent)


_robot_id = attrgetter("robot_id")


def distances_of(robots: Sequence[RobotState], belief: ByteGrid) -> IntGrid:
    """Steps from each robot to each cell: int32 [N, W, H], -1 unreachable."""
    free = passable(RobotKind.UGV, belief)  # of a UAV's way nothing is asked but the grid's shape
    lengths = lengths_from([(robot.kind, robot.cell) for robot in robots], free)
    return np.concatenate(lengths).reshape(-1, *belief.shape)


def with_absent(view: View) -> View:
    """The view with the absent robots among its robots, `FAR_HOPS` from everybody; so are all that are out of range."""
    if not view.absent:
        return view if view.hops[0].min() >= 0 else replace(view, graph=known(_far(view.hops)))
    robots = (view.robots[0], *sorted((*view.robots[1:], *view.absent), key=lambda robot: robot.robot_id))
    old = {robot.robot_id: row for row, robot in enumerate(view.robots)}
    rows = [old.get(robot.robot_id, -1) for robot in robots]
    new = np.array([row < 0 for row in rows])
    hops = np.where(new[:, None] | new[None, :], -1, view.hops[np.ix_(rows, rows)]).astype(np.int8)
    np.fill_diagonal(hops, 0)
    distances = view.distances[rows]
    distances[new] = distances_of([robot for robot in robots if robot.robot_id not in old], view.belief)
    lengths = distances[:, view.targets[:, 0], view.targets[:, 1]]
    return replace(view, robots=robots, graph=known(_far(hops)), distances=distances, lengths=lengths)


def known(hops: Hops) -> Callable[[], Hops]:
    """The `graph` of a view whose hops are worked out already."""
    return lambda: hops


def _far(hops: Hops) -> Hops:
    """What is out of ego's graph lies `FAR_HOPS` from everybody."""
    out = hops[0] < 0
    far = np.where((out[:, None] | out[None, :]) & ~np.eye(len(hops), dtype=np.bool_), FAR_HOPS, hops)
    return far.astype(np.int8)


def without(view: View, cells: Iterable[Cell]) -> View:
    """The view without ego's ways to `cells`: its vehicle could not go there, whatever the map says.

    A ground robot's other ways lead round them; a UAV's do not stop there.
    """
    ego, distances, lengths = view.robots[0], view.distances.copy(), view.lengths.copy()
    free = passable(ego.kind, view.belief)
    for cell in cells:
        free[cell] = False
    distances[0] = np.where(free, path_lengths(ego.kind, ego.cell, free), UNREACHABLE)
    distances[0][ego.cell] = 0
    lengths[0] = distances[0, view.targets[:, 0], view.targets[:, 1]]
    return replace(view, distances=distances, lengths=lengths)


def hops_from_ego(robots: Sequence[RobotState], r_comm: float, hop_limit: int) -> tuple[int, ...]:
    """The first row of `hop_counts`, at a part of its cost."""
    cells = [robot.cell for robot in robots]
    hops, front, left = [0] + [-1] * (len(cells) - 1), [0], [*range(1, len(cells))]
    for limit in range(1, max(1, hop_limit) + 1):
        senders = [cells[row] for row in front]
        front = [row for row in left if _hears_any(cells[row], senders, r_comm * r_comm)]
        if not front:
            break
        for row in front:
            hops[row] = limit
            left.remove(row)
    return tuple(hops)


def _hears_any(cell: Cell, senders: Iterable[Cell], r_comm_squared: float) -> bool:
    return any((x - cell[0]) ** 2 + (y - cell[1]) ** 2 <= r_comm_squared for x, y in senders)


def hop_counts(robots: Sequence[RobotState], r_comm: float, hop_limit: int) -> Hops:
    """Hops between robots in the radius graph (eq. 4 of the paper: within `r_comm` cells, Euclidean): int8 [N, N]."""
    return _hops_between(tuple([robot.cell for robot in robots]), r_comm, hop_limit)


@lru_cache(maxsize=64)  # for a tick or two nobody may leave its cell
def _hops_between(places: tuple[Cell, ...], r_comm: float, hop_limit: int) -> Hops:
    x, y = np.array([cell[0] for cell in places]), np.array([cell[1] for cell in places])
    across, along = x[:, None] - x, y[:, None] - y
    near = across * across + along * along <= r_comm * r_comm
    links = near.astype(np.float32)  # counts of at most N, exact in single precision
    reached: BoolGrid = near
    within = near.astype(np.int16)  # in how many of the limits up to `hop_limit` a robot is reached
    for _ in range(2, hop_limit + 1):
        reached = reached @ links > 0
        within += reached
    hops: Hops = _hops_within(hop_limit)[within]
    np.fill_diagonal(hops, 0)
    hops.flags.writeable = False
    return hops


@cache
def _hops_within(hop_limit: int) -> Hops:
    """Hops by the number of limits, 1 to `hop_limit`, that they keep within."""
    return np.array([-1, *range(max(1, hop_limit), 0, -1)], dtype=np.int8)


def target_legs(view: View, kind: RobotKind) -> npt.NDArray[np.float64]:
    """Cells from target to target for a robot of `kind`: float64 [M, M], inf where there is no way."""
    free = passable(kind, view.belief)
    legs = np.full((len(view.targets), len(view.targets)), np.inf)
    x, y = view.targets[:, 0], view.targets[:, 1]
    for index, (here_x, here_y) in enumerate(view.targets.tolist()):
        lengths = path_lengths(kind, (here_x, here_y), free)[x, y]
        legs[index] = np.where(lengths == UNREACHABLE, np.inf, lengths)
    return legs


@lru_cache(maxsize=2)  # asked for by the allocator, and by the decision that follows
def travel_times(view: View) -> npt.NDArray[np.float64]:
    """Seconds from each robot to each target: float64 [N, M], read-only, inf where unreachable."""
    speeds = np.array([robot.speed_cells_s for robot in view.robots])
    times = np.where(view.lengths == UNREACHABLE, np.inf, view.lengths / speeds[:, None])
    times.flags.writeable = False
    return times
