"""The doctor's verdicts, the outcomes of a companion's death, and reading parameters, each by itself."""

from __future__ import annotations

import dataclasses
import math
import struct

import pytest

from gatar_edge.bridge import dialect, wire
from gatar_edge.bridge.companion_loss import Situation, companion_loss, loss_parameters
from gatar_edge.bridge.dialect import MessageId
from gatar_edge.bridge.doctor import CHECKS, FIRST, examine
from gatar_edge.bridge.own_fence import fence_parameters, own_fence
from gatar_edge.bridge.parameters import TRIES, ParameterReader, value_of
from gatar_edge.bridge.profiles import PROFILES
from gatar_edge.bridge.profiles.base import Profile
from gatar_edge.bridge.profiles.px4_modes import OFFBOARD
from gatar_edge.bridge.rates import WANTED_HZ
from gatar_edge.bridge.settings import DriverConfig
from gatar_edge.bridge.survey import Facts
from gatar_edge.bridge.telemetry import Telemetry
from gatar_edge.bridge.verdict import Level
from gatar_edge.bridge.visit import Heard
from gatar_edge.bridge.wire import Heartbeat
from gatar_edge.types import NS_PER_S, GridSpec, RobotKind

NOW = 100 * NS_PER_S
BY_NAME = {profile.name: profile for profile in PROFILES}
COPTER, ROVER, QUAD, PX4_ROVER = (
    BY_NAME[name] for name in ("ardupilot-copter", "ardupilot-rover", "px4-copter", "px4-rover")
)
LAT_E7, LON_E7 = -353632621, 1491652374
GRID = GridSpec(15, 15, 10.0, LAT_E7 / 1e7 - 0.0004, LON_E7 / 1e7 - 0.0004)
PLAN = DriverConfig(1, RobotKind.UAV, GRID, sysid=1)
SELF_FENCING = {"FENCE_ENABLE": 0.0, "FENCE_AUTOENABLE": 1.0, "FENCE_TYPE": 2.0, "FENCE_RADIUS": 30.0}
WATCHED = {"SYSID_MYGCS": 1.0, "FS_GCS_ENABLE": 1.0, "FS_GCS_TIMEOUT": 5.0}


def guided(cell_m: float) -> DriverConfig:
    return DriverConfig(1, RobotKind.UGV, dataclasses.replace(GRID, cell_m=cell_m), sysid=1, drive="guided")


def seen(**changes: object) -> Telemetry:
    telemetry = Telemetry(
        heartbeat=Heartbeat(2, 3, 81, COPTER.guided_mode, 3),
        heartbeat_ns=NOW,
        position=wire.GlobalPosition(LAT_E7, LON_E7, 584_000, 0, 0, 0, 0),
        position_ns=NOW - NS_PER_S // 5,
        home=wire.HomePosition(LAT_E7, LON_E7, 584_000),
        origin=wire.GlobalOrigin(LAT_E7, LON_E7, 584_000),
        current=wire.MissionCurrent(0, 0, 1),
        battery_percent=90,
    )
    return dataclasses.replace(telemetry, **changes)  # type: ignore[arg-type]


GOOD = Facts(
    now_ns=NOW,
    plan=None,
    shared_link=False,
    heard={(1, 1): Heard(Heartbeat(2, 3, 81, COPTER.guided_mode, 3), NOW - 9 * NS_PER_S, NOW, 10)},
    vehicle=(1, 1),
    profile=COPTER,
    unsupported="",
    seen=seen(),
    gps=wire.GpsRaw(6, 12),
    version=wire.AutopilotVersion(4 | 8, 0x040602FF),
    parameters={**WATCHED, "FENCE_ENABLE": 1.0, "FENCE_TYPE": 3.0, "FENCE_RADIUS": 300.0, "FENCE_ALT_MAX": 100.0},
    parameters_asked=12,
    rates_hz=dict(WANTED_HZ),
    counted_s=6.0,
    round_trips_ns=(20_000_000,) * 5,
    clock_skew_s=0.1,
    signed=0,
    unsigned=100,
)


def facts(**changes: object) -> Facts:
    return dataclasses.replace(GOOD, **changes)  # type: ignore[arg-type]


def verdict(check: str, **changes: object) -> Level:
    return examine(facts(**changes)).findings[check].level


