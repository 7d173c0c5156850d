"""Missions on the bare grid: every rule finishes, and the same inputs give the same mission."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from gatar_edge.agent import Agent, Identity, Inbox
from gatar_edge.allocators.registry import NAMES, make
from gatar_edge.config import AgentConfig
from gatar_edge.keys import DEMO_KEY
from gatar_edge.sim_sitl.faults import LinkFaults
from gatar_edge.sim_sitl.grid_mission import GridMission, fly
from gatar_edge.sim_sitl.tally import Result, Tally
from gatar_edge.sim_sitl.world import Team, observe, random_world
from gatar_edge.types import GridSpec, RobotKind

RULES = [name for name in NAMES if name != "gatar"]
SIZE = 10


def flown(rule: str, team: str, seed: int, loss: float = 0.0, max_steps: int = 300) -> Result:
    world = random_world(Team.parse(team), 8, SIZE, SIZE, seed)
    config = AgentConfig(grid=GridSpec(width=SIZE, height=SIZE))
    return fly(GridMission(world, config, LinkFaults(loss=loss), max_steps), make(rule))


@pytest.mark.parametrize("team", ["1A1G", "3A3G", "6A6G", "0A2G", "2A0G"])
@pytest.mark.parametrize("rule", RULES)
def test_every_rule_localizes_all_that_the_team_can_reach(rule: str, team: str) -> None:
    result = flown(rule, team, seed=RULES.index(rule), loss=0.3 * (len(rule) % 2))
    assert result.localized == result.reachable
    assert result.fallbacks == 0


@pytest.mark.parametrize("rule", RULES)
def test_same_seed_gives_the_same_decisions(rule: str) -> None:
    one, other = flown(rule, "2A1G", 5, loss=0.3), flown(rule, "2A1G", 5, loss=0.3)
    assert one.digest == other.digest
    assert one.localized_at == other.localized_at


def test_auction_pays_for_its_talk_in_bytes() -> None:
    assert flown("cbba", "2A2G", 3).message_bytes > 1.5 * flown("greedy", "2A2G", 3).message_bytes


def test_team_that_looks_at_itself_is_faster_than_everybody_alone() -> None:
    steps = {rule: np.mean([flown(rule, "2A2G", seed).steps for seed in range(8)]) for rule in ("random", "hungarian")}
    assert steps["hungarian"] < 0.9 * steps["random"]


def test_chasing_what_lies_behind_walls_is_counted() -> None:
    world = random_world(Team.parse("0A1G"), 2, 5, 5, 1)
    obstacles = np.zeros((5, 5), dtype=np.bool_)
    obstacles[2, :] = True
    walled = replace(world, obstacles=obstacles, targets=np.array([[0, 4], [4, 4]], dtype=np.int16), starts=((0, 0),))
    config = AgentConfig(grid=GridSpec(width=5, height=5), r_sense=1.0)
    tally = Tally(walled, "greedy")
    seen = observe(walled, 1, (0, 0), 1.0, 0)
    for target in (walled.targets[:1], walled.targets[1:]):
        agent = Agent(Identity(1, RobotKind.UGV, 1.0), config, make("greedy")(), DEMO_KEY)
        tally.decided(agent.tick(0, Inbox(msgspec.structs.replace(seen, targets=target))).decision, 0)
    assert tally.unreachable == 1


@pytest.mark.sweep
@pytest.mark.parametrize("loss", [0.0, 0.3])
@pytest.mark.parametrize("team", ["1A1G", "3A3G", "6A6G", "0A2G", "2A0G"])
@pytest.mark.parametrize("rule", RULES)
def test_no_rule_stalls_on_the_worlds_of_the_demonstration(rule: str, team: str, loss: float) -> None:
    for seed in range(1, 61):
        world = random_world(Team.parse(team), None, 15, 15, seed)
        result = fly(GridMission(world, AgentConfig(), LinkFaults(loss=loss)), make(rule))
        assert result.localized == result.reachable, f"seed {seed}"


def test_dead_robots_stand_still_and_the_others_finish() -> None:
    world = random_world(Team.parse("2A2G"), 8, SIZE, SIZE, 3)
    config = AgentConfig(grid=GridSpec(width=SIZE, height=SIZE))
    alive: list[set[int]] = []
    mission = GridMission(world, config, LinkFaults(delay_min_ns=10**9, delay_max_ns=10**9), deaths={1: 2, 3: 4})
    result = fly(mission, make("greedy"), lambda step, cells: alive.append(set(cells)))
    assert alive[:6] == [{1, 2, 3, 4}] * 3 + [{2, 3, 4}] * 2 + [{2, 4}]
    assert result.localized == result.reachable
    assert result.steps > flown("greedy", "2A2G", 3).steps


def test_mission_whose_last_robot_dies_ends() -> None:
    world = random_world(Team.parse("1A0G"), 8, SIZE, SIZE, 3)
    config = AgentConfig(grid=GridSpec(width=SIZE, height=SIZE))
    assert fly(GridMission(world, config, deaths={1: 3}), make("greedy")).steps <= 4
