"""Whole missions of mixed ArduPilot and PX4 teams over bad links, and with robots that die.

The same for more seeds: `gatar bench missions --seeds 1-50`, and with `--team 6A6G --kills 5`.
"""

from __future__ import annotations

import json
from types import SimpleNamespace

import pytest
from click.testing import CliRunner

from gatar_edge.allocators.registry import make
from gatar_edge.commands._sim import fleet_config
from gatar_edge.commands.bench_missions import command, fly_watched, seeds_of, with_kills
from gatar_edge.errors import ConfigError
from gatar_edge.mission_watch import Orphan, Watch
from gatar_edge.sim_sitl.faulty_link import End
from gatar_edge.sim_sitl.fleet import Fleet
from gatar_edge.sim_sitl.wire import mavlink


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_mixed_team_localizes_all_targets_though_every_fifth_message_is_lost(seed: int) -> None:
    config = fleet_config(team="3A3G", seed=seed, stack="mixed", loss=0.2, telemetry_loss=0.2)
    assert set(config.stacks) == {"ardupilot", "px4"}
    flown = fly_watched(config, "greedy")
    assert flown.left == 0
    assert flown.seen.in_obstacle == 0
    assert flown.seen.outside_fence == []
    assert flown.seen.separation_m > 1.5  # UAVs fly in layers two metres apart


@pytest.mark.parametrize("kills", [1, 3, 5])
def test_the_others_localize_what_dead_robots_leave(kills: int) -> None:
    config = with_kills(fleet_config(team="6A6G", seed=kills, stack="mixed"), kills, kills)
    flown = fly_watched(config, "greedy")
    assert flown.killed == kills
    assert (flown.left, flown.seen.orphaned, flown.seen.in_obstacle) == (0, 0, 0)
    assert all(ticks <= 3 for ticks in flown.seen.neglected_ticks)
    assert all(ticks <= 3 for ticks in flown.seen.replanned_ticks)
    assert len(flown.seen.planned_ticks) == len(flown.seen.taken_ticks) == len(flown.seen.replanned_ticks)


def watched() -> tuple[Fleet, Watch]:
    fleet = Fleet(fleet_config(team="1A1G", seed=1, targets=5), make("greedy"))
    return fleet, Watch(fleet)


def test_a_command_outside_the_grid_would_be_noticed() -> None:
    fleet, watch = watched()
    frame = mavlink.MAVLink_command_int_message(1, 1, 5, 192, 0, 0, 0, 1, 0, 0, 470_000_000, 80_000_000, 20)
    fleet.robots[0].wire.send(0, End.COMPANION, bytes(frame.pack(mavlink.MAVLink(None, 1, 191))))
    assert len(watch.seen.outside_fence) == 1
    assert "robot 1: COMMAND_INT" in watch.seen.outside_fence[0]


def test_a_rover_in_an_obstacle_would_be_noticed() -> None:
    fleet, watch = watched()
    obstacles = fleet.config.world.obstacles.copy()
    obstacles[fleet.robots[1].body.cell] = True
    watch._fleet = SimpleNamespace(  # type: ignore[assignment]
        config=SimpleNamespace(world=SimpleNamespace(obstacles=obstacles)),
        robots=fleet.robots, began_ns=None, ticks=0,
    )  # fmt: skip
    watch.look()
    assert watch.seen.in_obstacle == 1


def test_a_target_that_idle_robots_leave_alone_counts_as_neglected() -> None:
    fleet, watch = watched()
    cell = (3, 4)
    fleet.decisions = (deciding(robots=(1,), choices=(-1,), cell=cell),)  # type: ignore[assignment]
    watch._orphans[cell] = Orphan(robot_id=3, expired=0)
    for fleet.ticks in range(1, 6):
        watch.look()
    assert watch._orphans[cell].neglected == 5


def deciding(
    robots: tuple[int, ...], choices: tuple[int, ...], cell: tuple[int, int], absent: tuple[int, ...] = ()
) -> SimpleNamespace:
    """A decision of robot 1, which knows one target and has none."""
    return SimpleNamespace(
        robot_id=1,
        assignment=SimpleNamespace(kind=0, cell=(0, 0)),
        candidates=[SimpleNamespace(cell=cell, length=2)],
        robots=[SimpleNamespace(robot_id=robot_id) for robot_id in robots],
        choices=choices,
        absent=[SimpleNamespace(robot_id=robot_id) for robot_id in absent],
    )


def test_a_dead_robots_target_is_replanned_once_nobody_counts_on_it_and_planned_once_somebody_alive_gets_it() -> None:
    fleet, watch = watched()
    cell = (3, 4)
    watch._orphans[cell] = Orphan(robot_id=3, expired=0)
    plans = [
        deciding((1, 2, 3), (-1, -1, 0), cell),  # still the dead robot's
        deciding((1, 2), (-1, -1), cell),
        deciding((1, 2), (-1, -1), cell),
        deciding((1, 2), (-1, 0), cell),
        deciding((1, 2), (-1, 0), cell),
    ]
    for fleet.ticks, plan in enumerate(plans, start=1):
        fleet.decisions = (plan,)  # type: ignore[assignment]
        watch.look()
    assert (watch.seen.replanned_ticks, watch.seen.planned_ticks, watch.seen.taken_ticks) == ([2], [4], [])


def test_a_dead_robot_that_is_believed_out_of_range_is_still_counted_on() -> None:
    fleet, watch = watched()
    cell = (3, 4)
    watch._orphans[cell] = Orphan(robot_id=3, expired=0)
    for fleet.ticks, absent in enumerate(((3,), (3,), ()), start=1):
        fleet.decisions = (deciding((1, 2), (-1, -1), cell, absent),)  # type: ignore[assignment]
        watch.look()
    assert watch.seen.replanned_ticks == [3]


def test_the_figures_are_printed_for_machines() -> None:
    done = CliRunner().invoke(command, ["--team", "2A1G", "--seeds", "3", "--kills", "1", "--json"])
    assert done.exit_code == 0, done.output
    figures = json.loads(done.output)
    assert (figures["missions"], figures["killed"], figures["failed_seeds"]) == (1, 1, [])


def test_a_mission_that_is_not_finished_fails_the_command() -> None:
    done = CliRunner().invoke(command, ["--team", "1A0G", "--seeds", "1-2", "--max-steps", "2"])
    assert done.exit_code == 1
    assert "seed    2: FAILED" in done.output


@pytest.mark.parametrize("text", ["", "a", "5-1", "1-", "-3", "1-2-3", "99999999"])
def test_seeds_that_are_no_seeds_are_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="not of the form"):
        seeds_of(text)


def test_a_team_of_dead_robots_is_refused() -> None:
    with pytest.raises(ConfigError, match="leave nobody"):
        with_kills(fleet_config(team="1A1G", seed=1), 2, 1)
