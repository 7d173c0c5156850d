"""Heterogeneity-aware input of the network: one implementation for training and for the robot.

Written over arrays with any leading batch axes `...`, so that one view and a batch of views are the same code. Nothing
here is an absolute coordinate: windows and offsets are relative to a robot, so that the size of the world is free.

| name    | axes            | what                                                                         |
|---------|-----------------|------------------------------------------------------------------------------|
| maps    | N channel wx wy | `CHANNELS` of the paper round each robot (section III-A, eq. 5 and 6)        |
| robots  | N F             | `ROBOT_FEATURES`                                                             |
| pairs   | N M P           | `PAIR_FEATURES` of each robot and each candidate                             |
| cells   | N M             | index of the candidate's cell in the robot's window, 0 where it lies outside |
| valid   | N M             | 1 where the candidate exists and the robot can reach it                      |
| offsets | M xy            | candidate's cell minus ego's cell                                            |
| places  | M C             | `PLACE_FEATURES` of each candidate                                           |
| hops    | N N             | hop count, 0 on the diagonal, -1 beyond the graph                            |

Candidates are known targets, sorted by cell, and behind them, for a model that asks for them, places to go and look
(`explore.frontiers`).

Speeds enter as shares of the fastest robot of the view, so that cell size and step make no difference.
N is at least 1 (ego is row 0); M is padded to at least 1 with `valid` 0, because ONNX operators differ on empty axes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from gatar_edge.explore import MOST_FRONTIERS, frontiers
from gatar_edge.grid import UNREACHABLE
from gatar_edge.types import CellState, Floats, IntGrid, RobotKind
from gatar_edge.view import View

FEATURES_VERSION = 3
MAX_CANDIDATES = 64
WINDOW = 15  # cells a side, the robot in the middle
SIGMA = 1.0  # of the Gaussian target map, cells
EPSILON = 1.0  # of the reward map, cells: with 1, the reward of the own cell is the speed
CHANNELS = ("reward", "gaussian_target", "obstacle", "product")
ROBOT_FEATURES = ("ugv", "speed", "rank", "hops", "ego", "busy", "degree", "unknown", "age")
PAIR_FEATURES = (
    "time",
    "reward",
    "reachable",
    "ugv",
    "unknown",
    "robot_rank",
    "target_rank",
    "task",
    "inside",
    "dx",
    "dy",
)
PLACE_FEATURES = ("frontier", "unknown", "hidden")
AXES: dict[str, tuple[str, ...]] = {
    "maps": ("N", "channel", "wx", "wy"),
    "robots": ("N", "F"),
    "pairs": ("N", "M", "P"),
    "cells": ("N", "M"),
    "valid": ("N", "M"),
    "offsets": ("M", "xy"),
    "places": ("M", "C"),
    "hops": ("N", "N"),
}
SIZES = {
    "channel": len(CHANNELS),
    "wx": WINDOW,
    "wy": WINDOW,
    "F": len(ROBOT_FEATURES),
    "P": len(PAIR_FEATURES),
    "C": len(PLACE_FEATURES),
    "xy": 2,
}

TIME_SCALE = 10.0  # cells of the fastest robot
LENGTH_SCALE_CELLS = 10.0
RANK_SCALE = 16.0
TARGET_RANK_SCALE = 32.0
AGE_SCALE_S = 10.0
UNKNOWN_SCALE = 16.0  # cells
PRIOR_TARGETS, PRIOR_CELLS = 3.0, 25.0  # the density of targets before anything is seen, and how much that weighs
UNKNOWN_REACH = 2  # half side of the square round a target in which unknown cells are counted

_SPAN = np.arange(-(WINDOW // 2), WINDOW // 2 + 1)
# numpy compares with its own numbers in a fraction of the time that it takes to look into an enum
_UNKNOWN, _OBSTACLE, _TARGET = np.array([CellState.UNKNOWN, CellState.OBSTACLE, CellState.TARGET], dtype=np.uint8)
_UGV = int(RobotKind.UGV)

Array = npt.NDArray[np.generic]
Ints = npt.NDArray[np.int64]
Bools = npt.NDArray[np.bool_]
Inputs = dict[str, Array]


@dataclass(frozen=True, slots=True)
class ViewArrays:
    """A view, or a batch of views, as arrays; rows that only fill up a batch are marked by `present` and `listed`."""

    belief: npt.NDArray[np.uint8]  # [..., W, H]
    distances: npt.NDArray[np.int32]  # [..., N, W, H], -1 unreachable
    robots: Ints  # [..., N, 2], cells, ego first
    kinds: Ints  # [..., N]
    speeds: Floats  # [..., N], in any unit
    ids: Ints  # [..., N]
    tasks: Ints  # [..., N, 2], claimed target or (-1, -1)
    ages_s: Floats  # [..., N]
    present: Bools  # [..., N]
    hops: Ints  # [..., N, N]
    targets: Ints  # [..., M, 2], candidates: targets sorted by x, then y, and frontiers behind them
    listed: Bools  # [..., M]
    dark: Ints  # [..., M], unknown cells round a frontier, 0 for targets


def arrays_of(view: View, with_frontiers: bool = False) -> ViewArrays:
    """The arrays of one view, M padded to at least 1."""
    robots = view.robots
    count = len(view.targets)
    targets, dark = view.targets.astype(np.int64), np.zeros(count, dtype=np.int64)
    room = min(MOST_FRONTIERS, MAX_CANDIDATES - count)
    if with_frontiers and room > 0:
        cells, unknown = frontiers(view.belief, view.distances, room)
        targets, dark = np.concatenate([targets, cells]), np.concatenate([dark, unknown])
    count = len(targets)
    return ViewArrays(
        belief=view.belief,
        distances=view.distances,
        robots=np.array([robot.cell for robot in robots], dtype=np.int64),
        kinds=np.array([robot.kind for robot in robots], dtype=np.int64),
        speeds=np.array([robot.speed_cells_s for robot in robots], dtype=np.float32),
        ids=np.array([robot.robot_id for robot in robots], dtype=np.int64),
        tasks=np.array([robot.task_cell for robot in robots], dtype=np.int64),
        ages_s=np.array([robot.age_ns * 1e-9 for robot in robots], dtype=np.float32),
        present=np.ones(len(robots), dtype=np.bool_),
        hops=view.hops.astype(np.int64),
        targets=targets if count else np.zeros((1, 2), dtype=np.int64),
        listed=np.ones(count, dtype=np.bool_) if count else np.zeros(1, dtype=np.bool_),
        dark=dark if count else np.zeros(1, dtype=np.int64),
    )


def features(view: View, with_frontiers: bool = False, with_windows: bool = True) -> Inputs:
    """Input of the network for one view: names and axes of `AXES`, without batch axes."""
    return features_of(arrays_of(view, with_frontiers), with_windows)


def features_of(view: ViewArrays, with_windows: bool = True) -> Inputs:
    """Input of the network for a batch of views: `AXES` after the leading batch axes.

    `maps` and `cells` are most of the work: without windows they are left out.
    """
    lengths = _at_targets(view)
    fastest = np.where(view.present, view.speeds, 0).max(axis=-1, keepdims=True)
    view = replace(view, speeds=view.speeds / np.maximum(fastest, np.float32(1e-6)))
    real = view.listed[..., None, :] & view.present[..., :, None]
    gaps = view.targets[..., None, :, :] - view.robots[..., :, None, :]
    inside = _in_window(view, gaps)
    unknown = _unknown_sums(view)
    dark = _unknown_shares(view, unknown)
    count = view.robots.shape[-2]
    rank = _ranks(view) / np.float32(RANK_SCALE)
    windows = {"maps": channels(view), "cells": _window_cells(gaps, inside)} if with_windows else {}
    return {
        "robots": _robot_features(view, dark[..., :count], rank),
        "pairs": _pair_features(view, lengths, gaps, dark[..., count:], rank, inside, real),
        "valid": ((lengths != UNREACHABLE) & real).astype(np.float32),
        "offsets": (view.targets - view.robots[..., :1, :]).astype(np.float32),
        "places": _place_features(view, unknown),
        "hops": view.hops,
        **windows,
    }


def channels(view: ViewArrays) -> Floats:
    """The four maps round each robot, float32 [..., N, 4, 15, 15], zero outside the world.

    Reward: v / (d + epsilon), d the length of the shortest way on what is known, 0 where there is none (eq. 5).
    Gaussian target: max over known targets of exp(-(dx^2 + dy^2) / sigma^2) (eq. 6, with the square the paper drops).
    """
    flat, inside = _window_index(view)
    distance = view.distances.reshape(-1)[flat]
    shared = _window_index_of_belief(view, flat)
    obstacles = (view.belief == _OBSTACLE).reshape(-1)[shared]
    speed = view.speeds[..., None, None]
    reachable = inside & (distance != UNREACHABLE)
    maps = np.empty((*view.robots.shape[:-1], len(CHANNELS), WINDOW, WINDOW), dtype=np.float32)
    maps[..., 0, :, :] = np.where(reachable, speed / (np.maximum(distance, 0) + np.float32(EPSILON)), 0)
    maps[..., 1, :, :] = _gaussian(view).reshape(-1)[shared] * inside
    maps[..., 2, :, :] = inside & obstacles
    np.multiply(maps[..., 0, :, :], maps[..., 1, :, :], out=maps[..., 3, :, :])
    maps[~view.present] = 0
    return maps


def _window_index(view: ViewArrays) -> tuple[Ints, Bools]:
    """Flat index into `distances` of every window cell, clipped to the world, and whether it lies in it."""
    width, height = view.belief.shape[-2:]
    x = view.robots[..., 0, None] + _SPAN
    y = view.robots[..., 1, None] + _SPAN
    inside = ((x >= 0) & (x < width))[..., :, None] & ((y >= 0) & (y < height))[..., None, :]
    cell = (_within(x, width - 1) * height)[..., :, None] + _within(y, height - 1)[..., None, :]
    robots = view.robots.shape[:-1]
    first = np.arange(math.prod(robots)).reshape(robots) * (width * height)
    return cell + first[..., None, None], inside


def _within(values: Ints, most: int) -> Ints:
    """`values` from 0 to `most`; np.clip is slower on few numbers."""
    inside: Ints = np.minimum(np.maximum(values, 0), most)
    return inside


def _window_index_of_belief(view: ViewArrays, flat: Ints) -> Ints:
    """The same cells in the belief, which all robots of a view share."""
    area = view.belief.shape[-2] * view.belief.shape[-1]
    batch = view.belief.shape[:-2]
    first = np.arange(math.prod(batch)).reshape(batch) * area
    index: Ints = flat % area + first[..., None, None, None]
    return index


def _gaussian(view: ViewArrays) -> Floats:
    """On the world's cells, which all robots of a view share: [..., W, H]; separable, the larger of all targets."""
    width, height = view.belief.shape[-2:]
    targets = view.targets.astype(np.float32)
    gap_x = targets[..., 0, None] - np.arange(width, dtype=np.float32)
    gap_y = targets[..., 1, None] - np.arange(height, dtype=np.float32)
    scale = np.float32(SIGMA * SIGMA)
    along_x = np.exp(-(gap_x * gap_x) / scale) * (view.listed & (view.dark == 0))[..., None]
    along_y = np.exp(-(gap_y * gap_y) / scale)
    best: Floats = (along_x[..., :, None] * along_y[..., None, :]).max(axis=-3)
    return best


