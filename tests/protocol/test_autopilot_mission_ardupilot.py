"""The mission server of ArduPilot, row by row of the measured table "upload and download"."""

from __future__ import annotations

import math

import pytest

from gatar_edge.sim_sitl.mission_items import Ack
from gatar_edge.sim_sitl.testing import COPTER, HOME, ROVER, Client, kinds, of, texts

SLOT_0 = (*HOME, 0.0)
MISSION = ("MISSION_REQUEST", "MISSION_REQUEST_INT", "MISSION_ACK", "MISSION_COUNT", "MISSION_ITEM_INT", "MISSION_ITEM")


@pytest.fixture
def rover() -> Client:
    return Client(ROVER)


def acks(messages: list) -> list[Ack]:
    return [Ack(m.type) for m in of(messages, "MISSION_ACK")]


def download(client: Client) -> list:
    count = of(client.send("MISSION_REQUEST_LIST", mission_type=0), "MISSION_COUNT")[0].count
    items = [m for seq in range(count) for m in client.send("MISSION_REQUEST_INT", seq=seq, mission_type=0)]
    client.send("MISSION_ACK", type=0, mission_type=0)
    return items


def test_it_asks_with_the_old_mission_request_and_accepts_item_int(rover: Client) -> None:
    answers = rover.upload(SLOT_0, rover.place(10, 0))
    assert kinds(answers, *MISSION) == ["MISSION_REQUEST", "MISSION_REQUEST", "MISSION_ACK"]
    assert acks(answers) == [Ack.ACCEPTED]
    assert "Flight plan received" in texts(answers)


def test_slot_0_reads_back_as_home_whatever_was_uploaded(rover: Client) -> None:
    rover.upload((10.0, 20.0, 30.0), rover.place(10, 0))
    home, first = download(rover)
    assert (home.x, home.y, home.z) == (round(HOME[0] * 1e7), round(HOME[1] * 1e7), 584.0)
    assert (first.x, first.y) == tuple(round(v * 1e7) for v in rover.place(10, 0)[:2])


def test_frame_6_reads_back_as_3(rover: Client) -> None:
    rover.upload(SLOT_0, rover.place(10, 0, 7.0))
    assert (download(rover)[1].frame, download(rover)[1].z) == (3, 7.0)


def test_it_asks_again_after_one_second_and_gives_up_after_eight_with_operation_cancelled(rover: Client) -> None:
    rover.send("MISSION_COUNT", count=2, mission_type=0)
    waited = rover.run(7.9)
    assert 6 <= len(of(waited, "MISSION_REQUEST")) <= 9
    assert not of(waited, "MISSION_ACK")
    assert acks(rover.run(0.3)) == [Ack.OPERATION_CANCELLED]
    assert not of(rover.run(3), "MISSION_REQUEST")


def test_giving_up_is_counted_from_the_last_good_item(rover: Client) -> None:
    rover.send("MISSION_COUNT", count=3, mission_type=0)
    rover.run(6)
    rover.item(0, *SLOT_0)
    assert not of(rover.run(7), "MISSION_ACK")
    assert acks(rover.run(1.5)) == [Ack.OPERATION_CANCELLED]


def test_count_truncates_at_once_and_an_aborted_upload_leaves_a_mix(rover: Client) -> None:
    rover.upload(SLOT_0, rover.place(1, 0), rover.place(2, 0), rover.place(3, 0))
    rover.send("MISSION_COUNT", count=3, mission_type=0)
    rover.item(0, *SLOT_0)
    rover.item(1, *rover.place(50, 0))
    rover.run(9)
    mixed = download(rover)
    expected = [rover.place(50, 0)[1], rover.place(2, 0)[1]]
    assert [m.y for m in mixed[1:]] == [round(lon * 1e7) for lon in expected]


