"""A mission on the bare grid: real agents and real messages, but ideal vehicles that move one cell a step.

Thousands of missions for comparing allocators; `fleet` flies the same agents with autopilots and physics.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

from gatar_edge.agent import Agent, Identity
from gatar_edge.allocators.base import Allocator
from gatar_edge.config import AgentConfig
from gatar_edge.keys import DEMO_KEY
from gatar_edge.sim_sitl.faults import LinkFaults
from gatar_edge.sim_sitl.radio import Radio
from gatar_edge.sim_sitl.tally import Result, Tally
from gatar_edge.sim_sitl.world import World, observe
from gatar_edge.types import NS_PER_S, Cell, Decision, RobotKind, TaskKind

STEP_NS = NS_PER_S


@dataclass(frozen=True, slots=True)
class GridMission:
    """What is flown: a world, the team's configuration, and the radio's weather."""

    world: World
    config: AgentConfig
    radio: LinkFaults = field(default_factory=LinkFaults)
    max_steps: int = 500
    rounds: int = 3  # of messages between allocators that talk, in each step


def fly(mission: GridMission, allocator: Callable[[], Allocator]) -> Result:
    """Fly until every reachable target is localized or `max_steps` have passed; deterministic but for latencies."""
    world = mission.world
    agents = [
        Agent(Identity(robot_id, kind, 1.0), mission.config, allocator(), DEMO_KEY)
        for robot_id, kind in zip(world.team.ids, world.team.kinds, strict=True)
    ]
    radio = Radio(mission.config.r_comm, mission.radio, world.seed)
    cells: list[Cell] = list(world.starts)
    tally = Tally(world, agents[0].allocator.name)
    step = 0
    while tally.left and step < mission.max_steps:
        now_ns = step * STEP_NS
        exchange(agents, radio, cells, mission, now_ns, tally)
        decisions = [_decide(agent, now_ns, tally) for agent in agents]
        tally.decided_together(decisions)
        step += 1
        for index, decision in enumerate(decisions):
            cell = next_cell(decision, world)
            tally.travel(world.team.kinds[index], float(cell != cells[index]))
            cells[index] = cell
            tally.visit(cell, step)
    return tally.result(step)


def exchange(
    agents: list[Agent], radio: Radio, cells: list[Cell], mission: GridMission, now_ns: int, tally: Tally
) -> None:
    """Everybody looks and tells; what is heard is passed on at once. Then allocators that talk have their rounds."""
    positions = {agent.identity.robot_id: cell for agent, cell in zip(agents, cells, strict=True)}
    by_id = {agent.identity.robot_id: agent for agent in agents}

    def send(sender: int, datagram: bytes) -> None:
        tally.sent(datagram)
        radio.send(now_ns, sender, datagram, positions)

    def deliver() -> None:
        while deliveries := radio.deliver(now_ns):
            for receiver, datagram in deliveries:
                relay = by_id[receiver].hear(datagram, now_ns).relay
                if relay is not None:
                    send(receiver, relay)

    for robot_id, agent in by_id.items():
        agent.observe(observe(mission.world, robot_id, positions[robot_id], mission.config.r_sense, now_ns))
        send(robot_id, agent.beacon(now_ns))
    deliver()
    for _ in range(mission.rounds):
        talks = [(robot_id, datagram) for robot_id, agent in by_id.items() for datagram in agent.negotiate(now_ns)]
        for robot_id, datagram in talks:
            send(robot_id, datagram)
        deliver()


def next_cell(decision: Decision, world: World) -> Cell:
    """One cell further along the path; a ground robot never enters an obstacle."""
    path, here = decision.assignment.path, decision.cell
    if decision.assignment.kind is TaskKind.HOLD or here not in path[:-1]:
        return here
    ahead = path[path.index(here) + 1]
    blocked = world.team.kinds[decision.robot_id - 1] is RobotKind.UGV and world.obstacles[ahead]
    return here if blocked else ahead


def _decide(agent: Agent, now_ns: int, tally: Tally) -> Decision:
    start_ns = time.perf_counter_ns()
    decision = agent.decide(now_ns)
    tally.decided(decision, time.perf_counter_ns() - start_ns)
    return decision
