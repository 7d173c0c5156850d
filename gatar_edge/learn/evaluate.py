"""Table 2 of the paper on our own worlds: how far from the expert's target is what a rule gives each robot.

Each rule decides on the robot's own K-hop view; the label is the central expert's, who knows what all robots know.
Where a rule gives a robot nothing, its best-scored candidate counts, and its own cell where it knows none: every rule
answers for every labelled robot.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from gatar_edge.allocators.base import NO_TARGET, Allocation, Allocator
from gatar_edge.errors import ConfigError
from gatar_edge.learn.dataset import LONGEST_EPISODE, STEP_DTYPE
from gatar_edge.learn.episodes import episode
from gatar_edge.learn.labels import NO_LABEL, VOTES
from gatar_edge.learn.moves import DRIVEN_BY_EXPERT
from gatar_edge.learn.plans import GREEDY
from gatar_edge.learn.views import Batch, Group, batch_of
from gatar_edge.sim_sitl.world import VALIDATION_SEEDS, Team, random_world
from gatar_edge.types import NS_PER_S, RobotKind, RobotState, TaskKind
from gatar_edge.view import View, known

TEST_SEEDS = VALIDATION_SEEDS  # seeds below are for tests
SAMPLES_PER_WORLD = 20  # of about 90: samples of one world are alike
CHUNK = 64  # views built together


@dataclass(frozen=True, slots=True)
class Conditions:
    """Which worlds, and how many labelled robots in them."""

    team: str = "6A6G"
    samples: int = 3000
    seed: int = 0
    size: int = 15
    r_sense: float = 4.0
    r_comm: float = 6.0
    hop_limit: int = 2


@dataclass(frozen=True, slots=True)
class Distances:
    """Cells between a rule's target and the expert's."""

    mean: float
    median: float
    p90: float
    exact: float  # share of equal targets
    samples: int

    def to_json(self) -> dict[str, Any]:
        """For machines."""
        return {
            "mean": round(self.mean, 4), "median": round(self.median, 4), "p90": round(self.p90, 4),
            "exact": round(self.exact, 4), "samples": self.samples,
        }  # fmt: skip


@dataclass(frozen=True, slots=True)
class Score:
    """One rule's distances: over all labels, and over those whose target the robot can know of."""

    every: Distances
    knowable: Distances


BatchRule = Callable[[Batch], list[Allocation]]  # decides on all views of a batch at once


def evaluate(
    rules: Mapping[str, Allocator],
    conditions: Conditions,
    progress: Callable[[float, str], None] = lambda share, t: None,
    batch_rules: Mapping[str, BatchRule] | None = None,
) -> dict[str, Score]:
    """Score each rule on the same samples; NAME_xy is added where the rule NAME gives x-y."""
    group = worlds(conditions)
    labelled = np.flatnonzero(group.robots[..., 2].ravel() != NO_LABEL)
    rng = np.random.default_rng(conditions.seed)
    chosen = rng.permutation(labelled)[: conditions.samples]
    batch_rules = batch_rules or {}
    gaps: dict[str, list[float]] = {key: [] for name in (*rules, *batch_rules) for key in (name, f"{name}_xy")}
    knowable: list[bool] = []
    for first in range(0, len(chosen), CHUNK):
        batch = batch_of(group, chosen[first : first + CHUNK])
        knowable.extend(batch.knowable.tolist())
        together = {name: rule(batch) for name, rule in batch_rules.items()}
        for index in range(len(batch.chosen)):
            view, wanted = view_at(batch, index), batch.chosen[index, 2:4].astype(np.float64)
            for name, rule in rules.items():
                _judge(name, view, rule.allocate(view), wanted, gaps)
            for name, allocations in together.items():
                _judge(name, view, allocations[index], wanted, gaps)
        progress(min(1.0, (first + CHUNK) / len(chosen)), f"{len(knowable)} samples")
    known = np.array(knowable)
    return {
        name: Score(_distances(np.array(gap)), _distances(np.array(gap)[known])) for name, gap in gaps.items() if gap
    }


