"""What would have happened otherwise: goes on from a recorded moment twice, as it was and changed, and compares.

The agents are brought to the moment by a replay, so that they know what they knew. From there both continuations fly in
lock-step on the true map, with ideal vehicles and a radio without loss: they are fair to each other, and say nothing
about the recorded flight's own end. Needs a log with the simulator's truth.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import msgspec
import numpy as np

from gatar_edge import channels as ch
from gatar_edge import foxglove
from gatar_edge.agent import Agent
from gatar_edge.allocators.base import Allocator
from gatar_edge.errors import ConfigError, LogError
from gatar_edge.review.company import Json
from gatar_edge.review.info import read_figures
from gatar_edge.review.lockstep import Lockstep
from gatar_edge.review.reader import LogReader, decoder
from gatar_edge.review.replay import Replay
from gatar_edge.review.story import mission_start_ns
from gatar_edge.sim_sitl.world import Team, World
from gatar_edge.types import NS_PER_S, BoolGrid, Cell, Cells, CellState, RobotKind

MAX_STEPS = 1000

_positions = decoder(ch.PositionsRecord)
_visit = decoder(ch.VisitRecord)
_observation = decoder(ch.ObservationRecord)


@dataclass(frozen=True, slots=True)
class Change:
    """What is to be different from `from_s` on."""

    from_s: float = 0.0
    drop_robots: tuple[int, ...] = ()
    r_comm: float | None = None
    allocator: Callable[[], Allocator] | None = None


@dataclass(slots=True)
class _Truth:
    """What the simulator's truth was at the moment."""

    obstacles: BoolGrid | None = None
    targets: Cells | None = None
    cells: dict[int, Cell] = field(default_factory=dict)
    visited: set[Cell] = field(default_factory=set)


def what_if(log: LogReader, make: Callable[[str], Allocator], change: Change, max_steps: int = MAX_STEPS) -> Json:
    """The figures of both continuations.

    Raises LogError where the log lacks the truth, ConfigError for robots that are not in it.
    """
    as_it_was = _continue(log, make, Change(change.from_s), max_steps)
    changed = _continue(log, make, change, max_steps)
    return {"from_s": change.from_s, "as_it_was": as_it_was, "changed": changed}


def _continue(log: LogReader, make: Callable[[str], Allocator], change: Change, max_steps: int) -> Json:
    agents, truth, now_ns = _moment(log, make, change.from_s)
    if truth.obstacles is None or truth.targets is None or not truth.cells:
        raise LogError(f"log {log.path} has no truth of a simulator before {change.from_s:g} s: nothing to go on from")
    missing = sorted(set(change.drop_robots) - set(agents))
    if missing or len(change.drop_robots) >= len(agents):
        known = ", ".join(map(str, sorted(agents)))
        raise ConfigError(f"cannot leave out robots {list(change.drop_robots)} of {known}: name some that fly, not all")
    flying = {number: agent for number, agent in sorted(agents.items()) if number not in change.drop_robots}
    mission = Lockstep(
        world=_world(agents, truth),
        agents=flying,
        cells={number: truth.cells[number] for number in flying},
        r_comm=change.r_comm if change.r_comm is not None else next(iter(agents.values())).config.r_comm,
        open_targets={(int(x), int(y)) for x, y in truth.targets} - truth.visited,
        now_ns=now_ns,
    )
    for agent in flying.values():
        agent.config = msgspec.structs.replace(agent.config, r_comm=mission.r_comm)
        if change.allocator is not None:
            agent.allocator = change.allocator()
    before = len(mission.open_targets)
    if not before:
        raise LogError(f"log {log.path} has no open target at {change.from_s:g} s: give an earlier moment with --from")
    mission.drop_unreachable()
    reachable = len(mission.open_targets)
    mission.fly(max_steps)
    return _figures(mission, before, reachable)


def _figures(mission: Lockstep, before: int, reachable: int) -> Json:
    visited = mission.visited_at
    return {
        "robots": sorted(mission.cells),
        "open_targets": before,
        "reachable": reachable,
        "localized": len(visited),
        "localized_by": {str(step): sum(at <= step for at in visited) for step in (10, 20, 40)},
        "steps_100": visited[-1] if visited and len(visited) == reachable else (0 if reachable == 0 else None),
        "distance_cells": dict(mission.distance),
        "retasks": mission.retasks,
    }


def _moment(log: LogReader, make: Callable[[str], Allocator], from_s: float) -> tuple[dict[int, Agent], _Truth, int]:
    """All agents as they were, the truth, and the time: after the last decision before the moment."""
    until_ns = mission_start_ns(read_figures(log)) + round(from_s * NS_PER_S)
    replay, truth, moved = Replay(make), _Truth(), False
    for entry in log.messages():
        if entry.log_ns > until_ns and entry.channel is not ch.TRUTH_MAP:
            break
        replay.feed(entry)
        if entry.channel is ch.TRUTH_MAP and truth.obstacles is None:
            states = foxglove.read_grid(entry.data).cells
            truth.obstacles = states == CellState.OBSTACLE
            truth.targets = np.argwhere(states == CellState.TARGET).astype(np.int16)
        elif entry.channel is ch.TRUTH_ROBOTS:
            moved = True
            truth.cells = {robot.robot_id: (round(robot.x), round(robot.y)) for robot in _positions(entry.data).robots}
        elif entry.channel is ch.TRUTH_VISITS:
            truth.visited.add(tuple(_visit(entry.data).cell))
        elif entry.channel is ch.OBSERVATION and not moved:
            truth.cells[entry.robot_id] = _observation(entry.data).cell
    return {number: ghost.agent for number, ghost in replay.ghosts.items()}, truth, until_ns


def _world(agents: dict[int, Agent], truth: _Truth) -> World:
    """The true world; the kinds by robot number, as `World` counts them."""
    assert truth.obstacles is not None
    assert truth.targets is not None
    kinds = tuple(
        agents[number].identity.kind if number in agents else RobotKind.UAV for number in range(1, max(agents) + 1)
    )
    starts = tuple(truth.cells.get(number, (0, 0)) for number in range(1, max(agents) + 1))
    return World(truth.obstacles, truth.targets, starts, Team(kinds), seed=0)