def test_a_wrong_seq_or_a_duplicate_gets_invalid_sequence_and_the_upload_stays_open(rover: Client) -> None:
    rover.send("MISSION_COUNT", count=3, mission_type=0)
    rover.item(0, *SLOT_0)
    assert acks(rover.item(0, *SLOT_0)) == [Ack.INVALID_SEQUENCE]
    assert acks(rover.item(2, *rover.place(2, 0))) == [Ack.INVALID_SEQUENCE]
    rover.item(1, *rover.place(1, 0))
    assert acks(rover.item(2, *rover.place(2, 0))) == [Ack.ACCEPTED]


def test_the_last_item_again_and_an_item_without_upload_get_error(rover: Client) -> None:
    assert acks(rover.item(0, *SLOT_0)) == [Ack.ERROR]
    rover.upload(SLOT_0, rover.place(1, 0))
    assert acks(rover.item(1, *rover.place(1, 0))) == [Ack.ERROR]


def test_the_same_client_restarts_at_0_with_a_second_count(rover: Client) -> None:
    rover.send("MISSION_COUNT", count=3, mission_type=0)
    rover.item(0, *SLOT_0)
    assert [m.seq for m in of(rover.send("MISSION_COUNT", count=2, mission_type=0), "MISSION_REQUEST")] == [0]


def test_another_client_is_denied_while_an_upload_is_open(rover: Client) -> None:
    rover.send("MISSION_COUNT", count=2, mission_type=0)
    assert acks(rover.send("MISSION_COUNT", sysid=9, count=2, mission_type=0)) == [Ack.DENIED]
    assert acks(rover.send("MISSION_REQUEST_LIST", sysid=9, mission_type=0)) == [Ack.DENIED]


def test_denied_is_addressed_to_the_one_who_asked(rover: Client) -> None:
    rover.send("MISSION_COUNT", count=2, mission_type=0)
    ack = of(rover.send("MISSION_COUNT", sysid=9, compid=191, count=2, mission_type=0), "MISSION_ACK")[0]
    assert (ack.target_system, ack.target_component) == (9, 191)


def test_a_client_that_cancels_is_ignored(rover: Client) -> None:
    rover.send("MISSION_COUNT", count=2, mission_type=0)
    rover.send("MISSION_ACK", type=int(Ack.OPERATION_CANCELLED), mission_type=0)
    assert of(rover.run(1.3), "MISSION_REQUEST")


@pytest.mark.parametrize(
    ("fields", "result"),
    [
        ({"frame": 1}, Ack.UNSUPPORTED_FRAME),
        ({"frame": 9}, Ack.UNSUPPORTED_FRAME),
        ({"frame": 255}, Ack.UNSUPPORTED_FRAME),
        ({"command": 2000}, Ack.UNSUPPORTED),
        ({"command": 0}, Ack.INVALID),
        ({"param1": math.nan}, Ack.INVALID_PARAM1),
        ({"lat": 95.0}, Ack.INVALID_PARAM5_X),
        ({"z": math.nan}, Ack.INVALID_PARAM7),
        ({"z": 1e6}, Ack.INVALID_PARAM7),
    ],
)
def test_a_bad_item_ends_the_upload_with_its_own_result(rover: Client, fields: dict, result: Ack) -> None:
    rover.send("MISSION_COUNT", count=2, mission_type=0)
    rover.item(0, *SLOT_0)
    values = {"lat": HOME[0], "lon": HOME[1], "z": 0.0} | fields
    assert acks(rover.item(1, **values)) == [result]
    assert not of(rover.run(2), "MISSION_REQUEST")


@pytest.mark.parametrize("frame", [0, 2, 3, 5, 6, 10, 11])
def test_waypoint_frames_that_are_accepted(rover: Client, frame: int) -> None:
    assert acks(rover.upload(SLOT_0, rover.place(1, 0), frame=frame)) == [Ack.ACCEPTED]


def test_too_many_items_get_no_space(rover: Client) -> None:
    assert acks(rover.send("MISSION_COUNT", count=1000, mission_type=0)) == [Ack.NO_SPACE]


