"""The doctor and the errands on simulated autopilots of each stack, in lock-step."""

from __future__ import annotations

import dataclasses
import random

import pytest
from guests import STACKS, Site
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from gatar_edge.bridge.companion_loss import Situation, companion_loss, loss_parameters
from gatar_edge.bridge.doctor import examine
from gatar_edge.bridge.errands import MissionErrand, OriginErrand, OriginOutcome
from gatar_edge.bridge.mission_states import Result
from gatar_edge.bridge.profiles import PROFILES
from gatar_edge.bridge.survey import Survey
from gatar_edge.bridge.verdict import Level
from gatar_edge.bridge.wire import GlobalOrigin
from gatar_edge.sim_sitl.testing import Client
from gatar_edge.types import NS_PER_S

BY_NAME = {profile.name: profile for profile in PROFILES}
each_stack = pytest.mark.parametrize("stack", list(STACKS))
ORIGIN = GlobalOrigin(473977420, 85455940, 488_000)


def site(stack: str, **changes: object) -> Site:
    return Site(dataclasses.replace(STACKS[stack], **changes))  # type: ignore[arg-type]


def client_of(place: Site, sysid: int = 255) -> Client:
    """A ground station that speaks to the vehicle of a site."""
    client = Client(place.vehicle.config, sysid=sysid)
    client.vehicle, client.now_ns = place.vehicle, place.now_ns
    return client


@each_stack
def test_a_vehicle_as_it_comes_has_nothing_that_fails_and_is_warned_of_its_missing_failsafe(stack: str) -> None:
    report = examine(site(stack).survey())
    assert report.good
    assert report.findings["profile"].text == stack
    assert report.findings["companion loss"].level is Level.WARN
    assert {f.level for name, f in report.findings.items() if name not in ("companion loss", "fence", "signing")} == {
        Level.OK
    }


@pytest.mark.parametrize(("behave", "level"), [(0, Level.OK), (2, Level.FAIL)])
def test_a_rover_that_leaves_auto_at_the_end_of_its_mission_is_told_of(behave: int, level: Level) -> None:
    place = site("ardupilot-rover")
    client_of(place).send("PARAM_SET", param_id=b"MIS_DONE_BEHAVE", param_value=behave, param_type=2)
    assert examine(place.survey()).findings["mission"].level is level


@each_stack
def test_a_survey_only_asks(stack: str) -> None:
    place = site(stack)
    before = place.vehicle.truth
    place.survey()
    frames = mavlink.MAVLink(None).parse_buffer(b"".join(place.sent)) or []
    asked = {(frame.get_type(), getattr(frame, "command", 0)) for frame in frames}
    commands = {
        ("COMMAND_LONG", mavlink.MAV_CMD_SET_MESSAGE_INTERVAL),
        ("COMMAND_LONG", mavlink.MAV_CMD_REQUEST_MESSAGE),
    }
    assert asked == {("TIMESYNC", 0), ("PARAM_REQUEST_READ", 0), *commands}
    assert place.vehicle.truth == before


@each_stack
def test_a_survey_takes_ten_seconds_and_over_a_bad_link_it_still_ends_complete(stack: str) -> None:
    clean, bad = site(stack), site(stack)
    rng = random.Random(stack)
    bad.lose = lambda to_vehicle: rng.random() < 0.3
    clean_facts = clean.survey()
    assert clean.now_ns <= 10 * NS_PER_S
    facts = bad.survey()
    assert bad.now_ns <= 15 * NS_PER_S
    assert facts.parameters == clean_facts.parameters
    assert facts.version == clean_facts.version


def test_the_rates_that_are_measured_are_those_that_come() -> None:
    facts = site("ardupilot-copter").survey()
    assert facts.rates_hz[33] == pytest.approx(5.0, abs=0.3)
    assert facts.rates_hz[1] == pytest.approx(0.5, abs=0.2)


def test_an_answer_to_somebody_elses_question_of_the_clock_is_not_taken_for_ours() -> None:
    place = site("ardupilot-copter")
    survey = Survey(None, 0, shared_link=True, seed=1)
    place.host(survey, 2.5)
    before = survey.facts(place.now_ns).round_trips_ns
    place.lose = lambda to_vehicle: to_vehicle  # ours wait for their answers
    place.host(survey, 1.0)
    for second in range(5):
        place.vehicle.receive(_timesync(second), place.now_ns)
        place.host(survey, 0.1)
    assert survey.facts(place.now_ns).round_trips_ns == before


