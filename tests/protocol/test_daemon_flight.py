"""The daemon on a simulated autopilot: what happens to the vehicle when something between them fails."""

from __future__ import annotations

import pytest
from flight import Flight

LOITER, HOLD = 5, 4  # custom modes of ArduCopter and ArduRover
HEARTBEAT, COMMAND_LONG = 0, 76
SET_MESSAGE_INTERVAL, REQUEST_MESSAGE = 511, 512


def flying(team: str = "1A0G", on_stop: str = "hold") -> Flight:
    """Airborne, or on the way, with a task."""
    flight = Flight(team, on_stop=on_stop)
    flight.fly(60, until=lambda: bool(flight.snapshots) and flight.last.task != "HOLD")
    assert flight.last.task != "HOLD"
    flight.fly(3)
    return flight


@pytest.mark.parametrize("team", ["1A0G", "0A1G"])
def test_sigterm_stands_the_vehicle_still_within_three_seconds(team: str) -> None:
    flight = flying(team)
    for _ in range(60):
        flight.fly(0.05, step=False)
        if flight.daemon.stop(flight.now_ns):
            break
    assert flight.daemon.stop(flight.now_ns)
    assert flight.body.autopilot.truth.speed_m_s < 0.5
    place = flight.body.xy
    flight.fly(5, step=False)
    settled = flight.body.xy
    assert settled == pytest.approx(place, abs=0.6)  # a copter comes back to where it was told to hold
    flight.fly(30, step=False)
    assert flight.body.xy == pytest.approx(settled, abs=0.05)


def test_a_stopped_daemon_lets_its_vehicle_return_where_so_configured() -> None:
    flight = flying(on_stop="return")
    home = flight.world.starts[0]
    for _ in range(60):
        flight.fly(0.05, step=False)
        if flight.daemon.stop(flight.now_ns):
            break
    assert flight.daemon.stop(flight.now_ns)
    assert flight.body.autopilot.truth.mode == "RTL"
    flight.fly(120, step=False)
    assert flight.body.cell == home
    assert not flight.body.autopilot.truth.armed


@pytest.mark.parametrize("team", ["1A0G", "0A1G"])
def test_a_lost_link_takes_the_robot_out_and_its_return_brings_it_back(team: str) -> None:
    flight = flying(team)
    flight.cut = True
    flight.fly(5)
    assert flight.last.reason == "no_vehicle"
    assert "no heartbeat from the autopilot" in flight.last.problems
    flight.cut = False
    flight.fly(5)
    assert flight.last.task != "HOLD"
    assert flight.last.problems == []


@pytest.mark.parametrize(("team", "mode"), [("1A0G", LOITER), ("0A1G", HOLD)])
def test_a_pilot_who_takes_over_keeps_the_vehicle_until_we_are_told(team: str, mode: int) -> None:
    flight = flying(team)
    flight.somebody_else_sets(mode)
    flight.fly(1.5)
    flight.message_ids_sent()
    name = flight.body.autopilot.truth.mode
    flight.fly(30)
    assert flight.message_ids_sent() <= {
        (HEARTBEAT, 0),
        (COMMAND_LONG, SET_MESSAGE_INTERVAL),
        (COMMAND_LONG, REQUEST_MESSAGE),
    }
    assert flight.body.autopilot.truth.mode == name
    assert flight.last.reason == "no_vehicle"
    assert "the vehicle does not obey (pilot)" in flight.last.problems
    flight.port.enable(flight.now_ns)
    flight.fly(5)
    assert flight.last.task != "HOLD"


def test_a_rebooted_autopilot_is_not_started_again_unasked() -> None:
    flight = flying("0A1G")
    flight.body.autopilot.reboot(flight.now_ns)
    flight.fly(30)
    assert not flight.body.autopilot.truth.armed
    assert flight.last.reason == "no_vehicle"
    flight.port.enable(flight.now_ns)
    flight.fly(10)
    assert flight.last.task != "HOLD"


def test_a_vehicle_is_left_alone_until_a_person_arms_it() -> None:
    flight = Flight("0A1G", launch="armed")
    flight.fly(20)
    assert not flight.body.autopilot.truth.armed
    assert flight.last.reason == "no_vehicle"
    flight.somebody_else_arms()
    flight.fly(10)
    assert flight.last.task != "HOLD"


def test_shadow_mode_sends_heartbeats_and_requests_for_telemetry_alone() -> None:
    flight = Flight(dry_run=True)
    flight.fly(20)
    assert flight.last.task != "HOLD"
    assert flight.message_ids_sent() == {
        (HEARTBEAT, 0),
        (COMMAND_LONG, SET_MESSAGE_INTERVAL),
        (COMMAND_LONG, REQUEST_MESSAGE),
    }
    assert not flight.body.autopilot.truth.armed


def test_a_hung_loop_falls_silent() -> None:
    flight = flying()
    flight.sent.clear()
    flight.fly(10, step=False)
    assert flight.sent == []


@pytest.mark.parametrize("team", ["1A0G", "0A1G"])
def test_a_robot_alone_localizes_every_target_it_can_reach(team: str) -> None:
    flight = Flight(team)
    flight.fly(900, until=lambda: bool(flight.snapshots) and flight.last.reason == "nothing_left")
    belief = flight.daemon.agent.belief
    assert (belief == 4).sum() >= 10
