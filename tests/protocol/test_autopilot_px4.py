"""The PX4 dialect, row by row of the measured tables."""

from __future__ import annotations

import math
import struct
from dataclasses import replace

import pytest

from gatar_edge.sim_sitl.mission_items import Ack
from gatar_edge.sim_sitl.testing import Client, kinds, of, px4_copter, px4_rover, texts

LOITER = 0x03040000
ACCEPTED, REJECTED, UNSUPPORTED, FAILED = 0, 1, 3, 4
HOME_ALT = 584.0


@pytest.fixture
def rover() -> Client:
    return Client(px4_rover())


@pytest.fixture
def quad() -> Client:
    client = Client(px4_copter())
    assert client.command(400, 1) == ACCEPTED
    assert client.command(22, 0, 0, 0, math.nan, math.nan, math.nan, HOME_ALT + 10) == ACCEPTED
    client.run(7)
    assert client.vehicle.truth.alt_rel_m == pytest.approx(10, abs=0.5)
    return client


def acks(messages: list) -> list[Ack]:
    return [Ack(m.type) for m in of(messages, "MISSION_ACK")]


def mode(client: Client) -> int:
    return int(of(client.run(1.01), "HEARTBEAT")[-1].custom_mode)


def to_mission(client: Client) -> list[int]:
    answers = client.send(
        "COMMAND_LONG", command=176, confirmation=0,
        param1=1, param2=4, param3=4, param4=0, param5=0, param6=0, param7=0,
    )  # fmt: skip
    return [a.result for a in of(answers, "COMMAND_ACK")]


def wait_for_total(client: Client, total: int) -> None:
    for _ in range(20):
        client.run(0.1)
        if of(client.log, "MISSION_CURRENT") and of(client.log, "MISSION_CURRENT")[-1].total == total:
            return
    raise AssertionError(f"total never was {total}")


def drive(client: Client, *points: tuple[float, float, float]) -> None:
    client.upload(*points)
    wait_for_total(client, len(points))
    assert client.command(400, 1) == ACCEPTED
    assert to_mission(client) == [ACCEPTED, ACCEPTED]


# "upload and download"


def test_it_asks_with_mission_request_int_and_item_0_is_a_real_item(rover: Client) -> None:
    answers = rover.upload(rover.place(0, 10), rover.place(0, 20))
    assert kinds(answers) == ["MISSION_REQUEST_INT", "MISSION_REQUEST_INT", "MISSION_ACK"]
    rover.send("MISSION_REQUEST_LIST", mission_type=0)
    (item,) = rover.send("MISSION_REQUEST_INT", seq=0, mission_type=0)
    assert (item.x, item.frame, item.current) == (round(rover.place(0, 10)[0] * 1e7), 6, 1)


def test_it_asks_again_after_250_ms_and_gives_up_after_five_seconds_without_an_ack(rover: Client) -> None:
    rover.send("MISSION_COUNT", count=2, mission_type=0)
    waited = rover.run(4.95, step_s=0.05)
    assert 18 <= len(of(waited, "MISSION_REQUEST_INT")) <= 20
    given_up = rover.run(0.2, step_s=0.05)
    assert "Operation timeout" in texts(given_up)
    assert not of(given_up, "MISSION_ACK")


def test_an_aborted_upload_keeps_the_old_mission(rover: Client) -> None:
    rover.upload(rover.place(0, 10), rover.place(0, 20))
    rover.send("MISSION_COUNT", count=1, mission_type=0)
    rover.run(6)
    assert of(rover.send("MISSION_REQUEST_LIST", mission_type=0), "MISSION_COUNT")[0].count == 2


def test_a_wrong_or_repeated_item_is_ignored_in_silence(rover: Client) -> None:
    rover.send("MISSION_COUNT", count=2, mission_type=0)
    assert rover.item(1, *rover.place(0, 10)) == []
    rover.item(0, *rover.place(0, 10))
    assert rover.item(0, *rover.place(0, 10)) == []


def test_the_last_item_again_is_accepted_and_an_item_without_upload_is_an_error(rover: Client) -> None:
    assert acks(rover.item(0, *rover.place(0, 10))) == [Ack.ERROR]
    rover.upload(rover.place(0, 10), rover.place(0, 20))
    assert acks(rover.item(1, *rover.place(0, 20))) == [Ack.ACCEPTED]