def _at_targets(view: ViewArrays) -> Ints:
    """Steps from each robot to each target: [..., N, M]."""
    width, height = view.belief.shape[-2:]
    robots = view.robots.shape[:-1]
    first = np.arange(math.prod(robots)).reshape(robots) * (width * height)
    cell = view.targets[..., 0] * height + view.targets[..., 1]
    lengths: Ints = view.distances.reshape(-1)[first[..., None] + cell[..., None, :]]
    return lengths


def _times(lengths: Ints, reachable: Bools, speeds: Floats) -> tuple[Floats, Floats]:
    """Time to each target, as cells of the fastest robot, and the reward there; both 0 where unreachable."""
    speed: Floats = np.maximum(speeds[..., None], np.float32(1e-3))
    steps: Floats = np.maximum(lengths, 0).astype(np.float32)  # 0 where unreachable, and so is the time
    reward: Floats = speed / (steps + np.float32(EPSILON)) * reachable
    return steps / speed, reward


def _in_window(view: ViewArrays, gaps: Ints) -> Bools:
    """Whether each candidate lies in each robot's window; `gaps` [..., N, M, 2]."""
    near = np.abs(gaps) <= WINDOW // 2
    inside: Bools = near[..., 0] & near[..., 1] & view.listed[..., None, :]
    return inside


