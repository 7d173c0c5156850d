"""What befalls vehicles and companions when a scenario says so."""

from __future__ import annotations

from dataclasses import replace

import pytest

from gatar_edge.allocators.registry import make
from gatar_edge.commands._sim import fleet_config
from gatar_edge.errors import ConfigError
from gatar_edge.sim_sitl.autopilot import AutopilotConfig, SimAutopilot
from gatar_edge.sim_sitl.faults import Faults
from gatar_edge.sim_sitl.faulty_link import End
from gatar_edge.sim_sitl.fleet import Fleet, lock_step
from gatar_edge.sim_sitl.incident_types import (
    Battery,
    ClockSkew,
    GpsFreeze,
    GpsJump,
    GpsLoss,
    Incident,
    KillCompanion,
    PilotMode,
    Reboot,
)
from gatar_edge.sim_sitl.incidents import Script, Turn, happen
from gatar_edge.sim_sitl.testing import COPTER, ROVER, Client, of, px4_copter
from gatar_edge.types import NS_PER_S


def suffer(client: Client, incident: Incident, over: bool = False) -> None:
    happen(Turn(client.now_ns, incident, over), client.vehicle, client.now_ns)


def driving(config: AutopilotConfig = ROVER) -> Client:
    """A rover in GUIDED on its way a hundred metres north."""
    client = Client(config)
    client.command(176, 1, 15)
    client.command(400, 1)
    client.command_int(192, 5, *client.place(0, 100)[:2], 584)
    client.run(3)
    return client


def position(client: Client) -> tuple[float, float] | None:
    told = of(client.run(1.0), "GLOBAL_POSITION_INT")
    return (told[-1].lat / 1e7, told[-1].lon / 1e7) if told else None


def test_without_a_fix_no_position_is_told_and_guided_modes_are_refused() -> None:
    client = Client(COPTER)
    suffer(client, GpsLoss(robot=1, at_s=0))
    messages = client.run(3)
    assert not of(messages, "GLOBAL_POSITION_INT")
    assert of(messages, "GPS_RAW_INT")[-1].fix_type == 1
    assert client.command(176, 1, 4) == 4
    suffer(client, GpsLoss(robot=1, at_s=0), over=True)
    assert of(client.run(3), "GLOBAL_POSITION_INT")
    assert client.command(176, 1, 4) == 0


def test_a_frozen_position_stays_while_the_vehicle_moves() -> None:
    client = driving()
    suffer(client, GpsFreeze(robot=2, at_s=0))
    first, before = position(client), client.vehicle.truth.north_m
    assert position(client) == first
    assert client.vehicle.truth.north_m > before + 3


def test_a_vehicle_steers_by_the_position_it_believes() -> None:
    client = driving()
    suffer(client, GpsJump(robot=2, at_s=0, east_m=10, north_m=0))
    client.run(40)
    assert client.vehicle.truth.east_m == pytest.approx(-10, abs=0.5)
    assert client.vehicle.truth.north_m == pytest.approx(100, abs=0.5)
    suffer(client, GpsJump(robot=2, at_s=0, east_m=10, north_m=0), over=True)
    client.run(20)
    assert client.vehicle.truth.east_m == pytest.approx(0, abs=0.5)


def test_a_jump_of_the_position_moves_nothing() -> None:
    client = driving()
    before = client.vehicle.place_m
    suffer(client, GpsJump(robot=2, at_s=0, east_m=10))
    assert client.vehicle.place_m == pytest.approx(before)


def test_an_obstacle_is_met_where_it_really_is() -> None:
    client = Client(ROVER, blocked=lambda east_m, north_m: north_m > 20)
    client.command(176, 1, 15)
    client.command(400, 1)
    suffer(client, GpsJump(robot=2, at_s=0, north_m=10))
    client.command_int(192, 5, *client.place(0, 100)[:2], 584)
    client.run(30)
    assert 18 < client.vehicle.truth.north_m <= 20


def test_the_battery_drops_and_never_rises() -> None:
    client = Client(COPTER)
    suffer(client, Battery(robot=1, at_s=0, percent=15))
    suffer(client, Battery(robot=1, at_s=0, percent=80))
    assert of(client.run(4), "SYS_STATUS")[-1].battery_remaining == 15


