"""How the simulated copter and rover move, and where on the Earth they are."""

from __future__ import annotations

import itertools
import math
import random

import pymap3d
import pytest

from gatar_edge.errors import ConfigError
from gatar_edge.sim_sitl.autopilot import AutopilotConfig
from gatar_edge.sim_sitl.geodesy import LocalFrame
from gatar_edge.sim_sitl.testing import HOME, ROVER, Client
from gatar_edge.sim_sitl.vehicle import Body, Goal, Limits, corner_speed_m_s, step_copter, step_rover

LIMITS = Limits()
DT_S = 0.1


def free(east_m: float, north_m: float) -> bool:
    return False


@pytest.mark.parametrize("origin", [(-35.36, 149.17), (0.0, 0.0), (60.0, -179.99), (-59.0, 180.0), (42.0, -71.0)])
@pytest.mark.parametrize("point", [(0.0, 0.0), (5000.0, 0.0), (-3000.0, 4000.0), (10.0, -5000.0)])
def test_the_local_frame_agrees_with_an_independent_one_within_two_centimetres(
    origin: tuple[float, float], point: tuple[float, float]
) -> None:
    frame = LocalFrame(*origin)
    lat, lon = frame.geodetic(*point)
    east, north, _ = pymap3d.geodetic2enu(lat, lon, 0.0, origin[0], origin[1], 0.0)
    assert (float(east), float(north)) == pytest.approx(point, abs=0.02)
    assert frame.local(lat, lon) == pytest.approx(point, abs=0.02)


def test_a_copter_flies_straight_keeps_its_limits_and_stops_at_its_goal() -> None:
    body, goal = Body(up_m=10.0), Goal(40.0, 30.0, 12.0)
    for _ in range(200):
        after = step_copter(body, LIMITS, goal, DT_S)
        change = math.hypot(after.east_m_s - body.east_m_s, after.north_m_s - body.north_m_s)
        assert change <= LIMITS.acceleration_m_s2 * DT_S + 1e-9
        assert after.speed_m_s <= LIMITS.speed_m_s + 1e-9
        assert abs(after.east_m * 0.6 - after.north_m * 0.8) < 0.01
        body = after
    assert (body.east_m, body.north_m, body.up_m) == pytest.approx((40, 30, 12), abs=0.02)
    assert body.speed_m_s < 0.01


def test_a_copter_reaches_a_goal_50_m_away_about_as_fast_as_its_limits_allow() -> None:
    body, goal, seconds = Body(up_m=10.0), Goal(50.0, 0.0, 10.0), 0.0
    while goal.distance_m(body) > 0.5:
        body = step_copter(body, LIMITS, goal, DT_S)
        seconds += DT_S
    assert seconds < 50 / LIMITS.speed_m_s + 3.5


def test_a_rover_brakes_on_its_course_before_it_turns_back() -> None:
    body = Body()
    for _ in range(50):
        body = step_rover(body, LIMITS, Goal(0.0, 100.0, 0.0), DT_S, free)
    assert body.speed_m_s == pytest.approx(5)
    turned_at = body.north_m
    for _ in range(60):
        body = step_rover(body, LIMITS, Goal(0.0, 0.0, 0.0), DT_S, free)
        assert abs(body.east_m) < 0.6
        assert body.north_m < turned_at + 3.2


def test_a_rover_never_strays_a_metre_and_a_half_from_a_path_of_ten_metre_cells() -> None:
    rng = random.Random(5)
    for _ in range(5):
        corners = [(0.0, 0.0)]
        for _ in range(8):
            step = rng.choice([(10.0, 0.0), (-10.0, 0.0), (0.0, 10.0), (0.0, -10.0)])
            corners.append((corners[-1][0] + step[0], corners[-1][1] + step[1]))
        client = Client(ROVER)
        client.upload((*HOME, 0.0), *[client.place(*corner) for corner in corners[1:]])
        assert [client.command(400, 1), client.command(176, 1, 10)] == [0, 0]
        for _ in range(600):
            client.run(DT_S)
            truth = client.vehicle.truth
            legs = itertools.pairwise(corners)
            assert min(to_leg(truth.east_m, truth.north_m, *leg) for leg in legs) < 1.5
            if truth.mission_state == 5:
                break
        assert client.vehicle.truth.mission_state == 5


def to_leg(east: float, north: float, start: tuple[float, float], end: tuple[float, float]) -> float:
    along = ((east - start[0]) * (end[0] - start[0]) + (north - start[1]) * (end[1] - start[1])) / 100.0
    share = max(0.0, min(1.0, along))
    return math.hypot(
        east - start[0] - share * (end[0] - start[0]), north - start[1] - share * (end[1] - start[1])
    )  # fmt: skip


def test_a_rover_slows_for_a_corner_the_more_the_sharper_it_is() -> None:
    def speed(east: float, north: float) -> float:
        return corner_speed_m_s(LIMITS, Goal(0, 0, 0), Goal(0, 10, 0), Goal(east, north, 0))

    assert speed(0, 20) == pytest.approx(5)
    assert 3 < speed(10, 20) < 4.5
    assert 1 < speed(10, 10) < 2
    assert speed(0, 0) == pytest.approx(0, abs=1e-9)


def test_a_rover_passes_waypoints_in_a_line_without_stopping() -> None:
    client = Client(ROVER)
    client.upload((*HOME, 0.0), *[client.place(0, 10.0 * i) for i in range(1, 7)])
    client.command(400, 1)
    client.command(176, 1, 10)
    client.run(4)
    while client.vehicle.truth.north_m < 45:
        assert client.vehicle.truth.speed_m_s > 4.9
        client.run(DT_S)


def test_the_battery_drains_while_armed_and_only_then() -> None:
    client = Client(AutopilotConfig(sysid=2, vehicle="rover", endurance_s=100, battery_percent=50))
    client.run(10)
    assert client.vehicle.truth.battery_percent == 50
    client.command(400, 1)
    client.run(10)
    assert client.vehicle.truth.battery_percent == pytest.approx(40, abs=0.2)


def test_the_same_seed_and_inputs_give_the_same_bytes() -> None:
    def flight() -> list[str]:
        client = Client(ROVER)
        client.upload((*HOME, 0.0), client.place(0, 10), client.place(20, 10))
        client.send("MISSION_COUNT", count=2, mission_type=0)
        client.run(9)
        client.command(400, 1)
        client.run(5)
        return [str(message) for message in client.log]

    assert flight() == flight()


@pytest.mark.parametrize("bad", [{"sysid": 0}, {"sysid": 256}, {"vehicle": "boat"}, {"stack": "x"}, {"speed_m_s": 0}])
def test_a_vehicle_that_cannot_be_is_refused(bad: dict) -> None:
    with pytest.raises(ConfigError):
        AutopilotConfig(**({"sysid": 1, "vehicle": "rover"} | bad))
