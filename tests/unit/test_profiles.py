"""Profiles: chosen from the heartbeat, alike in shape, and golden in what they send."""

from __future__ import annotations

import math

import pytest

from gatar_edge.bridge.codec import Codec
from gatar_edge.bridge.mission_items import build, fingerprint, same_mission
from gatar_edge.bridge.profiles import PROFILES, Profile, SetCurrent, Unsupported, choose
from gatar_edge.bridge.wire import MissionItem, MissionItemAt
from gatar_edge.types import RobotKind

POINTS = ((47.0, 8.0), (47.0001, 8.0002))
by_name = pytest.mark.parametrize("profile", PROFILES, ids=lambda p: p.name)


@pytest.mark.parametrize(
    ("autopilot", "vehicle_type", "name"),
    [
        (3, 2, "ardupilot-copter"),
        (3, 13, "ardupilot-copter"),
        (3, 10, "ardupilot-rover"),
        (12, 2, "px4-copter"),
        (12, 10, "px4-rover"),
    ],
)
def test_the_heartbeat_chooses_the_profile(autopilot: int, vehicle_type: int, name: str) -> None:
    profile = choose(autopilot, vehicle_type)
    assert isinstance(profile, Profile)
    assert profile.name == name


@pytest.mark.parametrize(("autopilot", "vehicle_type"), [(0, 2), (3, 1), (12, 20), (8, 18), (77, 10)])
def test_anything_else_is_refused_by_name(autopilot: int, vehicle_type: int) -> None:
    refused = choose(autopilot, vehicle_type)
    assert isinstance(refused, Unsupported)
    assert f"MAV_AUTOPILOT {autopilot}" in refused.text
    assert f"MAV_TYPE {vehicle_type}" in refused.text
    assert "px4-rover" in refused.text


def test_the_name_of_every_profile_is_its_own() -> None:
    assert len({p.name for p in PROFILES}) == len(PROFILES) == 4


@by_name
def test_every_profile_names_the_modes_that_it_uses(profile: Profile) -> None:
    used = {profile.guided_mode, profile.mission_mode, profile.hold_mode, *profile.arm_modes}
    assert used <= set(profile.modes)


@by_name
def test_mode_parameters_give_the_custom_mode_back(profile: Profile) -> None:
    for mode in profile.modes:
        main, sub = profile.mode_params(mode)
        assert mode == (main if profile.autopilot == 3 else main << 16 | sub << 24)


def test_an_unknown_mode_is_called_by_its_number() -> None:
    assert PROFILES[0].mode_name(99) == "99"


@by_name
def test_only_ground_vehicles_do_not_take_off(profile: Profile) -> None:
    assert (profile.takeoff.name == "NONE") == (profile.kind is RobotKind.UGV)


def test_ardupilot_missions_begin_with_a_home_placeholder_and_zero_yaw() -> None:
    items = build(PROFILES[0], POINTS, 20.0)
    assert [(i.frame, i.command, i.params, i.lat_e7, i.lon_e7, i.alt_m) for i in items] == [
        (0, 16, (0, 0, 0, 0), 470000000, 80000000, 0),
        (6, 16, (0, 0, 0, 0), 470000000, 80000000, 20),
        (6, 16, (0, 0, 0, 0), 470001000, 80002000, 20),
    ]


def test_px4_missions_begin_with_the_first_waypoint_and_leave_the_yaw() -> None:
    items = build(PROFILES[2], POINTS, 20.0)
    assert [(i.frame, i.lat_e7, i.lon_e7) for i in items] == [(6, 470000000, 80000000), (6, 470001000, 80002000)]
    assert all(math.isnan(i.params[3]) for i in items)


def test_the_bytes_of_a_waypoint_are_golden() -> None:
    item = build(PROFILES[1], ((47.0, 8.0),), 20.0)[1]
    frame = Codec(7, 191).encode(MissionItemAt((7, 1), 1, item))
    assert frame.hex() == GOLDEN


# header (seq 0, from 7/191, id 73), four params, x 470000000, y 80000000, z 20, seq 1, command 16, to 7/1, frame 6, not
# current, autocontinue, checksum; the type 0 at the end is cut off as MAVLink 2 does with zeros
GOLDEN = "fd2500000007bf490000" + "00" * 16 + "80a1031c00b4c4040000a0410100100007010600015cb5"


@by_name
def test_the_rounding_of_a_vehicle_is_not_a_difference(profile: Profile) -> None:
    sent = build(profile, POINTS, 20.0)
    read = tuple(
        MissionItem(3 if i.frame == 6 else i.frame, i.command, i.params, i.lat_e7 + 1, i.lon_e7 - 1, i.alt_m + 0.009)
        for i in sent
    )
    assert same_mission(sent, read, profile)


@by_name
def test_another_place_height_command_or_length_is_a_difference(profile: Profile) -> None:
    sent = build(profile, POINTS, 20.0)
    last = sent[-1]
    for other in (
        MissionItem(last.frame, 16, last.params, last.lat_e7 + 2, last.lon_e7, last.alt_m),
        MissionItem(last.frame, 16, last.params, last.lat_e7, last.lon_e7, last.alt_m + 0.02),
        MissionItem(last.frame, 21, last.params, last.lat_e7, last.lon_e7, last.alt_m),
        MissionItem(0, 16, last.params, last.lat_e7, last.lon_e7, last.alt_m),
        MissionItem(last.frame, 16, (5.0, 0, 0, last.params[3]), last.lat_e7, last.lon_e7, last.alt_m),
    ):
        assert not same_mission(sent, (*sent[:-1], other), profile)
    assert not same_mission(sent, sent[:-1], profile)


def test_home_counts_in_a_comparison_only_where_slot_0_is_an_item() -> None:
    for profile in PROFILES:
        sent = build(profile, POINTS, 20.0)
        moved = MissionItem(0, 16, (0, 0, 0, 0), 1, 2, 140.0)
        assert same_mission(sent, (moved, *sent[1:]), profile) == (profile.first_item_seq == 1)


def test_a_fingerprint_tells_missions_apart_and_ignores_home() -> None:
    a, b = build(PROFILES[1], POINTS, 0.0), build(PROFILES[1], POINTS[::-1], 0.0)
    assert fingerprint(a, 1) != fingerprint(b, 1)
    assert fingerprint(a, 1) == fingerprint((b[0], *a[1:]), 1)


def test_each_stack_starts_a_mission_in_its_measured_way() -> None:
    ardupilot, px4 = SetCurrent.COMMAND_WITH_RESET, SetCurrent.MESSAGE_AFTER_TOTAL
    assert [p.set_current for p in PROFILES] == [ardupilot, ardupilot, px4, px4]