def test_a_second_count_restarts_at_item_0_only(rover: Client) -> None:
    rover.send("MISSION_COUNT", count=2, mission_type=0)
    assert kinds(rover.send("MISSION_COUNT", count=2, mission_type=0)) == ["MISSION_REQUEST_INT"]
    rover.item(0, *rover.place(0, 10))
    assert acks(rover.send("MISSION_COUNT", count=2, mission_type=0)) == [Ack.ERROR]


def test_another_client_gets_error_for_a_count_and_only_a_text_for_a_list(rover: Client) -> None:
    rover.send("MISSION_COUNT", count=2, mission_type=0)
    assert acks(rover.send("MISSION_COUNT", sysid=9, count=2, mission_type=0)) == [Ack.ERROR]
    answers = rover.send("MISSION_REQUEST_LIST", sysid=9, mission_type=0)
    assert kinds(answers) == ["STATUSTEXT"]


def test_a_client_that_cancels_stops_the_upload_at_once(rover: Client) -> None:
    rover.send("MISSION_COUNT", count=2, mission_type=0)
    rover.send("MISSION_ACK", type=int(Ack.OPERATION_CANCELLED), mission_type=0)
    assert not of(rover.run(2), "MISSION_REQUEST_INT")


@pytest.mark.parametrize("frame", [1, 9, 10, 11, 255])
def test_frames_that_end_the_upload(rover: Client, frame: int) -> None:
    assert acks(rover.upload(rover.place(0, 10), frame=frame)) == [Ack.UNSUPPORTED_FRAME]


def test_an_unknown_command_ends_the_upload(rover: Client) -> None:
    assert acks(rover.upload(rover.place(0, 10), command=2000)) == [Ack.UNSUPPORTED]


@pytest.mark.parametrize("point", [(95.0, 0.0, 0.0), (0.0, 0.0, math.nan)])
def test_latitude_95_and_no_altitude_are_accepted(rover: Client, point: tuple[float, float, float]) -> None:
    assert acks(rover.upload(point, param1=math.nan)) == [Ack.ACCEPTED]


def test_too_many_items_get_no_space(rover: Client) -> None:
    assert acks(rover.send("MISSION_COUNT", count=10_001, mission_type=0)) == [Ack.NO_SPACE]


def test_a_repeated_list_rewinds_the_download(rover: Client) -> None:
    rover.upload(rover.place(0, 10), rover.place(0, 20))
    rover.send("MISSION_REQUEST_LIST", mission_type=0)
    rover.send("MISSION_REQUEST_INT", seq=0, mission_type=0)
    rover.send("MISSION_REQUEST_LIST", mission_type=0)
    assert acks(rover.send("MISSION_REQUEST_INT", seq=1, mission_type=0)) == [Ack.ERROR]


def test_set_current_and_count_are_refused_while_a_download_is_open(rover: Client) -> None:
    rover.upload(rover.place(0, 10), rover.place(0, 20))
    rover.send("MISSION_REQUEST_LIST", mission_type=0)
    assert texts(rover.send("MISSION_SET_CURRENT", seq=1)) == ["WPM: IGN WP CURR CMD: Busy"]
    assert acks(rover.send("MISSION_COUNT", count=1, mission_type=0)) == [Ack.ERROR]
    rover.send("MISSION_ACK", type=0, mission_type=0)
    assert rover.send("MISSION_SET_CURRENT", seq=1) == []
    rover.run(1.1)
    assert of(rover.log, "MISSION_CURRENT")[-1].seq == 1


def test_clear_all_is_accepted_while_driving_and_ends_in_loiter(rover: Client) -> None:
    drive(rover, rover.place(0, 60))
    rover.run(4)
    answers = rover.send("MISSION_CLEAR_ALL", mission_type=0)
    assert acks(answers) == [Ack.ACCEPTED]
    assert "No valid mission available, loitering" in texts(answers)
    assert mode(rover) == LOITER
    rover.run(3)
    assert rover.vehicle.truth.speed_m_s == 0
    assert of(rover.log, "MISSION_CURRENT")[-1].total == 65535


def test_count_0_while_driving_ends_in_loiter(rover: Client) -> None:
    drive(rover, rover.place(0, 60))
    rover.run(4)
    rover.send("MISSION_COUNT", count=0, mission_type=0)
    assert mode(rover) == LOITER