def test_a_vehicle_that_is_set_up_right_passes_at_least_twelve_checks_without_a_warning() -> None:
    report = examine(facts(plan=PLAN))
    assert report.good
    assert report.count(Level.OK) == len(report.findings) == len(FIRST) + len(CHECKS) >= 12


def test_each_finding_that_is_not_ok_says_how_to_mend_it_in_one_line() -> None:
    bad = facts(seen=Telemetry(), gps=None, version=None, parameters={}, rates_hz={}, round_trips_ns=(), plan=PLAN)
    findings = [*examine(bad).findings.values(), *examine(facts(vehicle=None, profile=None)).findings.values()]
    assert all(bool(f.mend) == (f.level is not Level.OK) for f in findings)
    assert all("\n" not in f.text + f.mend and f.text for f in findings)


@pytest.mark.parametrize(
    ("check", "changes", "level"),
    [
        ("heartbeat", {"now_ns": NOW + 4 * NS_PER_S}, Level.FAIL),
        ("heartbeat", {"vehicle": None, "profile": None}, Level.FAIL),
        ("profile", {"vehicle": None, "profile": None, "unsupported": "AirRails has no profile"}, Level.FAIL),
        ("profile", {"profile": ROVER, "plan": PLAN}, Level.FAIL),
        ("answers", {"version": None, "parameters": {}, "round_trips_ns": ()}, Level.FAIL),
        ("version", {"version": None}, Level.WARN),
        ("version", {"version": wire.AutopilotVersion(4, 0x040602FF)}, Level.FAIL),
        ("position", {"seen": seen(position=None)}, Level.FAIL),
        ("position", {"seen": seen(position_ns=NOW - 2 * NS_PER_S)}, Level.FAIL),
        ("position", {"gps": None}, Level.WARN),
        ("position", {"gps": wire.GpsRaw(2, 4)}, Level.WARN),
        ("home", {"seen": seen(home=None)}, Level.FAIL),
        ("origin", {"seen": seen(origin=None)}, Level.FAIL),
        ("fence", {"parameters": {}}, Level.WARN),
        ("fence", {"parameters": {"FENCE_ENABLE": 0.0}}, Level.WARN),
        ("fence", {"parameters": {"FENCE_ENABLE": 0.0, "FENCE_AUTOENABLE": 0.0}}, Level.WARN),
        ("fence", {"parameters": SELF_FENCING, "plan": PLAN}, Level.FAIL),
        ("rates", {"rates_hz": {}}, Level.WARN),
        ("rates", {"rates_hz": {**WANTED_HZ, MessageId.GLOBAL_POSITION_INT: 2.0}}, Level.WARN),
        ("rates", {"rates_hz": {**WANTED_HZ, MessageId.GLOBAL_POSITION_INT: 0.5}}, Level.FAIL),
        ("rates", {"rates_hz": {**WANTED_HZ, MessageId.POSITION_TARGET_GLOBAL_INT: 0.0}}, Level.OK),
        ("mission", {"seen": seen(current=None)}, Level.WARN),
        ("mission", {"profile": ROVER, "parameters": {"MIS_DONE_BEHAVE": 1.0}}, Level.OK),
        ("mission", {"profile": ROVER, "parameters": {"MIS_DONE_BEHAVE": 3.0}}, Level.FAIL),
        ("mission", {"profile": ROVER, "parameters": {"WP_RADIUS": 2.0}, "plan": guided(cell_m=4.0)}, Level.OK),
        ("mission", {"profile": ROVER, "parameters": {"WP_RADIUS": 2.0}, "plan": guided(cell_m=3.0)}, Level.WARN),
        ("signing", {"shared_link": True}, Level.WARN),
        ("signing", {"signed": 9}, Level.OK),
        ("signing", {"signed": 9, "version": None, "parameters": {}, "round_trips_ns": ()}, Level.FAIL),
        ("clock", {"round_trips_ns": ()}, Level.WARN),
        ("clock", {"round_trips_ns": (700_000_000,) * 3}, Level.WARN),
        ("clock", {"clock_skew_s": -2.0}, Level.WARN),
        ("clock", {"clock_skew_s": None}, Level.OK),
        ("battery", {"seen": seen(battery_percent=-1)}, Level.WARN),
        ("battery", {"seen": seen(battery_percent=30)}, Level.WARN),
        ("battery", {"seen": seen(battery_percent=15)}, Level.FAIL),
        ("armed", {"seen": seen(heartbeat=Heartbeat(2, 3, 81 | 128, 4, 4))}, Level.WARN),
    ],
)
def test_what_is_wrong_is_said(check: str, changes: dict[str, object], level: Level) -> None:
    assert verdict(check, **changes) is level