def test_count_0_clears(rover: Client) -> None:
    rover.upload(SLOT_0, rover.place(1, 0))
    assert acks(rover.send("MISSION_COUNT", count=0, mission_type=0)) == [Ack.ACCEPTED]
    assert download(rover) == []


def test_count_0_while_driving_leaves_the_rover_on_its_old_leg(rover: Client) -> None:
    rover.upload(SLOT_0, rover.place(0, 60))
    assert rover.command(400, 1) == 0
    assert rover.command(176, 1, 10) == 0
    rover.run(4)
    rover.send("MISSION_COUNT", count=0, mission_type=0)
    rover.run(3)
    assert rover.vehicle.truth.speed_m_s > 4.5


def test_clear_all_is_an_error_while_the_mission_runs_and_accepted_in_hold(rover: Client) -> None:
    rover.upload(SLOT_0, rover.place(0, 60))
    rover.command(400, 1)
    rover.command(176, 1, 10)
    assert acks(rover.send("MISSION_CLEAR_ALL", mission_type=0)) == [Ack.ERROR]
    rover.command(176, 1, 4)
    assert acks(rover.send("MISSION_CLEAR_ALL", mission_type=0)) == [Ack.ACCEPTED]


def test_fence_and_rally_uploads_are_answered_unsupported(rover: Client) -> None:
    answers = of(rover.send("MISSION_COUNT", count=2, mission_type=1), "MISSION_ACK")
    assert [(a.type, a.mission_type) for a in answers] == [(Ack.UNSUPPORTED, 1)]


def test_a_request_behind_the_end_gets_invalid_sequence(rover: Client) -> None:
    rover.upload(SLOT_0, rover.place(1, 0))
    assert acks(rover.send("MISSION_REQUEST_INT", seq=7, mission_type=0)) == [Ack.INVALID_SEQUENCE]


def test_the_old_request_is_answered_with_a_float_item(rover: Client) -> None:
    rover.upload(SLOT_0, rover.place(10, 0))
    (item,) = rover.send("MISSION_REQUEST", seq=1, mission_type=0)
    assert (item.get_type(), item.x) == ("MISSION_ITEM", pytest.approx(rover.place(10, 0)[0], abs=1e-5))


# "running and retasking"


def drive(client: Client, *points: tuple[float, float, float]) -> None:
    client.upload(SLOT_0, *points)
    assert client.command(400, 1) == 0
    assert client.command(176, 1, 10) == 0


def current(client: Client) -> tuple[int, int, int]:
    message = of(client.log, "MISSION_CURRENT")[-1]
    return message.seq, message.total, message.mission_state


def test_a_new_mission_while_running_keeps_the_index_and_says_so_at_each_item(rover: Client) -> None:
    drive(rover, rover.place(0, 15), rover.place(0, 90))
    rover.run(6)
    assert current(rover)[0] == 2
    answers = rover.upload(SLOT_0, rover.place(30, 30), rover.place(60, 30), rover.place(60, 60))
    assert texts(answers).count("Auto mission changed, restarted command") == 4
    rover.run(1.5)
    assert current(rover) == (2, 3, 3)
    rover.run(20)
    assert not [m for m in of(rover.log, "MISSION_ITEM_REACHED")[1:] if m.seq == 1]


def test_a_completed_rover_stays_in_auto_with_state_5_and_does_not_move_after_an_upload(rover: Client) -> None:
    drive(rover, rover.place(0, 10))
    rover.run(10)
    assert current(rover) == (1, 1, 5)
    assert "Mission Complete" in texts(rover.log)
    before = rover.vehicle.truth
    rover.upload(SLOT_0, rover.place(30, 10))
    rover.run(5)
    assert rover.vehicle.truth.mode == "AUTO"
    assert abs(rover.vehicle.truth.east_m - before.east_m) < 0.1


