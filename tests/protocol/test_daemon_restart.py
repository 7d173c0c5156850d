"""A daemon that is killed and started again while its vehicle is under way."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import msgspec
import pytest
from flight import Flight

from gatar_edge.bridge.status import Status
from gatar_edge.driver_memory import DriverMemory
from gatar_edge.sim_sitl.body import StackName
from gatar_edge.types import NS_PER_S, CellState, TaskKind

HOLD = 4  # custom mode of ArduRover
GUIDED = {"1A0G": 4, "0A1G": 15}  # of ArduCopter and ArduRover
KEY = bytes(range(32))


def driving(stack: StackName = "ardupilot") -> Flight:
    """A rover in the middle of its way to a target, its state saved."""
    flight = Flight("0A1G", stack=stack)
    flight.fly(300, until=lambda: in_the_middle(flight))
    assert in_the_middle(flight)
    flight.names_sent()
    return flight


def in_the_middle(flight: Flight) -> bool:
    if flight.driver.status is not Status.PURSUING or flight.body.autopilot.truth.speed_m_s < 3:
        return False
    saved = flight.saver.states[-1]
    on_its_way = saved.task_kind == TaskKind.TARGET and math.dist(saved.task_cell, flight.body.xy) > 3
    return on_its_way and saved.vehicle.mission == flight.driver.memory().mission


@pytest.mark.parametrize("stack", ["ardupilot", "px4"])
def test_a_restarted_daemon_goes_on_within_two_seconds_and_uploads_nothing(stack: StackName, tmp_path: Path) -> None:
    flight = driving(stack)
    task, mode = flight.last.task_cell, flight.body.autopilot.truth.mode
    flight.start(flight.saved(tmp_path))
    began_ns = flight.now_ns
    flight.fly(10, until=lambda: flight.driver.status is Status.PURSUING)
    assert flight.now_ns - began_ns <= 2e9
    assert flight.last.task_cell == task
    assert flight.body.autopilot.truth.mode == mode
    assert flight.body.autopilot.truth.speed_m_s > 1
    assert not {"MISSION_COUNT", "MISSION_ITEM_INT", "MISSION_SET_CURRENT"} & set(flight.names_sent())


def test_a_mission_that_was_replaced_while_the_daemon_was_dead_is_not_taken_for_ours(tmp_path: Path) -> None:
    flight = driving()
    restored = flight.saved(tmp_path)
    assert restored.state is not None
    *corners, _ = restored.state.vehicle.cells
    flight.somebody_else_uploads(*corners, (0, 0))
    flight.start(restored)
    flight.fly(2)
    flight.fly(20, until=lambda: flight.driver.status is Status.PURSUING)
    assert flight.driver.status is Status.PURSUING
    assert "MISSION_COUNT" in flight.names_sent()


def test_a_task_that_is_no_longer_there_after_the_restart_is_replaced_on_board(tmp_path: Path) -> None:
    flight = driving()
    restored = flight.saved(tmp_path)
    assert restored.state is not None
    x, y = restored.state.task_cell
    belief = bytearray(restored.state.belief)
    belief[x * restored.state.height + y] = CellState.LOCALIZED
    other = msgspec.structs.replace(restored.state, belief=bytes(belief))
    flight.start(replace(restored, state=other))
    flight.fly(20, until=lambda: flight.driver.status is Status.PURSUING)
    assert flight.last.task_cell != (x, y)
    assert "MISSION_COUNT" in flight.names_sent()


def test_a_pilot_who_takes_over_just_after_the_restart_keeps_the_vehicle(tmp_path: Path) -> None:
    flight = driving()
    flight.start(flight.saved(tmp_path))
    flight.fly(10, until=lambda: flight.driver.state(flight.now_ns).ready)
    flight.fly(1.2)
    flight.somebody_else_sets(HOLD)
    flight.fly(10)
    assert flight.body.autopilot.truth.mode == "HOLD"
    assert flight.last.reason == "no_vehicle"


@pytest.mark.parametrize("launch", ["auto", "armed"])
@pytest.mark.parametrize(("team", "mode", "name"), [("1A0G", 5, "LOITER"), ("0A1G", 0, "MANUAL")])
def test_a_restart_does_not_take_the_vehicle_from_the_pilot(
    team: str, mode: int, name: str, launch: str, tmp_path: Path
) -> None:
    flight = taken_by_the_pilot(team, mode, launch)
    flight.names_sent()
    for _ in range(2):
        flight.start(flight.saved(tmp_path))
        flight.fly(15)
    assert flight.body.autopilot.truth.mode == name
    assert not {"COMMAND_INT", "MISSION_COUNT", "MISSION_SET_CURRENT"} & set(flight.names_sent())
    flight.port.enable(flight.now_ns)
    flight.fly(30, until=lambda: flight.driver.state(flight.now_ns).ready)
    assert flight.driver.state(flight.now_ns).ready


def test_a_vehicle_that_the_pilot_has_put_down_is_ours_at_the_next_start(tmp_path: Path) -> None:
    flight = taken_by_the_pilot("0A1G", HOLD, "auto")
    restored = flight.saved(tmp_path)
    flight.somebody_else_disarms()
    flight.fly(2, step=False)
    flight.start(restored)
    flight.fly(30, until=lambda: flight.driver.state(flight.now_ns).ready)
    assert flight.driver.state(flight.now_ns).ready


def taken_by_the_pilot(team: str, mode: int, launch: str) -> Flight:
    """A vehicle that obeyed, until somebody else changed its mode."""
    flight = Flight(team, launch=launch)
    if launch == "armed":
        flight.fly(60)
        flight.somebody_else_sets(GUIDED[team])
        flight.fly(1)
        flight.somebody_else_arms()
    flight.fly(200, until=lambda: flight.driver.state(flight.now_ns).ready)
    flight.fly(10)
    flight.somebody_else_sets(mode)
    flight.fly(5)
    assert flight.last.reason == "no_vehicle"
    return flight


def test_a_state_without_a_mission_that_is_certain_leads_to_an_upload(tmp_path: Path) -> None:
    flight = driving()
    restored = flight.saved(tmp_path)
    assert restored.state is not None
    flight.start(replace(restored, state=msgspec.structs.replace(restored.state, vehicle=DriverMemory())))
    flight.fly(20, until=lambda: flight.driver.status is Status.PURSUING)
    assert flight.driver.status is Status.PURSUING
    assert "MISSION_COUNT" in flight.names_sent()


def test_signed_frames_after_a_restart_with_a_slow_clock_are_newer_than_those_before(tmp_path: Path) -> None:
    flight = Flight("0A1G", key=KEY)
    flight.fly(300, until=lambda: in_the_middle(flight))
    before = flight.sent[-1]
    flight.names_sent()
    flight.start(flight.saved(tmp_path), clock_skew_ns=-30 * NS_PER_S)
    flight.fly(3)
    assert signed_at(flight.sent[0]) > signed_at(before)
    assert flight.driver.status is Status.PURSUING
    assert "MISSION_COUNT" not in flight.names_sent()


def signed_at(frames: bytes) -> int:
    """The timestamp of the last of some signed frames."""
    return int.from_bytes(frames[-12:-6], "little")
