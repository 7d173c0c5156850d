"""What the items of a mission make a vehicle do, and how a mission ends."""

from __future__ import annotations

from typing import Any

import pytest

from gatar_edge.sim_sitl.testing import COPTER, HOME, ROVER, Client, of

WAYPOINT, LOITER_UNLIM, LOITER_TIME, RTL, LAND, TAKEOFF, DELAY, JUMP, SPEED = 16, 17, 19, 20, 21, 22, 93, 177, 178


def load(client: Client, *items: dict[str, Any]) -> None:
    """Upload items given as fields, `at` being metres east and north and height."""
    client.send("MISSION_COUNT", count=len(items) + 1, mission_type=0)
    client.item(0, *HOME)
    for seq, item in enumerate(items, 1):
        fields = dict(item)
        point = client.place(*fields.pop("at")) if "at" in fields else (0.0, 0.0, 0.0)
        answers = client.item(seq, *point, **fields)
    assert [ack.type for ack in of(answers, "MISSION_ACK")] == [0]


def drive(*items: dict[str, Any]) -> Client:
    rover = Client(ROVER)
    load(rover, *items)
    assert [rover.command(400, 1), rover.command(176, 1, 10)] == [0, 0]
    return rover


def reached(client: Client) -> list[int]:
    return [message.seq for message in of(client.log, "MISSION_ITEM_REACHED")]


def fly(*items: dict[str, Any]) -> Client:
    copter = Client(COPTER)
    load(copter, {"command": TAKEOFF, "at": (0, 0, 10)}, *items)
    assert [copter.command(176, 1, 4), copter.command(400, 1), copter.command(300)] == [0, 0, 0]
    return copter


def test_a_speed_item_changes_the_speed_and_is_not_reported_as_reached() -> None:
    rover = drive({"command": SPEED, "param1": 1.0, "param2": 2.0}, {"at": (0, 40)})
    rover.run(6)
    assert rover.vehicle.truth.speed_m_s == pytest.approx(2, abs=0.01)
    assert reached(rover) == []


def test_a_delay_waits_where_it_is() -> None:
    rover = drive({"at": (0, 10)}, {"command": DELAY, "param1": 8.0}, {"at": (0, 30)})
    rover.run(10)
    assert rover.vehicle.truth.north_m == pytest.approx(10, abs=0.5)
    rover.run(12)
    assert reached(rover) == [1, 2, 3]


def test_a_loiter_of_some_time_goes_on_and_one_without_end_does_not() -> None:
    rover = drive(
        {"command": LOITER_TIME, "param1": 3.0, "at": (0, 10)},
        {"command": LOITER_UNLIM, "at": (0, 20)},
        {"at": (0, 40)},
    )
    rover.run(60)
    assert reached(rover) == [1]
    assert rover.vehicle.truth.north_m == pytest.approx(20, abs=0.3)


def test_a_jump_is_made_as_often_as_it_says() -> None:
    rover = drive({"at": (0, 10)}, {"at": (0, 20)}, {"command": JUMP, "param1": 1.0, "param2": 2.0}, {"at": (0, 30)})
    rover.run(80)
    assert reached(rover) == [1, 2, 1, 2, 1, 2, 4]


def test_a_jump_to_itself_for_ever_does_not_hang() -> None:
    rover = drive({"at": (0, 10)}, {"command": JUMP, "param1": 2.0, "param2": -1.0})
    rover.run(20)
    assert rover.vehicle.truth.mission_state == 3


def test_a_return_item_brings_a_rover_home_and_ends_the_mission() -> None:
    rover = drive({"at": (0, 20)}, {"command": RTL})
    rover.run(30)
    assert rover.vehicle.truth.north_m == pytest.approx(0, abs=0.6)
    assert rover.vehicle.truth.mission_state == 5


@pytest.mark.parametrize(("behave", "mode"), [(0, "AUTO"), (1, "AUTO"), (3, "MANUAL")])
def test_the_done_behaviour_of_a_rover(behave: int, mode: str) -> None:
    rover = Client(ROVER)
    rover.send("PARAM_SET", param_id=b"MIS_DONE_BEHAVE", param_value=behave, param_type=2)
    load(rover, {"at": (0, 10)})
    rover.command(400, 1)
    rover.command(176, 1, 10)
    rover.run(10)
    assert rover.vehicle.truth.mode == mode


def test_a_copter_takes_off_flies_its_mission_and_stays_in_auto_above_the_last_item() -> None:
    copter = fly({"at": (20, 0, 15)})
    copter.run(20)
    truth = copter.vehicle.truth
    assert (truth.mode, truth.mission_state, reached(copter)) == ("AUTO", 5, [1, 2])
    assert (truth.east_m, truth.alt_rel_m) == (pytest.approx(20, abs=0.3), pytest.approx(15, abs=0.3))


def test_a_land_item_lands_and_disarms_a_copter() -> None:
    copter = fly({"at": (10, 0, 10)}, {"command": LAND, "at": (10, 0)})
    copter.run(30)
    truth = copter.vehicle.truth
    assert (truth.armed, truth.landed, reached(copter)) == (False, True, [1, 2, 3])


def test_a_place_of_zero_zero_means_here() -> None:
    copter = fly({"at": (10, 0, 10)}, {"command": LAND})
    copter.run(30)
    assert copter.vehicle.truth.east_m == pytest.approx(10, abs=2.1)
    assert copter.vehicle.truth.landed


def test_an_altitude_above_the_sea_in_a_mission_item() -> None:
    copter = fly({"frame": 0, "at": (5, 0, 584 + 20)})
    copter.run(15)
    assert copter.vehicle.truth.alt_rel_m == pytest.approx(20, abs=0.3)


def test_an_armed_copter_on_the_ground_refuses_auto_without_a_takeoff_item() -> None:
    copter = Client(COPTER)
    load(copter, {"at": (5, 0, 10)})
    assert [copter.command(176, 1, 4), copter.command(400, 1), copter.command(176, 1, 3)] == [0, 0, 4]