def _window_cells(gaps: Ints, inside: Bools) -> Ints:
    """Index of each candidate's cell in each robot's window, 0 where it is not `inside`."""
    cell = gaps[..., 0] * WINDOW + gaps[..., 1] + WINDOW // 2 * (WINDOW + 1)
    return np.where(inside, cell, 0)


def _ranks(view: ViewArrays) -> Floats:
    """How many robots of the graph have a smaller id: every robot of the graph ranks alike."""
    smaller = (view.ids[..., None, :] < view.ids[..., :, None]) & view.present[..., None, :]
    rank: Floats = smaller.sum(axis=-1).astype(np.float32)
    return rank


def _robot_features(view: ViewArrays, dark: Floats, rank: Floats) -> Floats:
    out = np.empty((*view.ids.shape, len(ROBOT_FEATURES)), dtype=np.float32)
    out[..., 0] = view.kinds == _UGV
    out[..., 1] = view.speeds
    out[..., 2] = rank
    out[..., 3] = view.hops[..., 0, :] / np.float32(2)
    out[..., 4] = np.arange(view.ids.shape[-1]) == 0
    out[..., 5] = view.tasks[..., 0] >= 0
    out[..., 6] = (view.hops == 1).sum(axis=-1) / np.float32(8)
    out[..., 7] = dark
    out[..., 8] = view.ages_s / np.float32(AGE_SCALE_S)
    out[~view.present] = 0
    return out


