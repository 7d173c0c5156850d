"""The routing rule compiled by numba: for teachers and evaluations, which plan millions of tours."""

from __future__ import annotations

from functools import cache
from types import FunctionType, SimpleNamespace
from typing import Any

import numpy as np

from gatar_edge.allocators import tours
from gatar_edge.allocators.routing import Planner, Tours
from gatar_edge.allocators.tours import Plan, Problem
from gatar_edge.errors import MissingExtraError


@cache
def compiled_tours() -> Any:
    """All functions of `allocators.tours`, compiled: the same text, so there is nothing to keep in step.

    Raises MissingExtraError without numba.
    """
    try:
        from gatar_edge.learn.jit import compiled
    except ImportError as error:
        raise MissingExtraError("planning thousands of tours", "learn", "numba") from error
    names = dict(vars(tours))  # where the compiled functions find each other
    for name, function in vars(tours).items():
        if isinstance(function, FunctionType) and function.__module__ == tours.__name__:
            names[name] = compiled(FunctionType(function.__code__, names, name))
    return SimpleNamespace(**names)


def compiled_planner() -> Planner:
    """The twin of `allocators.routing.plan_on_lists`. Raises MissingExtraError without numba."""
    solve = compiled_tours().solve

    def plan_on_arrays(problem: Problem, rounds: int) -> Tours:
        robots, targets = problem.first.shape
        plan = empty_plan(robots, targets)
        solve(problem, plan, rounds)
        return [plan.kept[robot, : plan.kept_count[robot]].tolist() for robot in range(robots)]

    return plan_on_arrays


def empty_plan(robots: int, targets: int) -> Plan:
    """Arrays for one problem."""
    return Plan(
        tour=np.zeros((robots, targets), dtype=np.int64),
        count=np.zeros(robots, dtype=np.int64),
        sums=np.zeros(robots),
        ends=np.zeros(robots),
        kept=np.zeros((robots, targets), dtype=np.int64),
        kept_count=np.zeros(robots, dtype=np.int64),
        removed=np.zeros(targets, dtype=np.int64),
    )
