"""The driver end to end against a scripted autopilot, on bytes and a fake clock."""

from __future__ import annotations

import math

import pytest
from bridge_fake_vehicle import FakeVehicle, mav

from gatar_edge.bridge.driver import VehicleDriver
from gatar_edge.bridge.geo import cell_to_wgs84
from gatar_edge.bridge.settings import DriverConfig
from gatar_edge.bridge.status import EventKind, Status
from gatar_edge.separation import Place
from gatar_edge.types import Cell, Goto, GridSpec, Hold, Mission, RobotKind, VehicleCommand

S = 1_000_000_000
STEP = S // 20
GRID = GridSpec(width=15, height=12, cell_m=10.0, heading_deg=30.0)
START: Cell = (2, 3)
STACKS = ["ardupilot-copter", "ardupilot-rover", "px4-copter", "px4-rover"]


class Flight:
    """A driver and a fake vehicle on a perfect link."""

    def __init__(self, stack: str, **config: object) -> None:
        kind = RobotKind.UAV if stack.endswith("copter") else RobotKind.UGV
        lat, lon = cell_to_wgs84(GRID, START)
        self.vehicle = FakeVehicle(stack, 7, lat, lon)
        self.driver = VehicleDriver(DriverConfig(1, kind, GRID, 7, **config), 0)  # type: ignore[arg-type]
        self.now = 0
        self.events: list[str] = []
        self.statuses: list[Status] = []
        self.wanted: VehicleCommand | None = None
        self.deaf = False  # the vehicle hears nothing
        self.pursued: VehicleCommand | None = None

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds * S / STEP)):
            self.now += STEP
            if self.wanted is not None:
                self.pursued = self.driver.command(self.wanted, self.now)
            up = self.driver.poll(self.now)
            down = self.vehicle.poll(self.now, b"" if self.deaf else up)
            self.driver.receive(down, self.now)
            self.events += [f"{e.kind.value}: {e.text}" for e in self.driver.events()]
            self.statuses.append(self.driver.status)

    def go(self, wanted: VehicleCommand, seconds: float) -> None:
        self.wanted = wanted
        self.run(seconds)

    def launched(self) -> Flight:
        self.run(15)
        assert self.driver.state(self.now).ready, self.driver.state(self.now)
        return self

    def sent(self, name: str) -> list[object]:
        return [m for m in self.vehicle.received if m.get_type() == name]


@pytest.mark.parametrize("stack", STACKS)
def test_a_vehicle_is_armed_and_brought_to_where_it_obeys(stack: str) -> None:
    flight = Flight(stack).launched()
    state = flight.driver.state(flight.now)
    assert state.armed
    assert state.details["profile"] == stack
    assert state.cell == START
    if stack.endswith("copter"):
        assert state.alt_rel_m == pytest.approx(20, abs=1.1)


def test_a_copter_that_hovers_a_little_below_a_low_altitude_obeys() -> None:
    flight = Flight("ardupilot-copter", altitude_m=2.0).launched()
    flight.vehicle.target = (flight.vehicle.lat, flight.vehicle.lon, 1.8)
    flight.run(3)
    assert flight.driver.state(flight.now).ready


@pytest.mark.parametrize("stack", ["ardupilot-copter", "px4-copter"])
def test_a_copter_flies_to_the_cell_at_its_altitude(stack: str) -> None:
    flight = Flight(stack).launched()
    flight.go(Goto((9, 8)), 30)
    assert flight.driver.state(flight.now).cell == (9, 8)
    assert flight.driver.status is Status.ARRIVED
    assert flight.vehicle.alt == pytest.approx(20, abs=0.1)
    assert len([m for m in flight.sent("COMMAND_INT") if m.command == 192]) == 1  # type: ignore[attr-defined]


@pytest.mark.parametrize("stack", ["ardupilot-rover", "px4-rover"])
def test_a_rover_drives_its_corners_and_arrives(stack: str) -> None:
    flight = Flight(stack).launched()
    flight.go(Mission(((2, 7), (6, 7))), 40)
    assert flight.driver.state(flight.now).cell == (6, 7)
    assert flight.driver.status is Status.ARRIVED
    assert len(flight.vehicle.mission) == (3 if stack.startswith("ardu") else 2)