def _pair_features(
    view: ViewArrays, lengths: Ints, gaps: Ints, dark: Floats, rank: Floats, inside: Bools, real: Bools
) -> Floats:
    reachable = lengths != UNREACHABLE
    times, reward = _times(lengths, reachable, view.speeds)
    out = np.empty((*times.shape, len(PAIR_FEATURES)), dtype=np.float32)
    tasks, targets = view.tasks[..., :, None, :], view.targets[..., None, :, :]
    out[..., 0] = times / np.float32(TIME_SCALE)
    out[..., 1] = reward
    out[..., 2] = reachable
    out[..., 3] = (view.kinds == _UGV)[..., None]
    out[..., 4] = dark[..., None, :]
    out[..., 5] = rank[..., None]
    out[..., 6] = np.arange(view.targets.shape[-2], dtype=np.float32) / np.float32(TARGET_RANK_SCALE)
    out[..., 7] = (tasks[..., 0] == targets[..., 0]) & (tasks[..., 1] == targets[..., 1])
    out[..., 8] = inside
    out[..., 9:11] = gaps / np.float32(LENGTH_SCALE_CELLS)
    if np.count_nonzero(real) != real.size:  # in a robot's own view there is nothing to blot out
        out *= real[..., None]
    return out


def _place_features(view: ViewArrays, unknown: IntGrid) -> Floats:
    """Whether a candidate is a frontier, the unknown cells round it, and how many targets they may hide."""
    size = view.belief.shape[-2] * view.belief.shape[-1]
    found = (view.belief >= _TARGET).sum(axis=(-2, -1))  # or localized
    seen = size - unknown[..., -1, -1] - (view.belief == _OBSTACLE).sum(axis=(-2, -1))
    density = (np.float32(found) + np.float32(PRIOR_TARGETS)) / (np.float32(seen) + np.float32(PRIOR_CELLS))
    dark = view.dark.astype(np.float32)
    out = np.empty((*dark.shape, len(PLACE_FEATURES)), dtype=np.float32)
    out[..., 0] = view.dark > 0
    out[..., 1] = dark / np.float32(UNKNOWN_SCALE)
    out[..., 2] = dark * np.asarray(density)[..., None]
    return out


def _unknown_sums(view: ViewArrays) -> IntGrid:
    """How many cells are unknown below and left of each corner of a cell: [..., W + 1, H + 1]."""
    width, height = view.belief.shape[-2:]
    unknown = np.zeros((*view.belief.shape[:-2], width + 1, height + 1), dtype=np.int32)
    np.cumsum(view.belief == _UNKNOWN, axis=-2, out=unknown[..., 1:, 1:])
    np.cumsum(unknown[..., 1:, 1:], axis=-1, out=unknown[..., 1:, 1:])
    return unknown


def _unknown_shares(view: ViewArrays, unknown: IntGrid) -> Floats:
    """Share of unknown cells in the window round each robot and in the square round each candidate: [..., N + M].

    Outside the world nothing is unknown.
    """
    width, height = unknown.shape[-2] - 1, unknown.shape[-1] - 1
    batch = unknown.shape[:-2]
    edges, area = _squares(view.robots.shape[-2], view.targets.shape[-2], len(batch))
    centres = np.concatenate([view.robots, view.targets], axis=-2)
    x = _within(centres[..., 0] + edges, width)  # [low high, ..., N + M]
    y = _within(centres[..., 1] + edges, height)
    first = np.arange(math.prod(batch)).reshape(batch)[..., None] * (width + 1)
    sums = unknown.reshape(-1)[((first + x) * (height + 1))[:, None] + y]  # [low high x, low high y, ..., N + M]
    strips = sums[1] - sums[0]
    share: Floats = (strips[1] - strips[0]).astype(np.float32) / area
    return share


@lru_cache(maxsize=64)
def _squares(robots: int, candidates: int, batch_axes: int) -> tuple[Ints, Floats]:
    """Edges of the squares in which cells are counted, from their middles [2, ..., N + M], and their cells [N + M]."""
    reach = np.repeat((WINDOW // 2, UNKNOWN_REACH), (robots, candidates))
    edges = np.stack([-reach, reach + 1]).reshape(2, *(1,) * batch_axes, -1)
    return edges, ((2 * reach + 1) ** 2).astype(np.float32)
