"""Many missions of one team side by side, compiled: the worlds of `learn.episodes`, with decisions from outside."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from gatar_edge.learn.episodes import take_in
from gatar_edge.learn.jit import compiled
from gatar_edge.learn.kernels import FREE, OBSTACLE
from gatar_edge.learn.labels import NO_LABEL, NO_PLAN, VOTES, record
from gatar_edge.learn.memory import REMEMBER
from gatar_edge.learn.moves import move
from gatar_edge.learn.tuning.standing import STANDING, stand
from gatar_edge.learn.views import Group
from gatar_edge.sim_sitl.world import Team, random_world, reachable_targets

Array = npt.NDArray[Any]

HOP_LIMIT = 2
NEVER = 2**31  # step at which a robot dies that does not


@dataclass(frozen=True, slots=True)
class Conditions:
    """Of B missions of one team of N and one size of world; one row or number a mission."""

    team: Team
    size: int  # cells a side
    seeds: Sequence[int]  # of the worlds
    r_comm: Array  # float [B], cells
    r_sense: Array  # float [B], cells
    loss: Array  # float [B], share of messages
    speeds: Array  # float [B, kinds], cells a step
    deaths: Array  # int64 [B, N], step at which a robot falls silent and stands still, or NEVER

    def part(self, index: int, count: int) -> Conditions:
        """Every `count`-th of these missions, from the one with this index on."""
        chosen = slice(index, None, count)
        return Conditions(
            self.team, self.size, self.seeds[chosen], self.r_comm[chosen], self.r_sense[chosen], self.loss[chosen],
            self.speeds[chosen], self.deaths[chosen],
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class Moment:
    """One step of those missions that are not over."""

    active: Array  # int64 [A], which missions
    alive: Array  # bool [A, N], which robots
    group: Group  # their A team-steps, ready to be cut into views
    standing: Array  # float64 [A, STANDING], for the critic, who sees everything


class Missions:
    """Where B missions stand. One step is `moment`, a decision for every robot, and `act`."""

    def __init__(self, conditions: Conditions, luck: int) -> None:
        """`luck` seeds what is left to chance: lost messages, and ties of a robot that nobody told where to look."""
        team, size, count = conditions.team, conditions.size, len(conditions.seeds)
        worlds = [random_world(team, None, size, size, seed) for seed in conditions.seeds]
        robots = len(team.kinds)
        self._conditions = conditions
        self._kinds = np.array(team.kinds, dtype=np.int64)
        self._speeds = np.ascontiguousarray(conditions.speeds[:, self._kinds].astype(np.float64))
        self._obstacles = np.stack([world.obstacles for world in worlds])
        self._here = np.stack([_marked(world.targets, size) for world in worlds])
        survive = [[n + 1 for n in np.flatnonzero(deaths == NEVER).tolist()] for deaths in conditions.deaths]
        to_be_had = [reachable_targets(world, by) for world, by in zip(worlds, survive, strict=True)]
        self._left = np.stack([_marked(targets, size) for targets in to_be_had])
        self._truth = np.where(self._obstacles & ~self._here, OBSTACLE, FREE).astype(np.uint8)
        self._cells = np.array([world.starts for world in worlds], dtype=np.int64)
        self._own = np.zeros((count, robots, size, size), dtype=np.uint8)
        self._beliefs = np.zeros_like(self._own)
        self._ears = np.full((count, robots, robots), -1, dtype=np.int64)
        self._heard = np.full((count, robots, robots), -1, dtype=np.int64)
        self._last = np.full((count, robots, robots, 4), -1, dtype=np.int64)
        self._tasks = np.full((count, robots, 2), -1, dtype=np.int64)
        self._way = np.zeros((count, robots))
        self.over = np.zeros(count, dtype=np.bool_)
        self.steps = np.zeros(count, dtype=np.int64)  # taken by each mission
        self.step = 0
        _seed(luck)

    @property
    def robots(self) -> int:
        """Of a team."""
        return len(self._kinds)

    def moment(self) -> Moment:
        """Everybody looks and tells; then this is what the robots know."""
        conditions, active, robots = self._conditions, np.flatnonzero(~self.over), self.robots
        dead = conditions.deaths[active] <= self.step
        size, count = conditions.size, len(active)
        packed = np.zeros((count, robots, -(-3 * size * size // 8)), dtype=np.uint8)
        rows = np.zeros((count, robots, 8), dtype=np.uint8)
        known = np.zeros((count, robots, robots, 3), dtype=np.uint8)
        told = np.zeros((count, robots, robots, 2), dtype=np.uint8)
        standing = np.zeros((count, STANDING))
        _take_in(
            active, dead, self.step, self._obstacles, self._here, self._truth, self._kinds, self._speeds, self._cells,
            self._tasks, conditions.r_sense, conditions.r_comm, conditions.loss, self._own, self._left, self._ears,
            self._heard, self._last, self._beliefs, packed, rows, known, told, standing,
        )  # fmt: skip
        votes = np.full((count, robots, VOTES, 3), NO_LABEL, dtype=np.uint8)
        plans = np.full((count, robots, robots), NO_PLAN, dtype=np.uint8)
        r_comm = conditions.r_comm[active].astype(np.float32)
        group = Group(conditions.team, size, packed, rows, known, votes, plans, r_comm, HOP_LIMIT, True, told)
        return Moment(active, ~dead, group, standing)

    def act(self, active: Array, goals: Array) -> None:
        """All who live in the missions `active` [A] go one step to their goals: int64 [A, N, 2], (-1, -1) for none."""
        alive = self._conditions.deaths[active] > self.step
        _act(
            active, self._obstacles, self._kinds, self._speeds[active] * alive, goals, self._beliefs, self._way,
            self._cells, self._own, self._left, self._tasks, self.over,
        )  # fmt: skip
        self.step += 1
        self.steps[active] = self.step


def _marked(cells: Array, size: int) -> Array:
    grid = np.zeros((size, size), dtype=np.bool_)
    grid[cells[:, 0], cells[:, 1]] = True
    return grid


@compiled
def _seed(luck: int) -> None:
    np.random.seed(luck)


@compiled
def _take_in(
    active: Array, dead: Array, step: int, obstacles: Array, here: Array, truth: Array, kinds: Array, speeds: Array,
    cells: Array, tasks: Array, r_sense: Array, r_comm: Array, loss: Array, own: Array, left: Array, ears: Array,
    heard: Array, last: Array, beliefs: Array, packed: Array, rows: Array, known: Array, told: Array, standing: Array,
) -> None:  # fmt: skip
    hops = np.empty((len(kinds), len(kinds)), dtype=np.int64)
    nowhere = np.full((len(kinds), 2), -1, dtype=np.int64)
    for a in range(len(active)):
        b = active[a]
        take_in(
            obstacles[b], here[b], kinds, speeds[b], cells[b], dead[a], tasks[b], r_sense[b], r_comm[b], HOP_LIMIT,
            loss[b], REMEMBER, step, own[b], left[b], hops, ears[b], heard[b], last[b], beliefs[b], packed[a], known[a],
        )  # fmt: skip
        record(beliefs[b], cells[b], tasks[b], speeds[b], nowhere, rows[a])
        for n in range(len(kinds)):
            for m in range(len(kinds)):
                goal = tasks[b, n] if m == n else last[b, n, m, 2:]
                told[a, n, m, 0], told[a, n, m, 1] = goal[0] & 255, goal[1] & 255
        alive = np.flatnonzero(~dead[a])
        stand(
            truth[b], left[b], beliefs[b][alive], kinds[alive], speeds[b][alive], cells[b][alive], r_comm[b], loss[b],
            standing[a],
        )  # fmt: skip


@compiled
def _act(
    active: Array, obstacles: Array, kinds: Array, speeds: Array, goals: Array, beliefs: Array, way: Array,
    cells: Array, own: Array, left: Array, tasks: Array, over: Array,
) -> None:  # fmt: skip
    for a in range(len(active)):
        b = active[a]
        tasks[b][:] = goals[a]
        move(obstacles[b], kinds, speeds[a], goals[a], beliefs[b], way[b], cells[b], own[b], left[b])
        over[b] = not left[b].any()