# "running and retasking"


def test_after_completion_it_loiters_in_state_5_and_reached_is_repeated_at_1_hz_ten_times(rover: Client) -> None:
    drive(rover, rover.place(0, 10))
    rover.run(25)
    assert [m.seq for m in of(rover.log, "MISSION_ITEM_REACHED")] == [0] * 10
    assert "Mission finished, loitering" in texts(rover.log)
    assert mode(rover) == LOITER
    last = of(rover.log, "MISSION_CURRENT")[-1]
    assert (last.seq, last.total, last.mission_state, last.mission_mode) == (0, 1, 5, 2)


def test_a_new_mission_after_completion_starts_at_the_old_clamped_index(rover: Client) -> None:
    drive(rover, rover.place(0, 10), rover.place(0, 20), rover.place(0, 30))
    rover.run(20)
    rover.upload(rover.place(20, 30), rover.place(40, 30))
    wait_for_total(rover, 2)
    assert to_mission(rover) == [ACCEPTED, ACCEPTED]
    rover.run(1)
    assert of(rover.log, "MISSION_CURRENT")[-1].seq == 1


def test_a_new_mission_while_running_keeps_the_index_without_a_text(rover: Client) -> None:
    drive(rover, rover.place(0, 10), rover.place(0, 90))
    rover.run(6)
    answers = rover.upload(rover.place(30, 30), rover.place(60, 30), rover.place(60, 60))
    assert texts(answers) == []
    rover.run(1.1)
    last = of(rover.log, "MISSION_CURRENT")[-1]
    assert (last.seq, last.total) == (1, 3)


def test_a_shorter_mission_while_running_clamps_the_index(rover: Client) -> None:
    drive(rover, rover.place(0, 10), rover.place(0, 20), rover.place(0, 90))
    rover.run(10)
    rover.upload(rover.place(30, 30))
    rover.run(1.1)
    last = of(rover.log, "MISSION_CURRENT")[-1]
    assert (last.seq, last.total, last.mission_state) == (0, 1, 3)


def test_mid_drive_mission_set_current_0_turns_it_to_the_new_first_item(rover: Client) -> None:
    drive(rover, rover.place(0, 80))
    rover.run(5)
    rover.upload(rover.place(40, 20))
    rover.send("MISSION_SET_CURRENT", seq=0)
    rover.run(16)
    assert rover.vehicle.truth.east_m == pytest.approx(40, abs=2.5)


def test_do_set_mission_current_is_unsupported(rover: Client) -> None:
    rover.upload(rover.place(0, 10))
    assert rover.command(224, 0, 1) == UNSUPPORTED


def test_mission_mode_right_after_clear_and_upload_is_mostly_refused_although_accepted() -> None:
    refused = 0
    for seed in range(20):
        rover = Client(px4_rover(seed=seed))
        rover.upload(rover.place(0, 10))
        rover.send("MISSION_CLEAR_ALL", mission_type=0)
        rover.upload(rover.place(0, 10))
        results = to_mission(rover)
        assert results[0] == ACCEPTED
        refused += results[1] == REJECTED
        wait_for_total(rover, 1)
        assert to_mission(rover) == [ACCEPTED, ACCEPTED]
    assert 10 <= refused < 20


def test_mission_mode_without_a_mission_is_acknowledged_but_the_heartbeat_tells_the_truth(rover: Client) -> None:
    assert to_mission(rover) == [ACCEPTED, REJECTED]
    assert mode(rover) == LOITER


def test_waypoint_param2_is_the_acceptance_radius_of_a_multicopter(quad: Client) -> None:
    quad.upload(quad.place(30, 0, 10.0), quad.place(60, 0, 10.0), param2=15.0)
    wait_for_total(quad, 2)
    to_mission(quad)
    while not of(quad.log, "MISSION_ITEM_REACHED"):
        quad.run(0.1)
    assert quad.vehicle.truth.east_m < 17


# "modes, targets, failsafe"


def reposition(client: Client, east: float, north: float, z: float, *, flag: int = 1, frame: int = 0) -> int | None:
    lat, lon, _ = client.place(east, north)
    return client.command_int(192, frame, lat, lon, z, -1, flag)