def _timesync(second: int) -> bytes:
    frame: bytes = mavlink.MAVLink_timesync_message(0, second * NS_PER_S).pack(mavlink.MAVLink(None, 255, 190))
    return frame


def test_before_the_estimator_is_ready_position_home_and_origin_fail() -> None:
    report = examine(site("ardupilot-copter", ekf_ready_s=600.0).survey())
    assert not report.good
    assert {name for name, f in report.findings.items() if f.level is Level.FAIL} == {"home", "origin"}


def test_of_several_vehicles_on_a_link_none_is_chosen_unless_told() -> None:
    place = site("ardupilot-copter")
    heartbeat = mavlink.MAVLink_heartbeat_message(10, 3, 65, 0, 3, 3)
    survey = Survey(None, 0, shared_link=True, seed=1)
    survey.receive(heartbeat.pack(mavlink.MAVLink(None, 9, 1)), 0)
    place.host(survey, 5.0)
    assert survey.visit.vehicle is None
    assert survey.visit.autopilots == (1, 9)
    told = Survey(1, 0, shared_link=True, seed=1)
    told.receive(heartbeat.pack(mavlink.MAVLink(None, 9, 1)), 0)
    place.host(told, 5.0)
    assert told.visit.vehicle == (1, 1)


def test_gimbals_companions_and_ground_stations_are_no_autopilots() -> None:
    place = site("px4-rover")
    survey = Survey(None, 0, shared_link=True, seed=1)
    for sysid, kind, autopilot in ((7, 26, 8), (8, 18, 8), (255, 6, 0)):
        heartbeat = mavlink.MAVLink_heartbeat_message(kind, autopilot, 0, 0, 4, 3)
        survey.receive(heartbeat.pack(mavlink.MAVLink(None, sysid, 190)), 0)
    place.host(survey, 5.0)
    assert survey.visit.autopilots == (4,)
    assert survey.visit.vehicle == (4, 1)


def test_an_autopilot_without_a_profile_is_named() -> None:
    survey = Survey(None, 0, shared_link=True, seed=1)
    fixed_wing = mavlink.MAVLink_heartbeat_message(1, 3, 65, 0, 3, 3).pack(mavlink.MAVLink(None, 9, 1))
    for second in range(5):
        survey.receive(fixed_wing, second * NS_PER_S)
        survey.poll(second * NS_PER_S)
    report = examine(survey.facts(5 * NS_PER_S))
    assert report.findings["profile"].level is Level.FAIL
    assert "MAV_TYPE 1" in report.findings["profile"].text


@pytest.mark.parametrize(
    ("stack", "parameters", "mode"),
    [
        ("ardupilot-copter", {"FS_GCS_ENABLE": 0.0}, "GUIDED"),
        ("ardupilot-copter", {"FS_GCS_ENABLE": 1.0}, "GUIDED"),  # SYSID_MYGCS is 255, not the companion
        ("ardupilot-copter", {"FS_GCS_ENABLE": 1.0, "SYSID_MYGCS": 1.0}, "RTL"),
        ("ardupilot-copter", {"FS_GCS_ENABLE": 7.0, "SYSID_MYGCS": 1.0}, "BRAKE"),
        ("ardupilot-copter", {"FS_GCS_ENABLE": 5.0, "SYSID_MYGCS": 1.0}, "LAND"),
        ("ardupilot-rover", {"FS_GCS_ENABLE": 0.0}, "GUIDED"),
        ("ardupilot-rover", {"FS_GCS_ENABLE": 1.0, "SYSID_MYGCS": 2.0}, "HOLD"),
        ("ardupilot-rover", {"FS_GCS_ENABLE": 1.0, "SYSID_MYGCS": 2.0, "FS_ACTION": 1.0}, "RTL"),
    ],
)
def test_what_the_doctor_foretells_is_what_the_vehicle_does(
    stack: str, parameters: dict[str, float], mode: str
) -> None:
    place = site(stack)
    profile, sysid = BY_NAME[stack], STACKS[stack].sysid
    client = client_of(place, sysid=sysid)
    for name, value in parameters.items():
        client.send("PARAM_SET", param_id=name.encode(), param_value=value, param_type=9)
    client.command(mavlink.MAV_CMD_DO_SET_MODE, 1, profile.guided_mode)
    client.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    client.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 20)
    for _ in range(10):
        client.send("HEARTBEAT", type=18, autopilot=8, base_mode=0, custom_mode=0, system_status=4, mavlink_version=3)
        client.run(1.0)
    read = {n: place.vehicle._core.params[n] for n in loss_parameters(profile) if n in place.vehicle._core.params}
    outcome = companion_loss(read, Situation(profile, profile.guided_mode, sysid))
    silent_since_ns, acted_s = client.now_ns - NS_PER_S, None
    while acted_s is None and client.now_ns < silent_since_ns + 30 * NS_PER_S:
        client.run(0.1)
        if place.vehicle.truth.mode != "GUIDED":
            acted_s = (client.now_ns - silent_since_ns) / NS_PER_S
    assert place.vehicle.truth.mode == mode
    assert outcome.watched == (acted_s is not None)
    if outcome.after_s is not None and acted_s is not None:
        assert acted_s == pytest.approx(outcome.after_s, abs=0.3)