def test_another_companion_of_the_same_vehicle_is_told_of_and_a_ground_station_is_company() -> None:
    station = Heard(Heartbeat(dialect.TYPE_GCS, 8, 0, 0, 4), NOW, NOW)
    companion = Heard(Heartbeat(dialect.TYPE_ONBOARD_CONTROLLER, 8, 0, 0, 4), NOW, NOW)
    assert verdict("company", heard={**GOOD.heard, (255, 190): station}) is Level.OK
    assert verdict("company", heard={**GOOD.heard, (1, 191): companion}) is Level.WARN


@pytest.mark.parametrize(
    ("fence", "level"),
    [
        ({}, Level.OK),
        ({"FENCE_RADIUS": 120.0}, Level.FAIL),  # the grid's far corner is 142 m from home
        ({"FENCE_RADIUS": 120.0, "FENCE_TYPE": 1.0}, Level.OK),  # no circle
        ({"FENCE_ALT_MAX": 15.0}, Level.FAIL),
    ],
)
def test_a_fence_of_its_own_inside_of_the_missions_area_fails(fence: dict[str, float], level: Level) -> None:
    assert verdict("fence", plan=PLAN, parameters={**GOOD.parameters, **fence}) is level


@pytest.mark.parametrize(("east_e7", "level"), [(0, Level.OK), (30_000, Level.WARN), (3_000_000, Level.FAIL)])
def test_a_vehicle_outside_of_the_grid_is_told_of_and_one_of_another_site_fails(east_e7: int, level: Level) -> None:
    there = wire.GlobalPosition(LAT_E7, LON_E7 + east_e7, 584_000, 0, 0, 0, 0)
    assert verdict("place", plan=PLAN, seen=seen(position=there)) is level


@pytest.mark.parametrize(
    ("profile", "mode", "parameters", "after_s", "acts"),
    [
        (COPTER, COPTER.guided_mode, {"FS_GCS_ENABLE": 0.0}, None, "holds"),
        (COPTER, COPTER.mission_mode, {"FS_GCS_ENABLE": 0.0}, None, "finishes its mission"),
        (COPTER, 5, {"FS_GCS_ENABLE": 0.0}, None, "stays in LOITER"),
        (COPTER, COPTER.guided_mode, {"SYSID_MYGCS": 255.0}, None, "holds"),
        (COPTER, COPTER.guided_mode, {}, 5.0, "returns to launch"),
        (COPTER, COPTER.guided_mode, {"FS_GCS_ENABLE": 7.0}, 5.0, "brakes"),
        (COPTER, COPTER.guided_mode, {"FS_GCS_ENABLE": 5.0, "FS_GCS_TIMEOUT": 9.0}, 9.0, "lands"),
        (COPTER, COPTER.mission_mode, {"FS_OPTIONS": 2.0}, None, "finishes its mission"),
        (COPTER, COPTER.guided_mode, {"FS_OPTIONS": 2.0}, 5.0, "returns to launch"),
        (ROVER, ROVER.mission_mode, {"FS_GCS_ENABLE": 0.0}, None, "finishes its mission"),
        (ROVER, ROVER.mission_mode, {"FS_ACTION": 2.0}, 6.5, "HOLD"),
        (ROVER, ROVER.mission_mode, {"FS_ACTION": 1.0}, 6.5, "returns to launch"),
        (ROVER, ROVER.mission_mode, {"FS_ACTION": 0.0}, None, "finishes its mission"),
        (ROVER, ROVER.mission_mode, {"FS_ACTION": 2.0, "FS_GCS_ENABLE": 2.0, "FS_THR_ENABLE": 0.0}, None, "finishes"),
        (ROVER, ROVER.mission_mode, {"FS_ACTION": 2.0, "FS_GCS_ENABLE": 2.0, "FS_THR_ENABLE": 1.0}, 6.5, "HOLD"),
        (QUAD, QUAD.guided_mode, {"NAV_DLL_ACT": 0.0}, None, "holds"),
        (QUAD, QUAD.guided_mode, {"NAV_DLL_ACT": 2.0}, None, "holds"),  # a companion's heartbeats never count
        (PX4_ROVER, PX4_ROVER.mission_mode, {"NAV_DLL_ACT": 1.0}, None, "finishes its mission"),
        (QUAD, OFFBOARD, {"COM_OBL_RC_ACT": 3.0, "COM_OF_LOSS_T": 0.5}, 0.5, "returns to launch"),
        (QUAD, OFFBOARD, {"COM_OBL_RC_ACT": 5.0}, 1.0, "holds"),
        (QUAD, OFFBOARD, {"COM_OBL_RC_ACT": 7.0}, 1.0, "disarms"),
    ],
)
def test_the_outcome_of_a_companions_death_is_the_measured_one(
    profile: Profile, mode: int, parameters: dict[str, float], after_s: float | None, acts: str
) -> None:
    outcome = companion_loss({**WATCHED, **parameters}, Situation(profile, mode, companion_sysid=1))
    assert outcome.after_s == after_s
    assert acts in outcome.acts
    assert outcome.watched or outcome.mend


