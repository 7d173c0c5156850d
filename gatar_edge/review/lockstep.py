"""Flies agents on the true map, one cell a step, with a radio that reaches `r_comm` cells and loses nothing.

A review asks what would have happened otherwise: this takes agents in whatever state they are in and goes on from
there.
Two continuations of the same moment are compared with each other, never with the recorded flight.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np
from msgspec.structs import replace

from gatar_edge.agent import Agent
from gatar_edge.grid import UNREACHABLE, path_lengths
from gatar_edge.record import Recorder
from gatar_edge.sim_sitl.world import World, observe, reachable_targets
from gatar_edge.tasks import to_command
from gatar_edge.types import NS_PER_S, Cell, Decision, RobotKind, TaskKind

TALK_ROUNDS = 2  # a step, for allocators that talk to each other


@dataclass(slots=True)
class Lockstep:
    """A mission that can be stepped. `cells` holds the robots that still fly."""

    world: World
    agents: dict[int, Agent]
    cells: dict[int, Cell]
    r_comm: float
    open_targets: set[Cell]
    now_ns: int = 0
    step_ns: int = NS_PER_S
    steps: int = 0
    recorder: Recorder | None = None
    distance: dict[str, int] = field(default_factory=lambda: {"UAV": 0, "UGV": 0})
    visited_at: list[int] = field(default_factory=list)
    retasks: int = 0

    @classmethod
    def from_start(cls, world: World, agents: list[Agent], r_comm: float, recorder: Recorder | None = None) -> Lockstep:
        """A mission at its first step."""
        by_id = {agent.identity.robot_id: agent for agent in agents}
        reachable = {(int(x), int(y)) for x, y in reachable_targets(world)}
        mission = cls(world, by_id, dict(zip(by_id, world.starts, strict=True)), r_comm, reachable, recorder=recorder)
        if recorder is not None:
            recorder.truth_map(world.obstacles, world.targets, 0)
        return mission

    def drop_unreachable(self) -> None:
        """Close the targets that no robot can reach from where it is."""
        reached = np.zeros(self.world.shape, dtype=np.bool_)
        for number, cell in self.cells.items():
            reached |= path_lengths(self.agents[number].identity.kind, cell, ~self.world.obstacles) != UNREACHABLE
        self.open_targets = {cell for cell in self.open_targets if reached[cell]}

    def fly(self, max_steps: int) -> None:
        """Go on until every reachable target is localized or `max_steps` more have passed."""
        for _ in range(max_steps):
            if not self.open_targets:
                return
            self.step()

    def step(self) -> None:
        """Everybody looks, tells, decides and moves."""
        self._exchange()
        decisions = [self._decide(agent) for agent in self._flying()]
        self.steps += 1
        self.now_ns += self.step_ns
        for decision in decisions:
            self._move(decision)
        if self.recorder is not None:
            self.recorder.truth_positions([(i, float(x), float(y)) for i, (x, y) in self.cells.items()], self.now_ns)
            self.recorder.poll(self.now_ns)

    def _flying(self) -> list[Agent]:
        return [self.agents[robot_id] for robot_id in self.cells]

    def _exchange(self) -> None:
        air: list[tuple[int, bytes]] = []
        for agent in self._flying():
            robot_id = agent.identity.robot_id
            seen = observe(self.world, robot_id, self.cells[robot_id], agent.config.r_sense, self.now_ns)
            agent.observe(seen)
            message = agent.beacon(self.now_ns)
            air.append((robot_id, message))
            if self.recorder is not None:
                self.recorder.observation(seen)
                self.recorder.sent(robot_id, message, self.now_ns)
        while air:
            air = [relay for sender, datagram in air for relay in self._deliver(sender, datagram)]
        for _ in range(TALK_ROUNDS):
            talks = [(agent, talk) for agent in self._flying() for talk in agent.negotiate(self.now_ns)]
            for agent, talk in talks:
                if self.recorder is not None:
                    self.recorder.sent(agent.identity.robot_id, talk, self.now_ns)
            for agent, talk in talks:
                self._deliver(agent.identity.robot_id, talk)

    def _deliver(self, sender: int, datagram: bytes) -> list[tuple[int, bytes]]:
        """Everybody in range hears it; what they pass on."""
        relays = []
        for receiver, cell in self.cells.items():
            gap = np.subtract(cell, self.cells[sender])
            if receiver == sender or float(gap @ gap) > self.r_comm**2:
                continue
            heard = self.agents[receiver].hear(datagram, self.now_ns)
            if heard.relay is not None:
                relays.append((receiver, heard.relay))
            if self.recorder is not None:
                self.recorder.heard(receiver, datagram, heard.outcome.value, self.now_ns)
                if heard.relay is not None:
                    self.recorder.sent(receiver, heard.relay, self.now_ns)
        return relays

    def _decide(self, agent: Agent) -> Decision:
        start_ns = time.perf_counter_ns()
        decision = agent.decide(self.now_ns)
        decision = replace(decision, latency_ns=time.perf_counter_ns() - start_ns)
        self.retasks += decision.retask
        if self.recorder is not None:
            command = to_command(agent.identity.kind, decision.assignment)
            self.recorder.decision(decision, command, command, self.now_ns)
            self.recorder.belief(decision.robot_id, agent.belief, agent.config.grid, self.now_ns)
        return decision

    def _move(self, decision: Decision) -> None:
        robot_id = decision.robot_id
        cell = next_cell(decision, self.world)
        self.distance[self.world.team.kinds[robot_id - 1].name] += cell != self.cells[robot_id]
        self.cells[robot_id] = cell
        if cell in self.open_targets:
            self.open_targets.discard(cell)
            self.visited_at.append(self.steps)
            if self.recorder is not None:
                self.recorder.truth_visit(robot_id, cell, float(self.steps), self.now_ns)


def next_cell(decision: Decision, world: World) -> Cell:
    """One cell further along the path; a ground robot never enters an obstacle."""
    path, here = decision.assignment.path, decision.cell
    if decision.assignment.kind is TaskKind.HOLD or here not in path[:-1]:
        return here
    ahead = path[path.index(here) + 1]
    blocked = world.team.kinds[decision.robot_id - 1] is RobotKind.UGV and world.obstacles[ahead]
    return here if blocked else ahead
