"""A mission on the bare grid: real agents and real messages, but ideal vehicles that move one cell a step.

Thousands of missions for comparing allocators; `fleet` flies the same agents with autopilots and physics.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
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
    deaths: Mapping[int, int] = field(default_factory=dict)  # step at which a robot id falls silent and stands still


def fly(
    mission: GridMission,
    allocator: Callable[[], Allocator],
    watch: Callable[[int, Mapping[int, Cell]], None] = lambda step, cells: None,
) -> Result:
    """Fly until every reachable target is localized or `max_steps` have passed; deterministic but for latencies.

    `watch` is told, after each step and once before the first, where each robot that lives is, by id.
    """
    world = mission.world
    agents = {
        robot_id: Agent(Identity(robot_id, kind, 1.0), mission.config, allocator(), DEMO_KEY)
        for robot_id, kind in zip(world.team.ids, world.team.kinds, strict=True)
    }
    radio = Radio(mission.config.r_comm, mission.radio, world.seed)
    cells: dict[int, Cell] = dict(zip(world.team.ids, world.starts, strict=True))
    tally = Tally(world, agents[world.team.ids[0]].allocator.name)
    step = 0
    watch(step, cells)
    while tally.left and agents and step < mission.max_steps:
        now_ns = step * STEP_NS
        for robot_id in [one for one in agents if mission.deaths.get(one, mission.max_steps) <= step]:
            del agents[robot_id], cells[robot_id]
        exchange(agents, radio, cells, mission, now_ns, tally)
        decisions = {robot_id: _decide(agent, now_ns, tally) for robot_id, agent in agents.items()}
        tally.decided_together(list(decisions.values()))
        step += 1
        for robot_id, decision in decisions.items():
            cell = next_cell(decision, world)
            tally.travel(world.team.kinds[robot_id - 1], float(cell != cells[robot_id]))
            cells[robot_id] = cell
            tally.visit(cell, step)
        watch(step, cells)
    return tally.result(step)


def exchange(
    by_id: Mapping[int, Agent],
    radio: Radio,
    positions: Mapping[int, Cell],
    mission: GridMission,
    now_ns: int,
    tally: Tally,
) -> None:
    """Everybody looks and tells; what is heard is passed on at once. Then allocators that talk have their rounds."""

    def send(sender: int, datagram: bytes) -> None:
        tally.sent(datagram)
        radio.send(now_ns, sender, datagram, positions)

    def deliver() -> None:
        while deliveries := radio.deliver(now_ns):
            for receiver, datagram in deliveries:
                if receiver not in by_id:
                    continue  # it died while the message was on its way
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