@pytest.mark.parametrize("stack", ["ardupilot-rover", "px4-rover"])
@pytest.mark.parametrize("after_s", [9.0, 60.0])  # mid-drive at the second waypoint, and after completion
def test_a_retasked_rover_starts_its_new_mission_at_the_first_waypoint(stack: str, after_s: float) -> None:
    flight = Flight(stack).launched()
    flight.go(Mission(((2, 6), (6, 6))), after_s)
    visited: set[Cell | None] = set()
    flight.wanted = Mission(((5, 2), (9, 2)))
    for _ in range(60):
        flight.run(1)
        visited.add(flight.driver.state(flight.now).cell)
    assert (5, 2) in visited
    assert flight.driver.state(flight.now).cell == (9, 2)
    assert flight.driver.status is Status.ARRIVED


@pytest.mark.parametrize("retasks", [1, 2, 3])
@pytest.mark.parametrize("stack", ["ardupilot-rover", "px4-rover"])
def test_the_end_of_a_mission_is_no_pilot_s_doing_however_often_the_rover_was_retasked(
    stack: str, retasks: int
) -> None:
    flight = Flight(stack).launched()
    flight.go(Mission(((2, 5),)), 3)
    assert flight.driver.status is Status.PURSUING
    flight.deaf = True
    for cell in ((2, 8), (6, 5), (9, 8))[:retasks]:
        flight.go(Mission((cell,)), 1)
    flight.run(4)  # it comes to the end of what it was told first
    flight.deaf = False
    flight.run(20)
    assert not [event for event in flight.events if event.startswith("pilot")]
    assert flight.driver.status in (Status.PURSUING, Status.ARRIVED)


def test_the_same_command_again_sends_nothing() -> None:
    flight = Flight("ardupilot-rover").launched()
    flight.go(Mission(((2, 7), (6, 7))), 60)
    assert len(flight.sent("MISSION_COUNT")) == 1


def test_what_remains_of_a_mission_is_not_a_retask() -> None:
    flight = Flight("ardupilot-rover").launched()
    path = Mission(((2, 7), (6, 7)))
    flight.wanted = path
    for _ in range(50):
        flight.run(1)
        cell = flight.driver.state(flight.now).cell
        if cell is not None and cell[1] == 7:
            flight.wanted = Mission(((6, 7),))
    assert flight.driver.state(flight.now).details["retasks"] == 1
    assert flight.driver.state(flight.now).cell == (6, 7)


def test_a_rover_is_stopped_by_a_mode_and_never_by_clearing_its_mission() -> None:
    flight = Flight("ardupilot-rover").launched()
    flight.go(Mission(((2, 10),)), 5)
    flight.go(Hold("enough"), 3)
    assert flight.driver.state(flight.now).mode == "HOLD"
    assert flight.driver.status is Status.HOLDING
    assert not flight.sent("MISSION_CLEAR_ALL")
    where = flight.vehicle.lat
    flight.run(5)
    assert flight.vehicle.lat == where


def test_a_stopped_copter_stays_where_it_is() -> None:
    flight = Flight("ardupilot-copter").launched()
    flight.go(Goto((12, 3)), 5)
    flight.go(Hold("enough"), 2)
    where = (flight.vehicle.lat, flight.vehicle.lon)
    flight.run(5)
    assert (flight.vehicle.lat, flight.vehicle.lon) == pytest.approx(where, abs=1e-7)
    assert flight.driver.state(flight.now).mode == "GUIDED"


def test_the_pilot_wins_and_nothing_is_commanded_until_enabled() -> None:
    flight = Flight("ardupilot-copter").launched()
    flight.go(Goto((9, 8)), 2)
    flight.vehicle.set_mode(5)  # LOITER, by the pilot
    flight.run(1)
    flight.vehicle.received.clear()
    flight.go(Goto((1, 1)), 10)
    assert flight.pursued == Hold("refused: the pilot has control")
    commands = [m for m in flight.vehicle.received if m.get_type() in ("COMMAND_LONG", "COMMAND_INT")]
    assert all(m.command in (511, 512) for m in commands)
    assert flight.vehicle.mode == 5
    flight.driver.enable(flight.now)
    flight.run(40)
    assert flight.driver.state(flight.now).cell == (1, 1)


