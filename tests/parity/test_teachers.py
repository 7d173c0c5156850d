"""The compiled teacher labels a view as the rule on the robot decides it."""

from __future__ import annotations

import numpy as np
import pytest

from gatar_edge.allocators.routing import Routing
from gatar_edge.types import CellState, RobotKind, RobotState
from gatar_edge.view import View, build_view

pytest.importorskip("numba")

from gatar_edge.learn.teachers import routing_labels

pytestmark = pytest.mark.usefixtures("compiled")

ROUNDS = 40
MOST_ROBOTS, MOST_TARGETS = 8, 16


def random_view(seed: int) -> View:
    rng = np.random.default_rng(seed)
    belief = rng.choice(np.array([0, 1, 1, 2], dtype=np.uint8), (15, 12))
    cells = rng.permutation(belief.size)
    count = int(rng.integers(1, MOST_ROBOTS + 1))
    belief.flat[cells[count : count + int(rng.integers(0, MOST_TARGETS + 1))]] = CellState.TARGET
    team = [
        RobotState(
            n + 1, RobotKind(int(rng.integers(2))), (int(cells[n] // 12), int(cells[n] % 12)), float(rng.integers(1, 4))
        )
        for n in range(count)
    ]
    return build_view(0, team[0], team[1:], belief, 6.0, 2, 64)


def test_labels_of_a_batch_are_the_choices_of_the_rule() -> None:
    views = [random_view(seed) for seed in range(24)]
    size = len(views)
    lengths = np.full((size, MOST_ROBOTS, MOST_TARGETS), -1, dtype=np.int32)
    targets = np.zeros((size, MOST_TARGETS, 2), dtype=np.int64)
    counts, kinds = np.zeros((size, 2), dtype=np.int64), np.zeros((size, MOST_ROBOTS), dtype=np.int64)
    speeds, labels = np.ones((size, MOST_ROBOTS)), np.zeros((size, MOST_ROBOTS), dtype=np.int64)
    for b, view in enumerate(views):
        robots, count = view.lengths.shape
        counts[b] = robots, count
        lengths[b, :robots, :count] = view.lengths
        targets[b, :count] = view.targets
        kinds[b, :robots] = [robot.kind for robot in view.robots]
        speeds[b, :robots] = [robot.speed_cells_s for robot in view.robots]
    routing_labels(np.stack([v.belief for v in views]), lengths, targets, counts, kinds, speeds, ROUNDS, labels)
    for b, view in enumerate(views):
        chosen = Routing(rounds=ROUNDS).allocate(view).choices
        assert labels[b, : len(chosen)].tolist() == chosen.tolist()
        assert (labels[b, len(chosen) :] == -1).all()