def test_without_the_parameters_nothing_is_promised() -> None:
    for profile in PROFILES:
        outcome = companion_loss({}, Situation(profile, profile.guided_mode, 1))
        assert not outcome.watched
    for profile in PROFILES:
        assert own_fence({}, profile) is None


def test_each_profile_has_its_parameters() -> None:
    for profile in PROFILES:
        names = (*loss_parameters(profile), *fence_parameters(profile))
        assert names
        assert all(0 < len(name) <= 16 for name in names)


def test_the_newer_name_of_the_watched_system_counts_too() -> None:
    outcome = companion_loss({"MAV_GCS_SYSID": 1.0, "FS_GCS_ENABLE": 1.0}, Situation(COPTER, 4, 1))
    assert outcome.watched


def test_where_others_are_watched_as_well_the_companion_alone_is_not_missed() -> None:
    parameters = {"MAV_GCS_SYSID": 1.0, "MAV_GCS_SYSID_HI": 255.0, "FS_GCS_ENABLE": 1.0}
    outcome = companion_loss(parameters, Situation(COPTER, COPTER.guided_mode, 1))
    assert not outcome.watched
    assert "MAV_GCS_SYSID_HI=255" in outcome.because
    assert companion_loss({**parameters, "MAV_GCS_SYSID_HI": 0.0}, Situation(COPTER, COPTER.guided_mode, 1)).watched


@pytest.mark.parametrize("number", [0, 1, -1, 255, -5_000_000, 2_139_095_041, -(2**31), 2**31 - 1])
def test_an_integer_sent_bit_by_bit_is_read_exactly(number: int) -> None:
    # among them those whose bits are a signalling NaN
    assert value_of(wire.ParamValue("N", struct.pack("<i", number), 6), bytewise=True) == number


@pytest.mark.parametrize(
    ("raw", "kind", "bytewise", "value"),
    [
        (struct.pack("<f", 7.0), 2, False, 7.0),
        (struct.pack("<f", 2.5), 9, True, 2.5),
        (struct.pack("<f", math.nan), 9, True, None),
        (struct.pack("<f", math.inf), 2, False, None),
        (struct.pack("<bxxx", -3), 2, True, -3.0),
        (struct.pack("<Hxx", 65535), 3, True, 65535.0),
    ],
)
def test_other_values_are_read_by_their_type(raw: bytes, kind: int, bytewise: bool, value: float | None) -> None:
    assert value_of(wire.ParamValue("N", raw, kind), bytewise) == value


def test_parameters_are_asked_for_again_and_given_up_in_the_end() -> None:
    reader = ParameterReader((1, 1), ["A", "B"], bytewise=False)
    asked = []
    for i in range(200):
        asked += [m.name for m in reader.poll(i * NS_PER_S // 10) if isinstance(m, wire.ParamRead)]
        if i == 7:
            reader.receive(wire.ParamValue("A", struct.pack("<f", 1.0), 9))
            reader.receive(wire.ParamValue("C", struct.pack("<f", 1.0), 9))  # was not asked for
    assert asked.count("A") == 2
    assert asked.count("B") == TRIES
    assert reader.done
    assert reader.values == {"A": 1.0}
