"""The compiled routing rule is the robot's own."""

from __future__ import annotations

import numpy as np
import pytest

from gatar_edge.allocators.routing import plan_on_lists
from gatar_edge.allocators.tours import Problem

pytest.importorskip("numba")

from gatar_edge.learn.compiled import compiled_planner

pytestmark = pytest.mark.usefixtures("compiled")


def random_problem(seed: int) -> Problem:
    rng = np.random.default_rng(seed)
    robots, targets = int(rng.integers(1, 9)), int(rng.integers(0, 15))
    first = rng.integers(1, 20, (robots, targets)) / rng.choice([1.0, 1.5, 3.0], (robots, 1))
    legs = rng.integers(1, 20, (2, targets, targets)).astype(float)
    first[rng.random(first.shape) < 0.1] = np.inf
    legs[rng.random(legs.shape) < 0.1] = np.inf
    return Problem(first, legs, rng.integers(0, 2, robots), 1 / rng.choice([1.0, 1.5, 3.0], robots))


@pytest.mark.parametrize("seed", range(12))
def test_compiled_tours_equal_those_of_the_robot(seed: int) -> None:
    problem = random_problem(seed)
    assert compiled_planner()(problem, 60) == plan_on_lists(problem, 60)