def test_do_reposition_is_above_the_sea_whatever_its_frame_says(quad: Client) -> None:
    assert reposition(quad, 20, 0, HOME_ALT + 12) == ACCEPTED
    quad.run(10)
    truth = quad.vehicle.truth
    assert (truth.east_m, truth.alt_rel_m) == (pytest.approx(20, abs=0.3), pytest.approx(12, abs=0.3))
    assert reposition(quad, 25, 0, 10.0, frame=6) == ACCEPTED
    quad.run(15)
    assert quad.vehicle.truth.landed


def test_do_reposition_without_flag_1_is_unsupported(quad: Client) -> None:
    assert reposition(quad, 20, 0, HOME_ALT + 10, flag=0) == UNSUPPORTED


def test_do_reposition_accepts_latitude_95_and_nan(quad: Client) -> None:
    assert quad.command_int(192, 0, 95.0, 0.0, HOME_ALT + 10, -1, 1) == ACCEPTED
    assert quad.command(192, -1, 1, 0, math.nan, math.nan, math.nan, HOME_ALT + 15) == ACCEPTED
    quad.run(6)
    assert quad.vehicle.truth.alt_rel_m == pytest.approx(15, abs=0.3)


def test_do_reposition_armed_on_the_ground_takes_off_and_disarmed_does_nothing() -> None:
    quad = Client(px4_copter())
    assert reposition(quad, 0, 0, HOME_ALT + 10) == ACCEPTED
    quad.run(2)
    assert quad.vehicle.truth.landed
    quad.command(400, 1)
    assert reposition(quad, 0, 0, HOME_ALT + 10) == ACCEPTED
    quad.run(7)
    assert quad.vehicle.truth.alt_rel_m == pytest.approx(10, abs=0.3)


def test_do_reposition_pulls_it_out_of_mission_mode(rover: Client) -> None:
    drive(rover, rover.place(0, 60))
    rover.run(2)
    assert reposition(rover, 30, 0, HOME_ALT) == ACCEPTED
    assert mode(rover) == LOITER
    rover.run(14)
    assert rover.vehicle.truth.east_m == pytest.approx(30, abs=0.3)


def target(client: Client, east: float, north: float, alt: float, *, frame: int = 5, mask: int = 0x0DF8) -> list:
    lat, lon, _ = client.place(east, north)
    return client.send(
        "SET_POSITION_TARGET_GLOBAL_INT", time_boot_ms=0, coordinate_frame=frame, type_mask=mask,
        lat_int=round(lat * 1e7), lon_int=round(lon * 1e7), alt=alt,
        vx=0, vy=0, vz=0, afx=0, afy=0, afz=0, yaw=0, yaw_rate=0,
    )  # fmt: skip


def to_offboard(client: Client) -> None:
    client.command(176, 1, 6)


def test_offboard_needs_a_stream_and_is_lost_within_a_second_of_its_end(quad: Client) -> None:
    to_offboard(quad)
    assert mode(quad) == LOITER
    for _ in range(40):
        target(quad, 20, 0, HOME_ALT + 10)
        quad.run(0.25)
        if quad.vehicle.truth.mode != "OFFBOARD":
            to_offboard(quad)
    assert quad.vehicle.truth.east_m == pytest.approx(20, abs=0.5)
    quad.run(1.1)
    assert quad.vehicle.truth.mode == "AUTO.LOITER"


def test_frame_3_is_rejected_with_a_text(quad: Client) -> None:
    assert texts(target(quad, 20, 0, 10, frame=3)) == ["SET_POSITION_TARGET_GLOBAL_INT invalid frame 3"]


def test_a_target_outside_offboard_changes_nothing(quad: Client) -> None:
    assert target(quad, 20, 0, HOME_ALT + 10) == []
    quad.run(5)
    assert quad.vehicle.truth.east_m == pytest.approx(0, abs=0.1)


def beat(client: Client, seconds: int, mav_type: int = 6) -> None:
    for _ in range(seconds):
        client.send(
            "HEARTBEAT", type=mav_type, autopilot=8, base_mode=0, custom_mode=0, system_status=4, mavlink_version=3
        )
        client.run(1)


def put_int(client: Client, name: str, value: int) -> None:
    wire = struct.unpack("<f", struct.pack("<i", value))[0]
    (answer,) = of(client.send("PARAM_SET", param_id=name.encode(), param_value=wire, param_type=6), "PARAM_VALUE")
    assert struct.pack("<f", answer.param_value) == struct.pack("<i", value)


