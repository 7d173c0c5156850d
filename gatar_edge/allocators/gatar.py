"""The learned allocator: a network's scores, decoded by one small linear assignment over the graph.

Every robot of a graph solves the same assignment in the same order of ids, so that two robots with the same view never
take the same target. No robot goes without while a target that it can reach is free: a known target is worth more than
what may lie behind the frontier.
"""

from __future__ import annotations

from pathlib import Path

import lap
import numpy as np
import numpy.typing as npt

from gatar_edge.allocators.base import NO_TARGET, Allocation, Choices, in_id_order
from gatar_edge.config import AgentConfig
from gatar_edge.features import features
from gatar_edge.grid import UNREACHABLE
from gatar_edge.manifest import check_config
from gatar_edge.policy import Policy
from gatar_edge.types import Floats
from gatar_edge.view import View

IMPOSSIBLE = 1e6  # cost of a pair that must not be chosen
LEAST = 1e-9  # probability below which there is no difference
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
        output = self.policy.run(features(view))
        count = len(view.targets)
        possible = view.lengths != UNREACHABLE
        x, y = view.robots[0].cell
        return Allocation(
            choices=decode(output.scores[:, [*range(count), -1]], possible, in_id_order(view)),
            scores=np.where(possible, output.scores[:, :count], -np.inf).astype(np.float32),
            xy=(x + float(output.xy[0]), y + float(output.xy[1])),
            attention=tuple(float(share) for share in output.attention),
        )


def decode(scores: Floats, possible: npt.NDArray[np.bool_], order: npt.NDArray[np.int64]) -> Choices:
    """The most likely joint choice by scores [N, M + 1] (probabilities, last: no target) and possible [N, M]; rows are
    solved in `order`.
    """
    robots, count = possible.shape
    choices = np.full(robots, NO_TARGET, dtype=np.int32)
    if count == 0:
        return choices
    likely = np.log(np.maximum(scores.astype(np.float64), LEAST))
    cost = np.empty((robots, count + robots))
    cost[:, :count] = np.where(possible, -likely[:, :-1], IMPOSSIBLE)
    cost[:, count:] = (UNWANTED - likely[:, -1])[:, None]
    _, columns, _ = lap.lapjv(cost[order], extend_cost=True)
    chosen = np.asarray(columns)[: len(order)]
    choices[order] = np.where(chosen < count, chosen, NO_TARGET)
    choices[(choices != NO_TARGET) & ~possible[np.arange(robots), choices]] = NO_TARGET
    return choices