@each_stack
def test_a_mission_is_downloaded_and_cleared(stack: str) -> None:
    place = site(stack)
    client = client_of(place)
    client.upload(*(client.place(10.0 * i, 0.0) for i in range(4)))
    download = MissionErrand(None, place.now_ns)
    place.host(download)
    assert download.result is Result.DOWNLOADED
    assert len(download.items) == 4
    clear = MissionErrand(None, place.now_ns, clear=True)
    place.host(clear)
    assert clear.result is Result.CLEARED
    assert not place.vehicle.mission[BY_NAME[stack].first_item_seq :]


@each_stack
def test_nothing_is_cleared_and_no_origin_is_set_while_armed(stack: str) -> None:
    place = site(stack)
    client = client_of(place)
    client.upload(*(client.place(10.0 * i, 0.0) for i in range(4)))
    client.command(mavlink.MAV_CMD_DO_SET_MODE, 1, *BY_NAME[stack].mode_params(BY_NAME[stack].guided_mode))
    assert client.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == 0
    clear, origin = MissionErrand(None, place.now_ns, clear=True), OriginErrand(None, place.now_ns, ORIGIN)
    place.host(clear)
    place.host(origin, 9.0)
    assert clear.refused
    assert not (clear.result and clear.result.ok)
    assert origin.outcome is OriginOutcome.ARMED
    assert len(place.vehicle.mission) == 4
    frames = mavlink.MAVLink(None).parse_buffer(b"".join(place.sent)) or []
    assert {"MISSION_CLEAR_ALL", "SET_GPS_GLOBAL_ORIGIN"}.isdisjoint(frame.get_type() for frame in frames)


@each_stack
def test_a_vehicle_without_gps_takes_an_origin_and_tells_it(stack: str) -> None:
    place = site(stack, ekf_ready_s=1e6)
    rng = random.Random(7)
    place.lose = lambda to_vehicle: rng.random() < 0.3
    errand = OriginErrand(None, 0, ORIGIN)
    place.host(errand)
    assert errand.outcome is OriginOutcome.SET
    assert examine(place.survey()).findings["origin"].level is Level.OK


@each_stack
def test_an_origin_from_a_gps_is_kept_and_that_is_said(stack: str) -> None:
    errand = OriginErrand(None, 0, ORIGIN)
    site(stack).host(errand)
    assert errand.outcome is OriginOutcome.KEPT
    assert errand.told is not None
    assert errand.told.lat_e7 == round(STACKS[stack].home_lat_deg * 1e7)


def test_a_vehicle_that_answers_nothing_ends_each_errand() -> None:
    for errand in (MissionErrand(None, 0), MissionErrand(None, 0, clear=True), OriginErrand(None, 0, ORIGIN)):
        place = site("ardupilot-rover")
        place.lose = lambda to_vehicle: to_vehicle
        place.host(errand, 100.0)
        assert errand.done(place.now_ns)
    assert errand.outcome is OriginOutcome.NO_ANSWER
    deaf = site("ardupilot-rover")
    deaf.lose = lambda to_vehicle: to_vehicle
    assert examine(deaf.survey()).findings["answers"].level is Level.FAIL