@pytest.mark.parametrize(
    ("stack", "stands_in", "lands"),
    [("ardupilot-copter", 4, 9), ("ardupilot-copter", 0, 9), ("px4-copter", 0x03040000, 0x06040000)],
)
def test_a_pilot_who_breaks_off_the_take_off_wins(stack: str, stands_in: int, lands: int) -> None:
    flight = Flight(stack)
    flight.vehicle.mode = stands_in
    while flight.vehicle.alt < 6.0:
        flight.run(0.1)
        assert flight.now < 20 * S
    flight.vehicle.set_mode(lands)
    flight.run(0.5)
    before = len(flight.vehicle.received)
    flight.run(30)
    assert flight.vehicle.mode == lands
    assert flight.driver.state(flight.now).phase == "pilot"
    assert {m.get_type() for m in flight.vehicle.received[before:]} <= {"HEARTBEAT", "COMMAND_LONG"}
    asked = {m.command for m in flight.vehicle.received[before:] if m.get_type() == "COMMAND_LONG"}
    assert asked <= {511, 512}


def test_a_pilot_who_takes_off_by_hand_instead_keeps_the_copter() -> None:
    flight = Flight("ardupilot-copter")
    flight.vehicle.mode, answer = 4, flight.vehicle.on_command_long  # GUIDED, in which it is asked to arm, and does not

    def unarmable(message: mav.MAVLink_command_long_message) -> None:
        if message.command != 400:
            answer(message)

    flight.vehicle.on_command_long = unarmable  # type: ignore[method-assign]
    flight.run(9)
    assert flight.driver.state(flight.now).phase == "arming"
    flight.vehicle.set_mode(0)
    flight.vehicle.armed, flight.vehicle.target = True, None
    flight.run(3)
    flight.vehicle.alt = 15.0
    flight.run(10)
    assert flight.vehicle.mode == 0
    assert flight.driver.state(flight.now).phase == "pilot"


def test_a_fence_refusal_is_reported_by_name() -> None:
    flight = Flight("ardupilot-copter").launched()
    flight.vehicle.refuse_fence = True
    flight.go(Goto((9, 8)), 3)
    assert flight.driver.status is Status.REFUSED_FENCE


def test_a_target_that_is_never_confirmed_is_stale() -> None:
    flight = Flight("ardupilot-copter").launched()
    flight.vehicle.deaf_to_reposition = True
    flight.go(Goto((9, 8)), 8)
    assert flight.driver.status is Status.STALE_TARGET


def test_a_vehicle_that_does_not_get_nearer_is_reported() -> None:
    flight = Flight("ardupilot-rover").launched()
    flight.vehicle.stuck = True
    flight.go(Mission(((2, 9),)), 25)
    assert flight.driver.status is Status.NOT_PROGRESSING


def test_a_stale_position_holds_the_vehicle() -> None:
    flight = Flight("ardupilot-rover").launched()
    flight.go(Mission(((2, 10),)), 4)
    flight.vehicle.intervals.pop(33)
    flight.run(2)
    assert flight.pursued == Hold("refused: the position is too old")
    assert flight.vehicle.mode == 4


def test_rates_that_fall_short_are_asked_for_again() -> None:
    flight = Flight("ardupilot-rover").launched()
    flight.vehicle.intervals[33] = 1_000_000
    flight.run(25)
    assert flight.vehicle.intervals[33] == 200_000


def test_a_rover_on_hold_that_tells_no_target_is_no_short_rate() -> None:
    flight = Flight("ardupilot-rover").launched()
    flight.go(Hold("stop"), 5)
    flight.events.clear()
    flight.run(25)
    assert not [event for event in flight.events if event.startswith("rates") and "87" in event]


@pytest.mark.parametrize("stack", STACKS)
def test_a_stack_that_tells_all_it_can_is_not_asked_again(stack: str) -> None:
    flight = Flight(stack).launched()
    flight.go(Goto((9, 8)) if stack.endswith("copter") else Mission(((2, 11),)), 5)
    flight.events.clear()
    flight.run(25)
    assert not [event for event in flight.events if event.startswith("rates") and "42" in event]


def test_the_heartbeat_is_that_of_a_companion_and_comes_from_poll_alone() -> None:
    flight = Flight("ardupilot-rover")
    flight.run(5)
    beats = flight.sent("HEARTBEAT")
    assert len(beats) == 5
    first = beats[0]
    assert (first.type, first.autopilot, first.system_status) == (18, 8, 4)  # type: ignore[attr-defined]
    assert (first.get_srcSystem(), first.get_srcComponent()) == (7, 191)  # type: ignore[attr-defined]