@pytest.mark.parametrize(("config", "mode", "number"), [(COPTER, "LOITER", 5), (px4_copter(), "rtl", 0x05040000)])
def test_the_pilot_changes_the_mode(config: AutopilotConfig, mode: str, number: int) -> None:
    client = Client(config)
    suffer(client, PilotMode(robot=1, at_s=0, mode=mode))
    assert of(client.run(1.5), "HEARTBEAT")[-1].custom_mode == number


def test_a_reboot_disarms() -> None:
    client = driving()
    suffer(client, Reboot(robot=2, at_s=0))
    assert not client.vehicle.truth.armed


def test_turns_come_once_each_in_order_of_time() -> None:
    vehicles = {1: SimAutopilot(COPTER, 0)}
    script = Script((Battery(robot=1, at_s=5, percent=1), GpsLoss(robot=1, at_s=1, for_s=2)), vehicles)
    assert [turn.text for turn in script.due(2 * NS_PER_S)] == ["scenario: gps_loss"]
    assert [turn.text for turn in script.due(9 * NS_PER_S)] == ["scenario: gps_loss is over", "scenario: battery"]
    assert script.due(99 * NS_PER_S) == []


def test_a_mode_that_the_vehicle_has_not_is_refused_by_name() -> None:
    with pytest.raises(ConfigError, match=r"ardupilot copter has no mode 'POSCTL': STABILIZE.*"):
        Script((PilotMode(robot=1, at_s=0, mode="POSCTL"),), {1: SimAutopilot(COPTER, 0)})
    with pytest.raises(ConfigError, match="there is no robot 2"):
        Script((Reboot(robot=2, at_s=0),), {1: SimAutopilot(COPTER, 0)})


def flown(*incidents: Incident) -> Fleet:
    mission = fleet_config(team="2A0G", seed=4, targets=8, max_steps=120)
    fleet = Fleet(replace(mission, faults=Faults(incidents=incidents)), make("greedy"))
    for _ in lock_step(fleet):
        pass
    return fleet


def test_a_vehicle_outlives_its_companion_and_the_others_finish() -> None:
    fleet = flown(KillCompanion(robot=1, at_s=2))
    first = fleet.robots[0]
    assert (first.thinks, first.alive) == (False, True)
    assert first.body.autopilot.truth.alt_rel_m > 10  # it holds, as an ArduCopter with default parameters does
    assert fleet.tally.left == 0


def test_a_dead_companion_says_nothing_more() -> None:
    mission = fleet_config(team="2A0G", seed=4, targets=8)
    fleet = Fleet(replace(mission, faults=Faults(incidents=(KillCompanion(robot=1, at_s=0),))), make("greedy"))
    said: list[int] = []
    for now_ns in lock_step(fleet):
        if fleet.robots[0].thinks is False and fleet.robots[0].wire.tap is None:
            fleet.robots[0].wire.tap = lambda end, data: said.append(len(data) if end is End.COMPANION else 0)
        if fleet.began_ns is not None and now_ns > fleet.began_ns + 5 * NS_PER_S:
            break
    assert sum(said) == 0
    assert [decision.robot_id for decision in fleet.decisions] == [2]


def test_a_skewed_clock_is_that_of_one_companion_alone() -> None:
    mission = fleet_config(team="2A0G", seed=4, targets=8)
    skew = ClockSkew(robot=1, at_s=0, offset_s=0.3, for_s=3)
    fleet = Fleet(replace(mission, faults=Faults(incidents=(skew,))), make("greedy"))
    ahead: list[int] = []
    for now_ns in lock_step(fleet):
        if len(fleet.decisions) == 2:
            one, other = fleet.decisions
            ahead.append(one.t_ns - other.t_ns)
        if fleet.began_ns is not None and now_ns > fleet.began_ns + 5 * NS_PER_S:
            break
    assert (ahead[0], ahead[-1]) == (300_000_000, 0)


def test_a_skewed_clock_costs_no_target() -> None:
    assert flown(ClockSkew(robot=1, at_s=2, offset_s=0.3, for_s=10)).tally.left == 0


def test_a_robot_whose_pilot_took_over_leaves_its_targets_to_the_others() -> None:
    fleet = flown(PilotMode(robot=1, at_s=3, mode="LOITER"))
    assert fleet.robots[0].body.autopilot.truth.mode == "LOITER"
    assert fleet.tally.left == 0