@pytest.mark.parametrize(("action", "name", "after_s"), [(1, "AUTO.LOITER", 7.3), (2, "AUTO.RTL", 12.3)])
def test_the_data_link_failsafe_acts_when_measured(rover: Client, action: int, name: str, after_s: float) -> None:
    put_int(rover, "NAV_DLL_ACT", action)
    put_int(rover, "COM_DL_LOSS_T", 5)
    drive(rover, rover.place(0, 200))
    beat(rover, 3)
    rover.run(after_s - 1 - 0.4)
    assert rover.vehicle.truth.mode != name
    rover.run(0.6)
    assert rover.vehicle.truth.mode == name
    rover.run(1)
    assert of(rover.log, "HEARTBEAT")[-1].system_status == 5
    beat(rover, 2)
    assert (rover.vehicle.truth.mode, "GCS connection regained" in texts(rover.log)) == (name, True)


def test_only_heartbeats_of_a_ground_station_count(rover: Client) -> None:
    put_int(rover, "NAV_DLL_ACT", 2)
    put_int(rover, "COM_DL_LOSS_T", 5)
    drive(rover, rover.place(0, 200))
    beat(rover, 3, mav_type=18)
    rover.run(20)
    assert rover.vehicle.truth.mode == "AUTO.MISSION"


def test_by_default_it_goes_on_without_a_ground_station(rover: Client) -> None:
    drive(rover, rover.place(0, 200))
    beat(rover, 3)
    rover.run(30)
    assert rover.vehicle.truth.mode == "AUTO.MISSION"


def test_integer_parameters_travel_as_bits(rover: Client) -> None:
    (value,) = of(rover.send("PARAM_REQUEST_READ", param_id=b"COM_DL_LOSS_T", param_index=-1), "PARAM_VALUE")
    assert (struct.pack("<f", value.param_value), value.param_type) == (struct.pack("<i", 10), 6)


def test_it_says_12_and_its_modes_and_that_a_driving_rover_is_in_the_air(rover: Client) -> None:
    beat_ = of(rover.run(1.1), "HEARTBEAT")[-1]
    assert (beat_.autopilot, beat_.type, beat_.custom_mode, beat_.base_mode, beat_.system_status) == (
        12,
        10,
        LOITER,
        29,
        3,
    )
    rover.command(400, 1)
    assert of(rover.run(1.1), "HEARTBEAT")[-1].base_mode == 157
    assert of(rover.log, "EXTENDED_SYS_STATE")[-1].landed_state == 2


def test_the_echo_is_frame_5_mask_0(quad: Client) -> None:
    reposition(quad, 20, 0, HOME_ALT + 10)
    echo = of(quad.run(1.2), "POSITION_TARGET_GLOBAL_INT")[-1]
    assert (echo.coordinate_frame, echo.type_mask) == (5, 0)
    assert abs(echo.lon_int - round(quad.place(20, 0)[1] * 1e7)) <= 1


def test_arming_is_refused_until_the_ekf_is_ready() -> None:
    rover = Client(replace(px4_rover(), ekf_ready_s=4))
    assert rover.command(400, 1) == REJECTED
    rover.run(4.1)
    assert rover.command(400, 1) == ACCEPTED


def test_a_quad_takes_off_for_its_mission_and_lands_at_its_end() -> None:
    quad = Client(px4_copter())
    quad.send("MISSION_COUNT", count=2, mission_type=0)
    quad.item(0, *quad.place(10, 0, 10.0))
    quad.item(1, *quad.place(10, 0), command=21)
    wait_for_total(quad, 2)
    quad.command(400, 1)
    assert to_mission(quad) == [ACCEPTED, ACCEPTED]
    quad.run(25)
    assert (quad.vehicle.truth.armed, quad.vehicle.truth.landed) == (False, True)
    assert "Disarmed by landing" in texts(quad.log)


def test_the_current_item_is_told_once_a_second_whatever_interval_is_asked_for(rover: Client) -> None:
    assert rover.command(511, 42, 500_000) == FAILED
    assert len(of(rover.run(10), "MISSION_CURRENT")) == pytest.approx(10, abs=1)