def test_a_failing_robot_says_so_and_then_falls_silent() -> None:
    flight = Flight("ardupilot-rover")
    flight.run(3)
    flight.driver.health(critical=True)
    flight.vehicle.received.clear()
    flight.run(20)
    states = [m.system_status for m in flight.sent("HEARTBEAT")]  # type: ignore[attr-defined]
    assert 3 <= len(states) <= 6
    assert set(states) == {5}
    flight.driver.health(critical=False)
    flight.run(3)
    assert flight.sent("HEARTBEAT")[-1].system_status == 4  # type: ignore[attr-defined]


def test_an_unknown_autopilot_is_refused_by_name() -> None:
    flight = Flight("ardupilot-rover")
    flight.vehicle.px4, flight.vehicle.heartbeat = False, lambda: None
    heartbeat = mav.MAVLink_heartbeat_message(2, 0, 1, 0, 4, 3)
    flight.driver.receive(heartbeat.pack(flight.vehicle.mav), 1)
    state = flight.driver.state(2)
    assert state.phase == "unsupported"
    assert "generic autopilot" in state.details["unsupported"]


def test_a_vehicle_of_the_other_kind_is_refused() -> None:
    flight = Flight("ardupilot-copter")
    flight.vehicle.flies = False
    flight.run(3)
    assert flight.driver.state(flight.now).phase == "unsupported"


def test_other_vehicles_on_the_link_are_ignored() -> None:
    flight = Flight("ardupilot-rover").launched()
    before = flight.driver.state(flight.now)
    other = FakeVehicle("ardupilot-rover", 8, 10.0, 20.0)
    other.intervals[33] = 200_000
    flight.driver.receive(other.poll(10 * S, b""), flight.now)
    assert flight.driver.state(flight.now) == before


def test_a_lost_heartbeat_is_told_and_refuses_commands() -> None:
    flight = Flight("ardupilot-rover").launched()
    flight.vehicle.silent = True
    flight.go(Mission(((2, 9),)), 5)
    assert not flight.driver.state(flight.now).connected
    assert isinstance(flight.pursued, Hold)
    assert any(e.startswith(EventKind.LOST.value) for e in flight.events)


def test_raw_frames_of_both_directions_are_kept_for_the_log() -> None:
    flight = Flight("ardupilot-rover")
    flight.run(3)
    frames = flight.driver.frames()
    assert {f.outgoing for f in frames} == {True, False}
    assert all(f.raw[0] == 0xFD for f in frames)
    assert flight.driver.frames() == ()


def test_state_before_any_vehicle_is_finite_where_it_can_be() -> None:
    state = VehicleDriver(DriverConfig(1, RobotKind.UAV, GRID, 7), 0).state(5)
    assert (state.phase, state.connected, state.cell) == ("searching", False, None)
    assert math.isnan(state.lat_deg)


@pytest.mark.parametrize("stack", ["ardupilot-rover", "px4-rover"])
def test_a_rover_may_also_be_driven_by_guided_targets(stack: str) -> None:
    flight = Flight(stack, drive="guided").launched()
    flight.go(Mission(((2, 7), (6, 7))), 40)
    assert flight.driver.state(flight.now).cell == (6, 7)
    assert flight.driver.status is Status.ARRIVED
    assert not flight.sent("MISSION_COUNT")


@pytest.mark.parametrize("stack", ["ardupilot-copter", "ardupilot-rover"])
def test_targets_are_given_as_setpoints_where_configured(stack: str) -> None:
    flight = Flight(stack, drive="guided", targets="setpoint").launched()
    flight.go(Mission(((2, 7), (6, 7))), 45)
    assert flight.driver.state(flight.now).cell == (6, 7)
    assert flight.driver.status is Status.ARRIVED
    assert len(flight.sent("SET_POSITION_TARGET_GLOBAL_INT")) == 2  # once for each corner
    assert not flight.sent("COMMAND_INT")
    if stack.endswith("copter"):
        assert flight.vehicle.alt == pytest.approx(20, abs=0.1)
        flight.go(Hold("stop"), 5)
        assert flight.driver.status is Status.HOLDING


def test_a_setpoint_that_the_vehicle_ignores_is_a_stale_target() -> None:
    flight = Flight("ardupilot-copter", targets="setpoint").launched()
    flight.vehicle.refuse_fence = True
    flight.go(Goto((9, 8)), 9)
    assert Status.STALE_TARGET in flight.statuses


