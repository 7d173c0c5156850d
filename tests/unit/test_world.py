"""The paper's worlds, from seeds."""

from __future__ import annotations

import numpy as np
import pytest

from gatar_edge.errors import ConfigError, WorldError
from gatar_edge.sim_sitl.world import TEMPLATES, Team, observe, random_obstacles, random_world, reachable_targets
from gatar_edge.types import RobotKind


def test_the_same_seed_gives_the_same_world() -> None:
    first, second = (random_world(Team.parse("3A3G"), None, 15, 15, 7) for _ in range(2))
    assert (first.obstacles == second.obstacles).all()
    assert first.targets.tolist() == second.targets.tolist()
    assert first.starts == second.starts


@pytest.mark.parametrize("seed", range(30))
def test_obstacles_follow_one_of_the_six_templates(seed: int) -> None:
    obstacles = random_obstacles(15, 15, np.random.default_rng(seed))
    counts = tuple(
        tuple(int(obstacles[5 * bx : 5 * bx + 5, 5 * by : 5 * by + 5].sum()) for by in range(3)) for bx in range(3)
    )
    assert counts in TEMPLATES


@pytest.mark.parametrize("seed", range(30))
def test_robots_and_targets_stand_on_different_free_cells(seed: int) -> None:
    world = random_world(Team.parse("6A6G"), None, 15, 15, seed)
    places = [*world.starts, *map(tuple, world.targets.tolist())]
    assert 20 <= len(world.targets) <= 30
    assert len(set(places)) == len(places)
    assert not any(world.obstacles[place] for place in places)


def test_worlds_of_any_size_are_made() -> None:
    world = random_world(Team.parse("1A1G"), 40, 48, 7, 1)
    assert world.shape == (48, 7)
    assert world.obstacles.any()


@pytest.mark.parametrize("text", ["", "3A", "AG", "0A0G", "3A3G!", "-1A2G", "40A40G", "３A3G"])
def test_a_wrong_team_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="not of the form 3A3G"):
        Team.parse(text)


def test_a_team_reads_as_it_is_written() -> None:
    assert str(Team.parse("2a1g")) == "2A1G"
    assert Team.parse("1A1G").kinds == (RobotKind.UAV, RobotKind.UGV)


def test_too_many_targets_for_the_map_are_refused() -> None:
    with pytest.raises(WorldError, match="do not fit"):
        random_world(Team.parse("1A1G"), 225, 15, 15, 0)


def test_an_observation_holds_only_what_is_in_view() -> None:
    world = random_world(Team.parse("1A1G"), 30, 15, 15, 5)
    seen = observe(world, 2, world.starts[1], 4, 123)
    cells = {tuple(cell) for cell in seen.seen.tolist()}
    assert seen.kind is RobotKind.UGV
    assert {tuple(c) for c in seen.obstacles.tolist()} | {tuple(c) for c in seen.targets.tolist()} <= cells
    assert all(world.obstacles[tuple(c)] for c in seen.obstacles.tolist())


def test_a_target_walled_in_counts_as_reachable_only_with_an_aerial_robot() -> None:
    world = random_world(Team.parse("0A1G"), 1, 15, 15, 2)
    x, y = (int(c) for c in world.targets[0])
    obstacles = world.obstacles.copy()
    for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        if 0 <= x + dx < 15 and 0 <= y + dy < 15:
            obstacles[x + dx, y + dy] = True
    walled = type(world)(obstacles, world.targets, world.starts, world.team, 2)
    aerial = type(world)(obstacles, world.targets, world.starts, Team.parse("1A0G"), 2)
    assert (len(reachable_targets(walled)), len(reachable_targets(aerial))) == (0, 1)