def test_set_current_with_reset_restarts_a_completed_mission(rover: Client) -> None:
    drive(rover, rover.place(0, 10))
    rover.run(10)
    rover.upload(SLOT_0, rover.place(30, 10))
    assert rover.command(224, 1, 1) == 0
    assert current(rover) == (1, 1, 3)
    rover.run(15)
    assert rover.vehicle.truth.east_m == pytest.approx(30, abs=2)


def test_set_current_without_reset_then_mission_start_does_not_move_a_rover(rover: Client) -> None:
    drive(rover, rover.place(0, 10))
    rover.run(10)
    rover.upload(SLOT_0, rover.place(30, 10))
    assert rover.command(224, 1, 0) == 0
    assert current(rover) == (1, 1, 2)
    assert rover.command(300) == 0
    rover.run(5)
    assert abs(rover.vehicle.truth.east_m) < 0.5


def test_set_current_without_reset_then_mission_start_moves_a_copter() -> None:
    copter = Client(COPTER)
    copter.upload(SLOT_0, (*HOME, 10.0), command=22)
    assert [copter.command(176, 1, 4), copter.command(400, 1), copter.command(300)] == [0, 0, 0]
    copter.run(8)
    assert current(copter)[2] == 5
    copter.send("MISSION_COUNT", count=2, mission_type=0)
    copter.item(0, *SLOT_0)
    copter.item(1, *copter.place(0, 20, 10.0))
    assert copter.command(224, 1, 0) == 0
    copter.run(2)
    assert copter.vehicle.truth.speed_m_s < 0.1
    assert copter.command(300) == 0
    copter.run(10)
    assert copter.vehicle.truth.north_m == pytest.approx(20, abs=2)


def test_mid_drive_retasking_with_reset_turns_the_rover_at_once(rover: Client) -> None:
    drive(rover, rover.place(0, 80))
    rover.run(5)
    rover.upload(SLOT_0, rover.place(40, 20))
    assert rover.command(224, 1, 1) == 0
    rover.run(14)
    assert rover.vehicle.truth.east_m == pytest.approx(40, abs=2)


def test_an_item_out_of_range_is_denied(rover: Client) -> None:
    rover.upload(SLOT_0, rover.place(0, 10))
    assert rover.command(224, 5, 1) == 2


def test_set_current_0_means_the_first_item_after_home(rover: Client) -> None:
    rover.upload(SLOT_0, rover.place(0, 10))
    assert rover.command(224, 0, 1) == 0
    assert current(rover)[0] == 1


def test_mission_set_current_is_answered_by_mission_current(rover: Client) -> None:
    rover.upload(SLOT_0, rover.place(0, 10), rover.place(0, 20))
    answers = rover.send("MISSION_SET_CURRENT", seq=2)
    assert [m.seq for m in of(answers, "MISSION_CURRENT")] == [2]


def test_mission_current_excludes_home_and_names_the_four_states(rover: Client) -> None:
    rover.run(1)
    assert current(rover) == (0, 0, 1)
    rover.upload(SLOT_0, rover.place(0, 10))
    assert current(rover) == (0, 1, 2)


def test_a_waypoint_at_the_present_position_is_skipped_at_once(rover: Client) -> None:
    drive(rover, rover.place(0, 0), rover.place(0, 40))
    rover.run(0.5)
    assert [m.seq for m in of(rover.log, "MISSION_ITEM_REACHED")] == [1]
    assert current(rover)[0] == 2


def test_waypoint_param2_is_ignored_and_param1_is_a_delay(rover: Client) -> None:
    rover.upload(SLOT_0, rover.place(0, 10), rover.place(0, 30), param1=5.0, param2=9.0)
    rover.command(400, 1)
    rover.command(176, 1, 10)
    rover.run(6)
    assert rover.vehicle.truth.north_m == pytest.approx(10, abs=0.5)
    rover.run(6)
    assert rover.vehicle.truth.north_m > 12