def worlds(conditions: Conditions) -> Group:
    """Enough episodes, driven by the expert, in worlds of the test range from `seed` on.

    Raises ConfigError where the expert has nothing to give in the first ones: it would have nothing in any.
    """
    team = Team.parse(conditions.team)
    kinds = np.array(team.kinds, dtype=np.int64)
    parts: list[tuple[npt.NDArray[np.uint8], ...]] = []
    count = max(8, -(-conditions.samples // SAMPLES_PER_WORLD))
    labelled = 0
    robots = len(kinds)
    while len(parts) < count or labelled < conditions.samples:
        seed = (conditions.seed + len(parts)) % TEST_SEEDS
        world = random_world(team, None, conditions.size, conditions.size, seed)
        shapes = ((robots, -(-3 * conditions.size**2 // 8)), (robots, 8), (robots, robots, 3), (robots, VOTES, 3),
                  (robots, robots))  # fmt: skip
        arrays = [np.zeros((LONGEST_EPISODE, *shape), dtype=np.uint8) for shape in shapes]
        steps = episode(
            world.obstacles, world.targets.astype(np.int64), np.array(world.starts, dtype=np.int64), kinds,
            np.ones(len(kinds)), float(conditions.r_sense), float(conditions.r_comm), conditions.hop_limit, 0.0, GREEDY,
            DRIVEN_BY_EXPERT, seed, *arrays,
        )  # fmt: skip
        labelled += int((arrays[1][:steps, :, 2] != NO_LABEL).sum())
        parts.append(tuple(array[:steps] for array in arrays))
        if len(parts) == count and labelled == 0:
            raise ConfigError(f"r_sense {conditions.r_sense:g}: in {count} worlds, no robot ever knows of a target")
    beliefs, rows, known, votes, plans = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    r_comm = np.full(len(rows), conditions.r_comm, dtype=STEP_DTYPE["r_comm"])
    return Group(team, conditions.size, beliefs, rows, known, votes, plans, r_comm, conditions.hop_limit)


def view_at(batch: Batch, index: int) -> View:
    """One view of a batch as the robot would have it."""
    arrays = batch.view
    rows = np.flatnonzero(arrays.present[index])
    robots = tuple(
        RobotState(
            int(arrays.ids[index, row]),
            RobotKind(int(arrays.kinds[index, row])),
            (int(arrays.robots[index, row, 0]), int(arrays.robots[index, row, 1])),
            float(arrays.speeds[index, row]),
            TaskKind.TARGET if arrays.tasks[index, row, 0] >= 0 else TaskKind.HOLD,
            (int(arrays.tasks[index, row, 0]), int(arrays.tasks[index, row, 1])),
            int(arrays.ages_s[index, row] * NS_PER_S),
        )
        for row in rows
    )
    targets = arrays.targets[index, arrays.listed[index]].astype(np.int16)
    distances = arrays.distances[index, rows]
    hops = arrays.hops[index][np.ix_(rows, rows)].astype(np.int8)
    lengths = distances[:, targets[:, 0], targets[:, 1]]
    return View(0, robots, known(hops), arrays.belief[index], targets, distances, lengths)


def _judge(
    name: str, view: View, allocation: Allocation, wanted: npt.NDArray[np.float64], gaps: dict[str, list[float]]
) -> None:
    gaps[name].append(float(np.hypot(*(_answer(view, allocation) - wanted))))
    if allocation.xy is not None:
        gaps[f"{name}_xy"].append(float(np.hypot(*(np.array(allocation.xy) - wanted))))


def _answer(view: View, allocation: Allocation) -> npt.NDArray[np.float64]:
    choice = int(allocation.choices[0])
    if choice == NO_TARGET and np.isfinite(allocation.scores[0]).any():
        choice = int(allocation.scores[0].argmax())
    answer = np.array(view.robots[0].cell) if choice == NO_TARGET else view.targets[choice]
    return answer.astype(np.float64)


def _distances(gaps: npt.NDArray[np.float64]) -> Distances:
    if not len(gaps):
        return Distances(0.0, 0.0, 0.0, 1.0, 0)
    return Distances(
        float(gaps.mean()), float(np.median(gaps)), float(np.quantile(gaps, 0.9)), float((gaps < 0.5).mean()), len(gaps)
    )
