"""MAVSDK, with its own server, as a client of simulated vehicles over loopback UDP: what a user's program does."""

from __future__ import annotations

import asyncio
import contextlib
import math
import socket
import subprocess
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from importlib import resources
from typing import Any

import pytest

from gatar_edge.sim_sitl.autopilot import AutopilotConfig
from gatar_edge.sim_sitl.geodesy import LocalFrame
from gatar_edge.sim_sitl.served import ServedVehicles

mavsdk = pytest.importorskip("mavsdk_grpc", reason="MAVSDK is not installed: pip install mavsdk-grpc")

SPEED = 8.0  # simulated seconds a second; MAVSDK's own timers run by the wall clock
TIMEOUT_S = 40.0
VEHICLES = [
    pytest.param(AutopilotConfig(sysid=1, vehicle="copter", stack="ardupilot"), id="ardupilot-copter"),
    pytest.param(AutopilotConfig(sysid=2, vehicle="rover", stack="ardupilot"), id="ardupilot-rover"),
    pytest.param(AutopilotConfig(sysid=3, vehicle="copter", stack="px4"), id="px4-copter"),
    pytest.param(AutopilotConfig(sysid=4, vehicle="rover", stack="px4"), id="px4-rover"),
]


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextlib.contextmanager
def server(vehicles_port: int) -> Iterator[int]:
    """mavsdk_server between the vehicles and Python; yields its port."""
    port = free_port()
    program = resources.files("mavsdk_grpc") / "bin" / "mavsdk_server"
    try:
        process = subprocess.Popen(
            [str(program), "-p", str(port), f"udpout://127.0.0.1:{vehicles_port}"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
    except OSError as error:
        pytest.skip(f"mavsdk_server cannot be started here: {error}")
    try:
        yield port
    finally:
        process.kill()
        process.wait()


def fly(config: AutopilotConfig, what: Callable[[Any, ServedVehicles], Awaitable[None]]) -> None:
    """Connect MAVSDK to one simulated vehicle and let `what` happen."""

    async def run(served: ServedVehicles, port: int) -> None:
        drone = mavsdk.System(mavsdk_server_address="127.0.0.1", port=port)
        async with asyncio.timeout(TIMEOUT_S):
            await drone.connect()
            await first(drone.core.connection_state(), lambda state: state.is_connected)
            await what(drone, served)

    with ServedVehicles([config], speed=SPEED) as served, server(served.port) as port:
        asyncio.run(run(served, port))


async def first(stream: AsyncIterator[Any], wanted: Callable[[Any], bool] = lambda value: True) -> Any:
    """The first value of a stream that is as wanted."""
    async for value in stream:
        if wanted(value):
            return value
    raise AssertionError("the stream ended")


def place(config: AutopilotConfig, east_m: float, north_m: float) -> tuple[float, float]:
    """Latitude and longitude of a place given from home."""
    return LocalFrame(config.home_lat_deg, config.home_lon_deg).geodetic(east_m, north_m)


def mission_items(config: AutopilotConfig) -> list[Any]:
    """Three waypoints, after the placeholder for home where the stack keeps home in slot 0."""
    spots = [(0.0, 12.0), (12.0, 12.0), (12.0, 0.0)]
    if config.stack == "ardupilot":
        spots.insert(0, (0.0, 0.0))
    items = []
    for seq, (east_m, north_m) in enumerate(spots):
        lat, lon = place(config, east_m, north_m)
        # frame 6, command 16, then current, autocontinue, param1-4, x, y, z, mission type
        item = (seq, 6, 16, int(seq == 0), 1, 0.0, 0.0, 0.0, 0.0, round(lat * 1e7), round(lon * 1e7), 10.0, 0)
        items.append(mavsdk.mission_raw.MissionItem(*item))
    return items


async def upload_and_compare(drone: Any, config: AutopilotConfig) -> None:
    items = mission_items(config)
    await drone.mission_raw.upload_mission(items)
    read = await drone.mission_raw.download_mission()
    first = 1 if config.stack == "ardupilot" else 0
    assert len(read) == len(items)
    assert [(i.x, i.y, i.z) for i in read[first:]] == [(i.x, i.y, i.z) for i in items[first:]]


async def fly_mission(drone: Any) -> None:
    await drone.mission_raw.start_mission()
    await first(drone.mission_raw.mission_progress(), lambda p: p.current == p.total - 1 > 0)


@pytest.mark.parametrize("config", VEHICLES)
def test_a_vehicle_is_found_and_healthy(config: AutopilotConfig) -> None:
    async def look(drone: Any, served: ServedVehicles) -> None:
        health = await first(drone.telemetry.health(), lambda h: h.is_armable)
        assert health.is_local_position_ok
        assert health.is_home_position_ok
        position = await first(drone.telemetry.position())
        assert position.latitude_deg == pytest.approx(config.home_lat_deg, abs=1e-6)
        await drone.telemetry.set_rate_home(1.0)  # ArduPilot tells it once only, when it is set
        home = await first(drone.telemetry.home())
        assert home.absolute_altitude_m == pytest.approx(config.home_alt_m, abs=0.1)
        version = await drone.info.get_version()
        assert version.flight_sw_major == (4 if config.stack == "ardupilot" else 1)

    fly(config, look)


@pytest.mark.parametrize("config", VEHICLES)
def test_parameters_are_read_set_and_listed(config: AutopilotConfig) -> None:
    whole, real = ("SYSID_MYGCS", "FS_GCS_TIMEOUT") if config.stack == "ardupilot" else ("COM_DL_LOSS_T", "NAV_ACC_RAD")

    async def tune(drone: Any, served: ServedVehicles) -> None:
        await drone.param.set_param_int(whole, 42)
        await drone.param.set_param_float(real, 3.5)
        assert await drone.param.get_param_int(whole) == 42
        assert await drone.param.get_param_float(real) == 3.5
        listed = await drone.param.get_all_params()
        assert {p.name: p.value for p in listed.int_params}[whole] == 42
        assert {p.name: p.value for p in listed.float_params}[real] == 3.5

    fly(config, tune)


@pytest.mark.parametrize("config", [v for v in VEHICLES if "copter" in str(v.id)])
def test_a_copter_takes_off_goes_flies_its_mission_and_lands(config: AutopilotConfig) -> None:
    async def mission(drone: Any, served: ServedVehicles) -> None:
        await upload_and_compare(drone, config)
        await drone.action.set_takeoff_altitude(10.0)
        await drone.action.arm()
        await drone.action.takeoff()
        await first(drone.telemetry.position(), lambda p: p.relative_altitude_m > 9.5)
        assert await first(drone.telemetry.in_air(), lambda up: up)
        lat, lon = place(config, -15.0, 5.0)
        await drone.action.goto_location(lat, lon, config.home_alt_m + 12.0, math.nan)
        await first(drone.telemetry.position(), lambda p: abs(p.longitude_deg - lon) < 2e-6)
        assert served.truth(config.sysid).alt_rel_m == pytest.approx(12.0, abs=0.5)
        await fly_mission(drone)
        served.wait(config.sysid, lambda truth: truth.mission_state == 5)
        truth = served.truth(config.sysid)
        assert (truth.east_m, truth.north_m) == pytest.approx((12.0, 0.0), abs=2.5)
        await drone.action.land()
        await first(drone.telemetry.armed(), lambda armed: not armed)
        assert served.truth(config.sysid).landed

    fly(config, mission)


@pytest.mark.parametrize("config", [v for v in VEHICLES if "rover" in str(v.id)])
def test_a_rover_drives_its_mission_goes_and_holds(config: AutopilotConfig) -> None:
    async def mission(drone: Any, served: ServedVehicles) -> None:
        await upload_and_compare(drone, config)
        await drone.action.arm()
        await fly_mission(drone)
        served.wait(config.sysid, lambda truth: truth.mission_state == 5)
        truth = served.truth(config.sysid)
        assert (truth.east_m, truth.north_m) == pytest.approx((12.0, 0.0), abs=2.5)
        lat, lon = place(config, -8.0, 0.0)
        await drone.action.goto_location(lat, lon, config.home_alt_m, math.nan)
        served.wait(config.sysid, lambda truth: abs(truth.east_m + 8.0) < 2.5)
        await drone.action.hold()
        served.wait(config.sysid, lambda truth: truth.speed_m_s == 0.0)

    fly(config, mission)
