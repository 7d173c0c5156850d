"""Whole missions: every link real, in virtual time."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from mcap.reader import make_reader
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from gatar_edge.allocators.registry import make
from gatar_edge.commands._sim import fleet_config, open_fleet
from gatar_edge.commands.sim import command
from gatar_edge.errors import ConfigError, LogError
from gatar_edge.sim_sitl.faults import Faults, LinkFaults
from gatar_edge.sim_sitl.fleet import Fleet, lock_step
from gatar_edge.sim_sitl.fleet_config import FleetConfig
from gatar_edge.sim_sitl.tally import Result
from gatar_edge.types import NS_PER_S, Reason, RobotKind


def config(
    team: str = "2A2G", seed: int = 1, targets: int = 12, stack: str = "ardupilot", **changes: Any
) -> FleetConfig:
    options: dict[str, Any] = {
        "team": team,
        "targets": targets,
        "size": 15,
        "seed": seed,
        "r_sense": 4.0,
        "r_comm": 6.0,
        "stack": "ardupilot",
        "loss": 0.0,
        "telemetry_loss": 0.0,
        "max_steps": 300,
    }
    return fleet_config(**(options | changes))


def flown(fleet: Fleet) -> Fleet:
    for _ in lock_step(fleet):
        pass
    return fleet


@cache
def result_of(seed: int, allocator: str) -> Result:
    return flown(Fleet(config(seed=seed), make(allocator))).result()


@pytest.mark.parametrize("allocator", ["gatar", "nearest", "greedy"])
@pytest.mark.parametrize("seed", [1, 2])
def test_a_team_localizes_every_reachable_target(seed: int, allocator: str) -> None:
    result = result_of(seed, allocator)
    assert (result.localized, result.fallbacks) == (result.reachable, 0)


def test_a_ground_robot_never_enters_an_obstacle() -> None:
    fleet = Fleet(config(team="0A4G", seed=3), make("greedy"))
    for _ in lock_step(fleet):
        assert not any(fleet.config.world.obstacles[robot.body.cell] for robot in fleet.robots)
    assert fleet.tally.left == 0


@pytest.mark.parametrize("team", ["1A0G", "1A1G"])
def test_a_target_beyond_a_vehicles_fence_is_another_robots_or_given_up(team: str) -> None:
    fleet = Fleet(config(team=team, max_steps=100), make("greedy"))
    fenced = fleet.robots[0]
    param = mavlink.MAVLink_param_set_message
    for name, value in ((b"FENCE_ENABLE", 1), (b"FENCE_TYPE", 2), (b"FENCE_RADIUS", 60)):
        frame = param(fenced.robot_id, 1, name, value, mavlink.MAV_PARAM_TYPE_REAL32).pack(mavlink.MAVLink(None, 255))
        fenced.body.autopilot.receive(bytes(frame), 0)
    flown(fleet)
    near = [target for target in fleet.config.world.targets if math.dist(fleet.config.world.starts[0], target) < 5]
    assert fleet.tally.left == 0 if team == "1A1G" else fleet.result().localized >= len(near) >= 3
    assert fenced.shunned.cells(fleet.now_ns)


def test_a_robot_whose_vehicle_does_not_obey_leaves_the_allocation_to_the_others() -> None:
    fleet = Fleet(config(), make("greedy"))
    stuck = fleet.robots[0]
    for _ in lock_step(fleet):
        if fleet.began_ns is not None:
            stuck.driver.ready = lambda now_ns: False  # type: ignore[method-assign]
        if fleet.ticks >= 3:
            break
    reasons = {decision.robot_id: decision.assignment.reason for decision in fleet.decisions}
    assert reasons.pop(stuck.robot_id) is Reason.NO_VEHICLE
    assert Reason.NO_VEHICLE not in reasons.values()


def test_aerial_robots_keep_to_their_own_layers() -> None:
    fleet = flown(Fleet(config(team="3A0G"), make("greedy")))
    heights = sorted(robot.body.autopilot.truth.alt_rel_m for robot in fleet.robots)
    assert [high - low > 1.0 for low, high in pairwise(heights)] == [True, True]


def test_the_same_seed_gives_the_same_decisions() -> None:
    digest = result_of(1, "greedy").digest
    assert flown(Fleet(config(seed=1), make("greedy"))).result().digest == digest
    assert result_of(2, "greedy").digest != digest


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_lost_messages_and_lost_telemetry_cost_time_but_no_target(seed: int) -> None:
    result = flown(Fleet(config(seed=seed, loss=0.2, telemetry_loss=0.2), make("greedy"))).result()
    assert result.localized == result.reachable


def test_the_others_finish_when_robots_die() -> None:
    mission = config(team="3A1G", seed=4)
    faults = Faults(kill_ns={1: 3 * NS_PER_S, 2: 8 * NS_PER_S})
    fleet = flown(Fleet(replace(mission, faults=faults), make("greedy")))
    assert [robot.alive for robot in fleet.robots] == [False, False, True, True]
    assert fleet.tally.left == 0


def test_delayed_messages_are_survived() -> None:
    mission = replace(config(seed=5), faults=Faults(radio=LinkFaults(delay_min_ns=0, delay_max_ns=2 * NS_PER_S)))
    assert flown(Fleet(mission, make("greedy"))).tally.left == 0


def test_targets_that_nobody_can_reach_do_not_keep_the_mission_going() -> None:
    fleet = flown(Fleet(config(team="0A1G", seed=16, targets=30), make("greedy")))
    result = fleet.result()
    assert result.localized == result.reachable


def test_every_robot_flies_what_it_is() -> None:
    kinds = {robot.robot_id: robot.body.autopilot.config.vehicle for robot in Fleet(config(), make("greedy")).robots}
    assert kinds == {1: "copter", 2: "copter", 3: "rover", 4: "rover"}
    assert RobotKind.UAV.letter + RobotKind.UGV.letter == "AG"


def test_the_command_prints_the_result_for_machines(tmp_path: Path) -> None:
    log = tmp_path / "m.mcap"
    done = CliRunner().invoke(
        command,
        ["--team", "1A1G", "--targets", "5", "--seed", "3", "--allocator", "greedy", "--log", str(log), "--json"],
    )
    figures = json.loads(done.output)
    assert figures["localized"] == figures["reachable"] == 5
    assert {
        "digest",
        "targets",
        "steps_90",
        "steps_100",
        "retasks",
        "bytes_per_robot_step",
        "decision_p50_us",
        "decision_p99_us",
        "fallbacks",
    } <= figures.keys()
    assert log.stat().st_size > 10_000


@pytest.mark.parametrize(
    ("arguments", "error", "says"),
    [
        (["--team", "3X"], ConfigError, "not of the form 3A3G"),
        (["--allocator", "best"], ConfigError, "unknown"),
        (["--log", "/dev/null/m.mcap"], LogError, "cannot be written"),
        (["--out", "x", "--log", "y"], ConfigError, "exclude each other"),
    ],
)
def test_bad_input_is_one_clear_line(arguments: list[str], error: type[Exception], says: str) -> None:
    done = CliRunner().invoke(command, arguments)
    assert isinstance(done.exception, error)
    assert says in str(done.exception)
    assert "\n" not in str(done.exception)


def test_the_log_tells_which_faults_were_injected(tmp_path: Path) -> None:
    path = tmp_path / "m.mcap"
    mission = replace(config(team="2A0G", targets=6), faults=Faults(LinkFaults(loss=0.1), kill_ns={1: 2 * NS_PER_S}))
    with open_fleet(mission, "greedy", path) as fleet:
        flown(fleet)
    with path.open("rb") as file:
        told = [json.loads(message.data) for _, _, message in make_reader(file).iter_messages(topics=["/faults"])]
    assert [(fault["kind"], fault["robot_id"]) for fault in told] == [("radio", 0), ("kill_robot", 1)]
    assert told[0]["details"]["loss"] == 0.1


def test_a_bound_is_told_by_its_own_name():
    options = ["--team", "1A1G", "--targets", "3", "--size", "8", "--allocator", "central-greedy", "--json"]
    result = CliRunner().invoke(command, options)
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["allocator"] == "central-greedy"
