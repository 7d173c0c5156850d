"""The learned allocator: a network's scores, decoded by one small linear assignment over the graph.

Every robot of a graph solves the same assignment in the same order of ids, so that two robots with the same view never
take the same target. No robot goes without while a candidate that it can reach is free. A model that looks ahead also
reckons with robots that are out of range, and has frontiers among its candidates; for the others, a known target is
worth more than what may lie behind the frontier.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import lap
import numpy as np
import numpy.typing as npt

from gatar_edge.allocators.base import NO_TARGET, Allocation, Choices, in_id_order
from gatar_edge.config import AgentConfig
from gatar_edge.explore import FRONTIER_BLOCK
from gatar_edge.features import arrays_of, features_of
from gatar_edge.manifest import check_config
from gatar_edge.policy import Policy
from gatar_edge.types import Floats, RobotState, TaskKind
from gatar_edge.view import View, with_absent

IMPOSSIBLE = 1e6  # cost of a pair that must not be chosen
LEAST = 1e-9  # probability below which there is no difference
HABIT = 1.5  # log of how much more likely another candidate must be to be worth a change
UNWANTED = 1e3  # cost of going without: more than the least likely target


class Gatar:
    """Allocator over a model file; `config` makes the loader check that model and robot fit. Raises ModelError."""

    name = "gatar"

    def __init__(self, model: Path | None = None, config: AgentConfig | None = None) -> None:
        self.policy = Policy(model)
        if config is not None:
            check_config(self.policy.manifest, config, self.policy.path.name)

    def allocate(self, view: View) -> Allocation:
        """See `allocators.base.Allocator`. Raises ModelError when the network errs: fall back to a rule."""
        ahead = self.policy.manifest.looks_ahead
        whole = with_absent(view) if ahead else view
        arrays = arrays_of(whole, with_frontiers=ahead)
        inputs = features_of(arrays, self.policy.manifest.reads_windows)
        output = self.policy.run(inputs)
        places = arrays.targets[arrays.listed]
        possible = inputs["valid"][:, : len(places)] != 0
        scores = output.scores if len(places) == len(arrays.targets) else output.scores[:, [*range(len(places)), -1]]
        held = in_hand(whole, places) if ahead else None
        joint = decode(scores, possible, in_id_order(whole), held)
        count = len(view.targets)
        absent = view.absent if ahead else ()
        heard, unheard = _rows(whole.robots, absent)
        targets = np.where(joint < count, joint, NO_TARGET).astype(np.int32)
        x, y = view.robots[0].cell
        to_x, to_y = output.xy.tolist()
        return Allocation(
            choices=targets[heard],
            scores=np.where(possible, scores[:, :-1], -np.inf)[heard, :count].astype(np.float32),
            xy=(x + to_x, y + to_y),
            attention=tuple(output.attention[heard].tolist()),
            steady=ahead,
            frontier=(int(places[joint[0], 0]), int(places[joint[0], 1])) if joint[0] >= count else None,
            absent=absent,
            kept_for_absent=tuple(targets[unheard].tolist()),
        )


def _rows(robots: Sequence[RobotState], absent: Sequence[RobotState]) -> tuple[list[int] | slice, list[int]]:
    """Rows of those of `robots` that are heard, which is all where nobody is absent, and of those in `absent`."""
    if not absent:
        return slice(None), []
    row_of = {robot.robot_id: row for row, robot in enumerate(robots)}
    unheard = [row_of[robot.robot_id] for robot in absent]
    return [row for row in range(len(robots)) if row not in unheard], unheard


def in_hand(view: View, places: npt.NDArray[np.int64]) -> npt.NDArray[np.bool_]:
    """Which candidates [M, 2] the robots are on their way to: bool [N, M]; a frontier is the same in all its block."""
    same = np.zeros((len(view.robots), len(places)), dtype=np.bool_)
    count = len(view.targets)
    x, y = places.T
    for row, robot in enumerate(view.robots):
        to_x, to_y = robot.task_cell
        if robot.task is TaskKind.TARGET:
            same[row, :count] = (x[:count] == to_x) & (y[:count] == to_y)
        elif robot.task is TaskKind.EXPLORE:
            block_x, block_y = x[count:] // FRONTIER_BLOCK, y[count:] // FRONTIER_BLOCK
            same[row, count:] = (block_x == to_x // FRONTIER_BLOCK) & (block_y == to_y // FRONTIER_BLOCK)
    return same


def decode(
    scores: Floats,
    possible: npt.NDArray[np.bool_],
    order: npt.NDArray[np.int64],
    held: npt.NDArray[np.bool_] | None = None,
) -> Choices:
    """The most likely joint choice by scores [N, M + 1] (probabilities, last: no target) and possible [N, M]; rows are
    solved in `order`. What a robot is on its way to (`held` [N, M]) is worth `HABIT` more: plans that flip between
    equals would never arrive.
    """
    robots, count = possible.shape
    choices = np.full(robots, NO_TARGET, dtype=np.int32)
    if count == 0:
        return choices
    likely = np.log(np.maximum(scores.astype(np.float64), LEAST))
    if held is not None:
        likely[:, :-1] += HABIT * held
    cost = np.empty((robots, count + robots))
    cost[:, :count] = np.where(possible, -likely[:, :-1], IMPOSSIBLE)
    cost[:, count:] = (UNWANTED - likely[:, -1])[:, None]
    _, columns, _ = lap.lapjv(cost[order], extend_cost=True)
    for row, column in zip(order.tolist(), columns.tolist(), strict=False):  # behind them the rows of padding
        if column < count and possible[row, column]:
            choices[row] = column
    return choices