def test_setpoints_are_refused_by_name_where_they_would_have_to_be_streamed() -> None:
    flight = Flight("px4-copter", targets="setpoint")
    flight.run(5)
    assert "px4-copter" in flight.driver.state(flight.now).details["unsupported"]


def test_a_rover_that_stops_short_of_its_guided_targets_goes_on_to_the_next_and_arrives() -> None:
    flight = Flight("ardupilot-rover", drive="guided").launched()
    flight.vehicle.stops_short_m = 2.9  # WP_RADIUS is 3 m in ArduPilot's simulator
    flight.go(Mission(((2, 7), (6, 7))), 40)
    assert flight.driver.state(flight.now).cell == (6, 7)
    assert flight.driver.status is Status.ARRIVED
    assert not any(status.failed for status in flight.statuses)


def test_a_rover_that_stops_outside_of_the_cell_has_not_arrived() -> None:
    flight = Flight("ardupilot-rover", drive="guided").launched()
    flight.vehicle.stops_short_m = 6.0
    flight.go(Mission(((2, 7),)), 40)
    assert flight.driver.status is Status.NOT_PROGRESSING


@pytest.mark.parametrize("targets", ["reposition", "setpoint"])
@pytest.mark.parametrize("detours_after_s", [0, 4])
def test_a_rover_that_goes_round_an_obstacle_by_itself_and_tells_that_place_is_going_to_its_target(
    targets: str, detours_after_s: int
) -> None:
    flight = Flight("ardupilot-rover", drive="guided", targets=targets).launched()
    flight.vehicle.speed = 1.5
    flight.vehicle.detour_e7 = 0 if detours_after_s else 500
    flight.go(Mission(((2, 9), (5, 9))), detours_after_s)
    flight.vehicle.detour_e7 = 500
    flight.run(80)
    assert flight.driver.state(flight.now).cell == (5, 9)
    assert flight.driver.status is Status.ARRIVED
    assert not any(status.failed for status in flight.statuses)


@pytest.mark.parametrize("targets", ["reposition", "setpoint"])
def test_a_rover_that_tells_another_target_and_gets_no_nearer_has_a_stale_one(targets: str) -> None:
    flight = Flight("ardupilot-rover", drive="guided", targets=targets).launched()
    flight.vehicle.detour_e7, flight.vehicle.stuck = 500, True
    flight.go(Mission(((2, 9),)), 12)
    assert Status.STALE_TARGET in flight.statuses


@pytest.mark.parametrize("stack", STACKS)
def test_without_an_origin_nothing_is_armed_and_no_target_leaves(stack: str) -> None:
    flight = Flight(stack)
    flight.vehicle.has_origin = False
    flight.go(Goto((9, 8)) if stack.endswith("copter") else Mission(((2, 7),)), 15)
    assert not flight.vehicle.armed
    assert not flight.sent("COMMAND_INT")
    assert not flight.sent("MISSION_COUNT")
    flight.vehicle.has_origin = True
    flight.run(60)
    assert flight.driver.status is Status.ARRIVED


@pytest.mark.parametrize("stack", STACKS)
def test_a_firmware_that_never_tells_its_origin_is_flown_once_its_position_has_shown_it(stack: str) -> None:
    flight = Flight(stack)
    flight.vehicle.has_origin = False
    flight.go(Goto((9, 8)) if stack.endswith("copter") else Mission(((2, 7),)), 90)
    assert flight.driver.status is Status.ARRIVED


def test_the_gate_asks_for_the_origin_by_itself() -> None:
    flight = Flight("ardupilot-copter").launched()
    assert flight.driver._vehicle is not None
    seen = flight.driver._vehicle.seen
    seen.origin, seen.position_first_ns = None, seen.position_ns
    flight.vehicle.has_origin = False
    flight.go(Goto((9, 8)), 3)
    assert flight.pursued == Hold("refused: the estimator's origin is not known")


def test_a_goal_that_a_neighbor_stands_on_is_refused_until_it_is_free() -> None:
    flight = Flight("ardupilot-rover", min_separation_m=5.0).launched()
    flight.driver.neighbors((Place((25.0, 75.0), 0.0),))
    flight.go(Mission(((2, 7),)), 5)
    assert flight.pursued == Hold("refused: another robot is there, goes there, or stands in the way")
    assert not flight.sent("MISSION_COUNT")
    flight.driver.neighbors(())
    flight.run(40)
    assert flight.driver.state(flight.now).cell == (2, 7)
