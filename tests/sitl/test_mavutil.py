"""pymavlink's own connection, mission loader and mode tables, as the ground stations built on it use them."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from typing import Any

import pytest
from pymavlink import mavutil, mavwp

from gatar_edge.sim_sitl.autopilot import AutopilotConfig
from gatar_edge.sim_sitl.faults_file import parse_faults
from gatar_edge.sim_sitl.geodesy import LocalFrame
from gatar_edge.sim_sitl.served import ServedVehicles

mavlink = mavutil.mavlink
VEHICLES = [
    AutopilotConfig(sysid=11, vehicle="copter", stack="ardupilot"),
    AutopilotConfig(sysid=12, vehicle="rover", stack="ardupilot"),
    AutopilotConfig(sysid=13, vehicle="copter", stack="px4"),
    AutopilotConfig(sysid=14, vehicle="rover", stack="px4"),
]
IDS = [f"{config.stack}-{config.vehicle}" for config in VEHICLES]
TIMEOUT_S = 20.0


@contextlib.contextmanager
def connected(served: ServedVehicles) -> Iterator[Any]:
    """A ground station that has heard the vehicle."""
    link = mavutil.mavlink_connection(f"udpout:127.0.0.1:{served.port}", source_system=255, source_component=190)
    try:
        link.mav.heartbeat_send(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 0)
        assert link.wait_heartbeat(timeout=TIMEOUT_S) is not None
        yield link
    finally:
        link.close()


def answer(link: Any, *names: str) -> Any:
    message = link.recv_match(type=list(names), blocking=True, timeout=TIMEOUT_S)
    assert message is not None, f"no {names}"
    return message


def waypoints(config: AutopilotConfig) -> mavwp.MAVWPLoader:
    loader = mavwp.MAVWPLoader(target_system=config.sysid, target_component=1)
    frame = LocalFrame(config.home_lat_deg, config.home_lon_deg)
    for east_m, north_m in ((0.0, 0.0), (0.0, 10.0), (10.0, 10.0)):
        lat, lon = frame.geodetic(east_m, north_m)
        loader.add(
            mavlink.MAVLink_mission_item_message(
                config.sysid, 1, loader.count(), 3, 16, 0, 1, 0.0, 0.0, 0.0, 0.0, lat, lon, 10.0
            )
        )
    return loader


@pytest.mark.parametrize("config", VEHICLES, ids=IDS)
def test_a_mission_goes_up_and_comes_back_with_the_mission_loader(config: AutopilotConfig) -> None:
    sent = waypoints(config)
    with ServedVehicles([config], speed=5.0) as served, connected(served) as link:
        link.waypoint_count_send(sent.count())
        while (message := answer(link, "MISSION_REQUEST", "MISSION_REQUEST_INT", "MISSION_ACK")).get_type() != (
            "MISSION_ACK"
        ):
            link.mav.send(mavutil.mavlink.MAVLink_mission_item_int_message(*as_int(sent.wp(message.seq))))
        assert message.type == mavlink.MAV_MISSION_ACCEPTED

        read = mavwp.MAVWPLoader(target_system=config.sysid, target_component=1)
        link.waypoint_request_list_send()
        read.expected_count = answer(link, "MISSION_COUNT").count
        for seq in range(read.expected_count):
            link.waypoint_request_send(seq)  # MISSION_REQUEST: the answer has coordinates in floating point
            read.add(answer(link, "MISSION_ITEM"))
        link.waypoint_clear_all_send()
        assert answer(link, "MISSION_ACK") is not None

    assert read.count() == sent.count()
    first = 1 if config.stack == "ardupilot" else 0
    for seq in range(first, sent.count()):
        assert (read.wp(seq).x, read.wp(seq).y) == pytest.approx((sent.wp(seq).x, sent.wp(seq).y), abs=1e-5)
        assert (read.wp(seq).frame, read.wp(seq).z) == (3, 10.0)


def as_int(item: Any) -> tuple[Any, ...]:
    """A MISSION_ITEM's fields as those of MISSION_ITEM_INT."""
    params = (item.param1, item.param2, item.param3, item.param4)
    lat, lon = round(item.x * 1e7), round(item.y * 1e7)
    head = (item.target_system, item.target_component, item.seq, item.frame, item.command, item.current, 1)
    return (*head, *params, lat, lon, item.z)


@pytest.mark.parametrize("config", VEHICLES, ids=IDS)
def test_modes_are_known_by_name_and_arming_is_seen(config: AutopilotConfig) -> None:
    name = {"ardupilot": "GUIDED", "px4": "POSCTL"}[config.stack]
    with ServedVehicles([config], speed=5.0) as served, connected(served) as link:
        mode = link.mode_mapping()[name]
        link.set_mode(*mode) if isinstance(mode, tuple) else link.set_mode(mode)
        wait_until(link, lambda: link.flightmode == name)
        link.arducopter_arm()
        wait_until(link, link.motors_armed)
        assert served.truth(config.sysid).armed
        link.arducopter_disarm()
        wait_until(link, lambda: not link.motors_armed())


@pytest.mark.parametrize("config", VEHICLES, ids=IDS)
def test_all_parameters_are_fetched_and_one_is_set(config: AutopilotConfig) -> None:
    name = "FS_GCS_TIMEOUT" if config.stack == "ardupilot" else "NAV_ACC_RAD"
    with ServedVehicles([config], speed=5.0) as served, connected(served) as link:
        link.param_fetch_all()
        count = answer(link, "PARAM_VALUE").param_count
        wait_until(link, lambda: len(link.params) == count)
        assert name in link.params
        link.param_set_send(name, 7.5)
        wait_until(link, lambda: link.param(name) == 7.5)


def wait_until(link: Any, true: Any) -> None:
    deadline_s = time.monotonic() + TIMEOUT_S
    while not true():
        assert time.monotonic() < deadline_s, "did not happen"
        link.recv_match(blocking=True, timeout=0.2)


def test_each_of_several_vehicles_on_one_port_obeys_what_is_addressed_to_it() -> None:
    with ServedVehicles(VEHICLES[:2], speed=5.0) as served, connected(served) as link:
        link.mav.command_long_send(12, 1, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, 0, 0, 0, 0, 0, 0)
        served.wait(12, lambda truth: truth.armed)
        assert not served.truth(11).armed


def test_a_vehicle_that_the_faults_kill_is_not_heard_any_more() -> None:
    faults = parse_faults(b'[[event]]\nat_s = 2\nrobot = 12\ndo = "kill_robot"\n')
    heard: list[int] = []

    def only_the_other() -> bool:
        message = link.recv_match(type="HEARTBEAT", blocking=True, timeout=0.2)
        heard.extend([message.get_srcSystem()] if message is not None else [])
        return heard[-5:] == [11] * 5

    with ServedVehicles(VEHICLES[:2], speed=5.0, faults=faults) as served, connected(served) as link:
        wait_until(link, only_the_other)
