"""Modes, targets, arming, failsafes and telemetry of ArduPilot, row by row of the measured tables."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from gatar_edge.sim_sitl.testing import COPTER, HOME, ROVER, Client, kinds, of, texts

GUIDED, RTL, LAND, BRAKE = 4, 6, 9, 17
ROVER_HOLD, ROVER_AUTO, ROVER_GUIDED = 4, 10, 15
ACCEPTED, DENIED, UNSUPPORTED, FAILED = 0, 2, 3, 4
POSITION = 0x0DF8


def flying(**kwargs: object) -> Client:
    client = Client(replace(COPTER, **kwargs))
    assert [client.command(176, 1, GUIDED), client.command(400, 1)] == [ACCEPTED, ACCEPTED]
    assert client.command(22, 0, 0, 0, 0, 0, 0, 10) == ACCEPTED
    client.run(7)
    assert client.vehicle.truth.alt_rel_m == pytest.approx(10, abs=0.3)
    return client


def driving() -> Client:
    client = Client(ROVER)
    assert [client.command(176, 1, ROVER_GUIDED), client.command(400, 1)] == [ACCEPTED, ACCEPTED]
    return client


def target(
    client: Client, east: float, north: float, *, alt: float = 10.0, mask: int = POSITION, frame: int = 6
) -> list:
    lat, lon, _ = client.place(east, north)
    fields = {"lat_int": round(lat * 1e7), "lon_int": round(lon * 1e7), "alt": alt}
    return client.send(
        "SET_POSITION_TARGET_GLOBAL_INT", time_boot_ms=0, coordinate_frame=frame, type_mask=mask, **fields,
        vx=0, vy=0, vz=0, afx=0, afy=0, afz=0, yaw=0, yaw_rate=0,
    )  # fmt: skip


def heartbeat(client: Client) -> object:
    return of(client.log, "HEARTBEAT")[-1]


def test_a_refused_mode_is_answered_failed_and_the_heartbeat_keeps_the_old_one() -> None:
    rover = Client(ROVER)
    assert rover.command(176, 1, ROVER_AUTO) == FAILED  # no mission
    rover.run(1.1)
    assert heartbeat(rover).custom_mode == 0


def test_frames_are_numbered_one_after_the_other_so_that_clients_can_count_losses() -> None:
    copter = Client(COPTER)
    copter.run(60)
    numbers = [message.get_seq() for message in copter.log]
    assert len(numbers) > 256
    assert numbers == [index % 256 for index in range(len(numbers))]


def test_a_mode_change_is_followed_by_a_heartbeat_at_once() -> None:
    copter = Client(COPTER)
    assert kinds(copter.log[-1:]) != ["HEARTBEAT"]
    copter.command(176, 1, GUIDED)
    assert kinds(copter.log)[-2:] == ["COMMAND_ACK", "HEARTBEAT"]
    assert (heartbeat(copter).custom_mode, heartbeat(copter).base_mode, heartbeat(copter).autopilot) == (4, 89, 3)


def test_the_legacy_set_mode_is_obeyed_and_acknowledged() -> None:
    rover = Client(ROVER)
    answers = rover.send("SET_MODE", base_mode=1, custom_mode=ROVER_GUIDED)
    assert [(a.command, a.result) for a in of(answers, "COMMAND_ACK")] == [(11, ACCEPTED)]
    assert rover.vehicle.truth.mode == "GUIDED"


def test_arming_fails_with_a_text_until_the_ekf_is_ready() -> None:
    copter = Client(replace(COPTER, ekf_ready_s=42))
    assert copter.command(400, 1) == FAILED
    assert any(text.startswith("Arm: ") for text in texts(copter.log))
    copter.run(43)
    assert copter.command(400, 1) == ACCEPTED


def test_home_is_known_before_the_ekf_is_ready_and_not_at_power_on() -> None:
    copter = Client(replace(COPTER, ekf_ready_s=42))
    copter.run(10)
    assert not of(copter.log, "HOME_POSITION")
    assert copter.command(512, 242) == FAILED
    copter.run(12)
    assert len(of(copter.log, "HOME_POSITION")) == 1


def test_a_rover_arms_early_in_manual_and_then_auto_fails() -> None:
    rover = Client(replace(ROVER, ekf_ready_s=42))
    rover.upload((*HOME, 0.0), rover.place(0, 10))
    assert rover.command(400, 1) == ACCEPTED
    assert rover.command(176, 1, ROVER_AUTO) == FAILED


def test_a_copter_is_not_armable_in_auto() -> None:
    copter = Client(COPTER)
    copter.upload((*HOME, 0.0), (*HOME, 10.0), command=22)
    assert copter.command(176, 1, 3) == ACCEPTED
    assert copter.command(400, 1) == FAILED


def test_on_the_ground_in_guided_a_target_does_not_lift_it_and_it_disarms_after_eleven_seconds() -> None:
    copter = Client(COPTER)
    copter.command(176, 1, GUIDED)
    copter.command(400, 1)
    target(copter, 30, 0)
    copter.run(10)
    assert (copter.vehicle.truth.alt_rel_m, copter.vehicle.truth.armed) == (0, True)
    copter.run(1.5)
    assert not copter.vehicle.truth.armed


def test_takeoff_needs_guided_armed_and_landed() -> None:
    copter = Client(COPTER)
    assert copter.command(22, 0, 0, 0, 0, 0, 0, 10) == FAILED
    assert flying().command(22, 0, 0, 0, 0, 0, 0, 10) == FAILED
    assert Client(ROVER).command(22, 0, 0, 0, 0, 0, 0, 10) == UNSUPPORTED


def test_a_target_during_takeoff_replaces_it() -> None:
    copter = Client(COPTER)
    copter.command(176, 1, GUIDED)
    copter.command(400, 1)
    copter.command(22, 0, 0, 0, 0, 0, 0, 30)
    copter.run(2)
    target(copter, 20, 0, alt=10)
    copter.run(12)
    truth = copter.vehicle.truth
    assert (truth.east_m, truth.alt_rel_m) == (pytest.approx(20, abs=0.3), pytest.approx(10, abs=0.3))


def test_one_position_target_is_enough_and_is_not_acknowledged() -> None:
    copter = flying()
    assert target(copter, 30, 20) == []
    copter.run(15)
    assert (copter.vehicle.truth.east_m, copter.vehicle.truth.north_m) == (
        pytest.approx(30, abs=0.3),
        pytest.approx(20, abs=0.3),
    )


def test_a_position_target_outside_guided_is_ignored_without_a_word() -> None:
    copter = flying()
    copter.command(176, 1, BRAKE)
    assert target(copter, 30, 20) == []
    copter.run(5)
    assert copter.vehicle.truth.east_m == pytest.approx(0, abs=0.1)


def test_the_echo_is_frame_0_mask_65016_above_the_sea_and_within_1e_7_degrees() -> None:
    copter = flying()
    lat, lon, _ = copter.place(30, 20)
    target(copter, 30, 20, alt=12)
    echo = of(copter.run(1.2), "POSITION_TARGET_GLOBAL_INT")[-1]
    assert (echo.coordinate_frame, echo.type_mask, echo.alt) == (0, 65016, pytest.approx(584 + 12))
    assert abs(echo.lat_int - round(lat * 1e7)) <= 1
    assert abs(echo.lon_int - round(lon * 1e7)) <= 1


@pytest.mark.parametrize("mask", [0xDF8, 0xFF8, 0x9F8, 0])
def test_masks_that_a_copter_flies_by(mask: int) -> None:
    copter = flying()
    target(copter, 20, 0, mask=mask)
    copter.run(10)
    assert copter.vehicle.truth.east_m == pytest.approx(20, abs=0.3)


@pytest.mark.parametrize("mask", [0xDF9, 0xDFA, 0xDFC])
def test_one_ignored_position_bit_stops_a_copter(mask: int) -> None:
    copter = flying()
    target(copter, 60, 0)
    copter.run(4)
    assert copter.vehicle.truth.speed_m_s > 4
    target(copter, 60, 0, mask=mask)
    copter.run(4)
    assert copter.vehicle.truth.speed_m_s < 0.1
    assert copter.vehicle.truth.east_m < 30


@pytest.mark.parametrize("frame", [1, 2, 7, 9])
def test_an_unknown_frame_stops_a_copter(frame: int) -> None:
    copter = flying()
    target(copter, 60, 0)
    copter.run(4)
    target(copter, 60, 0, frame=frame)
    copter.run(4)
    assert copter.vehicle.truth.speed_m_s < 0.1


@pytest.mark.parametrize("frame", [10, 11])
def test_a_terrain_frame_without_terrain_data_flies_it_into_the_ground(frame: int) -> None:
    copter = flying()
    target(copter, 5, 0, frame=frame)
    copter.run(12)
    assert copter.vehicle.truth.landed


def test_a_rover_takes_the_mask_that_ignores_altitude() -> None:
    rover = driving()
    target(rover, 0, 20, alt=0, mask=0x0DFC)
    rover.run(10)
    assert rover.vehicle.truth.north_m == pytest.approx(20, abs=0.3)


def test_a_velocity_target_stops_after_three_seconds() -> None:
    copter = flying()
    copter.send(
        "SET_POSITION_TARGET_GLOBAL_INT", time_boot_ms=0, coordinate_frame=6, type_mask=3527,
        lat_int=0, lon_int=0, alt=0,
        vx=3, vy=0, vz=0, afx=0, afy=0, afz=0, yaw=0, yaw_rate=0,
    )  # fmt: skip
    copter.run(2.5)
    assert copter.vehicle.truth.speed_m_s == pytest.approx(3, abs=0.1)
    copter.run(4)
    assert copter.vehicle.truth.speed_m_s < 0.1


def reposition(
    client: Client, east: float, north: float, *, z: float = 10.0, flag: int = 1, frame: int = 6
) -> int | None:
    lat, lon, _ = client.place(east, north)
    return client.command_int(192, frame, lat, lon, z, -1, flag, 0, 0)


def test_do_reposition_is_acknowledged_and_flown() -> None:
    copter = flying()
    assert reposition(copter, 25, 0) == ACCEPTED
    copter.run(12)
    assert copter.vehicle.truth.east_m == pytest.approx(25, abs=0.3)


def test_do_reposition_with_an_altitude_above_the_sea() -> None:
    copter = flying()
    assert reposition(copter, 5, 0, z=584 + 15, frame=0) == ACCEPTED
    copter.run(8)
    assert copter.vehicle.truth.alt_rel_m == pytest.approx(15, abs=0.3)


def test_do_reposition_as_command_long_is_unsupported() -> None:
    assert flying().command(192, -1, 1, 0, 0, HOME[0], HOME[1], 10) == UNSUPPORTED


def test_do_reposition_without_altitude_or_in_an_unknown_frame_is_denied() -> None:
    copter = flying()
    assert reposition(copter, 5, 0, z=math.nan) == DENIED
    assert reposition(copter, 5, 0, frame=1) == DENIED
    assert "Unknown mavlink coordinate frame 1" in texts(copter.log)


def test_do_reposition_outside_guided_is_denied_without_flag_1_and_switches_with_it() -> None:
    copter = flying()
    copter.command(176, 1, BRAKE)
    assert reposition(copter, 5, 0, flag=0) == DENIED
    assert reposition(copter, 5, 0, flag=1) == ACCEPTED
    assert copter.vehicle.truth.mode == "GUIDED"


def test_a_guided_rover_reports_item_0_as_reached() -> None:
    rover = driving()
    target(rover, 0, 20, alt=0)
    assert [m.seq for m in of(rover.run(12), "MISSION_ITEM_REACHED")] == [0]


def test_unknown_commands_and_failure_injection_are_unsupported() -> None:
    rover = Client(ROVER)
    assert [rover.command(420, 1, 2), rover.command(31000), rover.command(65535)] == [UNSUPPORTED] * 3


def test_a_message_for_somebody_else_vanishes_and_one_for_all_is_obeyed() -> None:
    rover = Client(ROVER)
    assert rover.command(400, 1, target_system=77) is None
    assert rover.command(400, 1, target_component=154) is None
    assert rover.command(400, 1, target_system=0, target_component=0) == ACCEPTED


def test_return_flies_home_lands_and_disarms() -> None:
    copter = flying()
    reposition(copter, 30, 0)
    copter.run(12)
    assert copter.command(20) == ACCEPTED
    copter.run(45)
    truth = copter.vehicle.truth
    assert (truth.armed, truth.landed, truth.mode) == (False, True, "RTL")
    assert math.hypot(truth.east_m, truth.north_m) < 1


def test_land_comes_down_where_it_is_and_disarms() -> None:
    copter = flying()
    assert copter.command(21) == ACCEPTED
    copter.run(12)
    assert (copter.vehicle.truth.armed, copter.vehicle.truth.landed) == (False, True)


# "Companion death" and "Fence"


def beat(client: Client, seconds: float, sysid: int = 255) -> None:
    for _ in range(round(seconds)):
        client.send(
            "HEARTBEAT",
            sysid=sysid,
            type=18,
            autopilot=8,
            base_mode=0,
            custom_mode=0,
            system_status=4,
            mavlink_version=3,
        )
        client.run(1)


def put(client: Client, name: str, value: float) -> None:
    assert of(client.send("PARAM_SET", param_id=name.encode(), param_value=value, param_type=9), "PARAM_VALUE")


def test_without_a_failsafe_parameter_the_copter_holds_when_its_ground_station_dies() -> None:
    copter = flying()
    beat(copter, 3)
    copter.run(20)
    assert (copter.vehicle.truth.mode, heartbeat(copter).system_status) == ("GUIDED", 4)


@pytest.mark.parametrize(("enable", "mode"), [(1, "RTL"), (7, "BRAKE"), (5, "LAND")])
def test_five_seconds_without_the_ground_station_end_in_the_chosen_mode_and_do_not_come_back(
    enable: int, mode: str
) -> None:
    copter = flying()
    put(copter, "FS_GCS_ENABLE", enable)
    beat(copter, 2)
    copter.run(3.8)
    assert copter.vehicle.truth.mode == "GUIDED"
    target(copter, 5, 5)  # targets do not count as alive
    copter.run(0.6)
    assert copter.vehicle.truth.mode == mode
    copter.run(0.6)
    assert heartbeat(copter).system_status == 5
    beat(copter, 2)
    assert (copter.vehicle.truth.mode, "GCS Failsafe Cleared" in texts(copter.log)) == (mode, True)
    assert heartbeat(copter).system_status == 4


def test_the_failsafe_is_inactive_until_the_watched_system_was_seen() -> None:
    copter = flying()
    put(copter, "FS_GCS_ENABLE", 1)
    beat(copter, 2, sysid=7)
    copter.run(10)
    assert copter.vehicle.truth.mode == "GUIDED"


def test_the_watched_system_can_be_the_companion() -> None:
    copter = flying()
    put(copter, "FS_GCS_ENABLE", 1)
    put(copter, "SYSID_MYGCS", 1)
    beat(copter, 2, sysid=1)
    copter.run(6)
    assert copter.vehicle.truth.mode == "RTL"


def test_a_rover_holds_six_and_a_half_seconds_after_the_last_heartbeat() -> None:
    rover = driving()
    put(rover, "FS_GCS_ENABLE", 1)
    target(rover, 0, 200, alt=0)
    beat(rover, 2)
    rover.run(5.3)
    assert rover.vehicle.truth.mode == "GUIDED"
    rover.run(0.4)
    assert rover.vehicle.truth.mode == "HOLD"
    assert "Radio Failsafe" in texts(rover.log)


def test_with_sysid_enforce_other_systems_get_no_answer() -> None:
    rover = Client(ROVER)
    put(rover, "SYSID_ENFORCE", 1)
    assert rover.command(511, 33, 200000) == ACCEPTED
    assert rover.command(511, 33, 200000, sysid=200) is None


def fenced(client: Client) -> Client:
    for name, value in {"FENCE_TYPE": 3, "FENCE_RADIUS": 50, "FENCE_ALT_MAX": 30, "FENCE_ENABLE": 1}.items():
        put(client, name, value)
    return client


def test_a_copter_ignores_a_target_outside_the_fence_in_silence_and_refuses_reposition() -> None:
    copter = fenced(flying())
    target(copter, 10, 0)
    copter.run(8)
    assert target(copter, 80, 0) == []
    assert reposition(copter, 80, 0) == FAILED
    assert reposition(copter, 5, 0, z=40) == FAILED
    copter.run(8)
    assert copter.vehicle.truth.east_m == pytest.approx(10, abs=0.3)


def test_a_mission_item_outside_the_fence_ends_in_rtl() -> None:
    copter = fenced(flying())
    copter.upload((*HOME, 0.0), copter.place(80, 0, 10.0))
    assert copter.command(176, 1, 3) == ACCEPTED
    copter.run(25)
    assert copter.vehicle.truth.mode == "RTL"
    assert of(copter.log, "FENCE_STATUS")
    assert "Circle fence breached" in texts(copter.log)


def test_a_rover_accepts_a_target_outside_the_fence_and_stops_in_silence_at_47_m() -> None:
    rover = fenced(driving())
    put(rover, "FENCE_TYPE", 2)
    assert reposition(rover, 0, 80, z=0) == ACCEPTED
    rover.run(25)
    assert rover.vehicle.truth.north_m == pytest.approx(47, abs=0.6)
    assert rover.vehicle.truth.speed_m_s == 0


def test_a_rover_stops_before_what_is_blocked_and_can_drive_away() -> None:
    rover = Client(ROVER, blocked=lambda east_m, north_m: north_m > 15)
    rover.command(176, 1, ROVER_GUIDED)
    rover.command(400, 1)
    target(rover, 0, 40, alt=0)
    rover.run(12)
    assert rover.vehicle.truth.north_m == pytest.approx(15, abs=0.6)
    assert rover.vehicle.truth.north_m <= 15
    target(rover, 20, 5, alt=0)
    rover.run(12)
    assert rover.vehicle.truth.east_m == pytest.approx(20, abs=0.3)


# Parameters, requests, clocks


def test_the_parameter_list_is_complete_and_indexed() -> None:
    copter = Client(COPTER)
    copter.send("PARAM_REQUEST_LIST")
    values = of(copter.run(1), "PARAM_VALUE")
    assert [v.param_index for v in values] == list(range(values[0].param_count))
    assert {"FS_GCS_ENABLE", "WPNAV_SPEED", "SYSID_MYGCS"} <= {v.param_id for v in values}


def test_a_parameter_read_by_name_has_index_65535_and_an_unknown_one_is_silence() -> None:
    rover = Client(ROVER)
    (value,) = of(rover.send("PARAM_REQUEST_READ", param_id=b"FS_ACTION", param_index=-1), "PARAM_VALUE")
    assert (value.param_value, value.param_type, value.param_index) == (2.0, 2, 65535)
    assert rover.send("PARAM_REQUEST_READ", param_id=b"NO_SUCH", param_index=-1) == []
    assert rover.send("PARAM_SET", param_id=b"FS_ACTION", param_value=math.nan, param_type=9) == []


def test_the_speed_parameter_sets_the_speed() -> None:
    rover = driving()
    put(rover, "WP_SPEED", 2.0)
    target(rover, 0, 60, alt=0)
    rover.run(5)
    assert rover.vehicle.truth.speed_m_s == pytest.approx(2, abs=0.01)


def test_autopilot_version_follows_its_acknowledgement_and_can_do_mission_int() -> None:
    copter = Client(COPTER)
    copter.log.clear()
    assert copter.command(512, 148) == ACCEPTED
    assert kinds(copter.log) == ["COMMAND_ACK", "AUTOPILOT_VERSION"]
    assert copter.log[-1].capabilities & 4


def test_message_intervals_are_obeyed_and_can_be_switched_off() -> None:
    rover = Client(ROVER)
    assert rover.command(511, 33, 200_000) == ACCEPTED
    assert len(of(rover.run(10), "GLOBAL_POSITION_INT")) == 50
    assert rover.command(511, 33, -1) == ACCEPTED
    assert not of(rover.run(3), "GLOBAL_POSITION_INT")
    assert rover.command(511, 11, 200_000) == FAILED
    assert rover.command(511, 33, math.nan) == FAILED


def test_an_interval_that_is_no_multiple_of_the_step_is_right_on_average() -> None:
    rover = Client(ROVER)
    rover.command(511, 33, 250_000)
    assert len(of(rover.run(20), "GLOBAL_POSITION_INT")) == 80


def test_a_heartbeat_leaves_each_second() -> None:
    assert len(of(Client(ROVER).run(10), "HEARTBEAT")) == 11  # one at power-on


def test_timesync_and_ping_are_answered() -> None:
    rover = Client(ROVER)
    rover.run(2)
    (sync,) = rover.send("TIMESYNC", tc1=0, ts1=1234)
    assert (sync.ts1, sync.tc1) == (1234, 2_000_000_000)
    (pong,) = rover.send("PING", time_usec=5, seq=6, target_system=0, target_component=0)
    assert (pong.seq, pong.target_system, pong.target_component) == (6, 255, 190)


def test_altitudes_are_relative_to_home_and_move_with_it() -> None:
    copter = flying()
    lat, lon, _ = copter.place(0, 0)
    assert copter.command_int(179, 0, lat, lon, 584 + 4.0) == ACCEPTED
    position = of(copter.run(1), "GLOBAL_POSITION_INT")[-1]
    assert position.relative_alt == pytest.approx(6000, abs=100)
    assert position.alt == pytest.approx(594_000, abs=100)
    assert copter.vehicle.truth.alt_rel_m == pytest.approx(6, abs=0.1)


def test_a_copter_that_loses_power_in_the_air_falls_and_keeps_its_parameters_in_use() -> None:
    copter = flying()
    put(copter, "WPNAV_SPEED", 200)
    copter.vehicle.reboot(copter.now_ns)
    truth = copter.vehicle.truth
    assert (truth.alt_rel_m, truth.armed, truth.landed) == (0, False, True)
    assert [copter.command(176, 1, GUIDED), copter.command(400, 1)] == [ACCEPTED, ACCEPTED]
    copter.command(22, 0, 0, 0, 0, 0, 0, 10)
    copter.run(6)
    target(copter, 60, 0)
    copter.run(5)
    assert copter.vehicle.truth.speed_m_s == pytest.approx(2, abs=0.05)


def test_a_reboot_keeps_mission_and_parameters_and_forgets_the_rest() -> None:
    rover = driving()
    rover.upload((*HOME, 0.0), rover.place(0, 10))
    put(rover, "WP_RADIUS", 3.0)
    assert rover.command(246, 1) == DENIED  # armed
    rover.command(400, 0)
    assert rover.command(246, 1) == ACCEPTED
    assert (rover.vehicle.truth.mode, rover.vehicle.truth.armed) == ("MANUAL", False)
    assert len(rover.vehicle.mission) == 2
    assert (
        of(rover.send("PARAM_REQUEST_READ", param_id=b"WP_RADIUS", param_index=-1), "PARAM_VALUE")[0].param_value == 3
    )
