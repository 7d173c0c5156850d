"""The driver where things go wrong: lossy links, slow boots, restarts, other ground stations, noise."""

from __future__ import annotations

import random

import pytest
from bridge_fake_vehicle import PX4_LOITER, PX4_MANUAL, FakeVehicle, S, mav
from bridge_mission_server import Lossy

from gatar_edge.bridge.driver import VehicleDriver
from gatar_edge.bridge.geo import cell_to_wgs84
from gatar_edge.bridge.settings import DriverConfig
from gatar_edge.bridge.status import Status
from gatar_edge.errors import ConfigError
from gatar_edge.types import Cell, Goto, GridSpec, Hold, Mission, RobotKind, VehicleCommand

STEP = S // 20
GRID = GridSpec(width=15, height=12, cell_m=10.0)
START: Cell = (2, 3)
STACKS = ["ardupilot-copter", "ardupilot-rover", "px4-copter", "px4-rover"]


class Field:
    """A driver and a fake vehicle with a bad link between them."""

    def __init__(self, stack: str, *, seed: int = 0, loss: float = 0.0, boot_s: float = 3.0, **config: object) -> None:
        rng = random.Random(seed)
        self.kind = RobotKind.UAV if stack.endswith("copter") else RobotKind.UGV
        self.vehicle = FakeVehicle(stack, 7, *cell_to_wgs84(GRID, START), boot_s=boot_s)
        self.config = DriverConfig(1, self.kind, GRID, 7, seed=seed, **config)  # type: ignore[arg-type]
        self.driver = VehicleDriver(self.config, 0)
        bad = (loss, 0.1, 300) if loss else (0.0, 0.0, 0)
        self.up, self.down = Lossy(rng, *bad), Lossy(rng, *bad)
        self.now = 0
        self.events: list[str] = []
        self.visited: set[Cell | None] = set()

    def run(self, seconds: float, wanted: VehicleCommand | None = None) -> None:
        for _ in range(round(seconds * S / STEP)):
            self.now += STEP
            if wanted is not None:
                self.driver.command(wanted, self.now)
            self.up.put(self.driver.poll(self.now), self.now)
            arrived = b"".join(self.up.get(self.now))  # type: ignore[arg-type]
            self.down.put(self.vehicle.poll(self.now, arrived), self.now)
            for data in self.down.get(self.now):
                self.driver.receive(data, self.now)  # type: ignore[arg-type]
            self.events += [f"{e.kind.value}: {e.text}" for e in self.driver.events()]
            self.visited.add(self.driver.state(self.now).cell)

    def until(self, done: object, seconds: float, wanted: VehicleCommand | None = None) -> bool:
        """Run until `done()`; False when that takes longer."""
        for _ in range(round(seconds)):
            self.run(1, wanted)
            if done():  # type: ignore[operator]
                return True
        return False

    def ready(self) -> bool:
        return self.driver.state(self.now).ready

    def arrived(self) -> bool:
        return self.driver.status is Status.ARRIVED

    def commands_since(self, mark: int) -> list[int]:
        return [m.command for m in self.vehicle.received[mark:] if m.get_type() in ("COMMAND_LONG", "COMMAND_INT")]


@pytest.mark.parametrize("stack", STACKS)
@pytest.mark.parametrize("seed", range(8))
def test_a_vehicle_behind_a_lossy_link_is_launched_and_reaches_two_targets(stack: str, seed: int) -> None:
    field = Field(stack, seed=seed, loss=0.2, position_max_age_s=3.0)
    assert field.until(field.ready, 60), field.events
    flies = field.kind is RobotKind.UAV
    goals: list[VehicleCommand] = (
        [Goto((9, 8)), Goto((1, 1))] if flies else [Mission(((2, 7), (6, 7))), Mission(((6, 2), (10, 2)))]
    )
    for goal in goals:
        last = goal.cell if isinstance(goal, Goto) else goal.cells[-1]  # type: ignore[union-attr]
        assert field.until(lambda: field.arrived() and field.driver.state(field.now).cell == last, 180, goal), (  # noqa: B023
            field.events[-20:]
        )
    if not flies:
        assert {(2, 7), (6, 7), (6, 2)} <= field.visited


@pytest.mark.parametrize("targets", ["reposition", "setpoint"])
def test_a_mode_whose_answer_was_lost_is_not_asked_for_any_more_once_another_is_wanted(targets: str) -> None:
    field = Field("ardupilot-rover", drive="guided", targets=targets)
    answer = field.vehicle.ack
    field.vehicle.ack = lambda command, result: None if command == 176 else answer(command, result)  # type: ignore[method-assign]
    field.until(field.ready, 30)
    goal = Mission(((2, 7),))
    assert field.until(field.arrived, 30, goal), field.events[-5:]
    field.run(10, goal)
    assert not [event for event in field.events if event.startswith("pilot")]
    assert field.vehicle.mode == field.vehicle.guided_mode


def test_arming_is_asked_for_until_the_filters_are_ready() -> None:
    field = Field("ardupilot-copter", boot_s=45)
    field.run(44)
    assert not field.vehicle.armed
    assert field.until(field.ready, 25)


def test_a_restarted_companion_does_not_take_a_flying_copter_off_again() -> None:
    field = Field("ardupilot-copter")
    field.until(field.ready, 30)
    field.driver = VehicleDriver(field.config, field.now)
    mark = len(field.vehicle.received)
    assert field.until(field.ready, 5)
    assert 22 not in field.commands_since(mark)
    assert 400 not in field.commands_since(mark)


def test_a_px4_rover_without_a_transmitter_is_not_waited_for_in_manual() -> None:
    field = Field("px4-rover")
    field.vehicle.mode, arm = PX4_MANUAL, field.vehicle.on_command_long

    def armable_by_itself(message: object) -> None:  # PX4: "No manual control input"
        if message.command == 400 and field.vehicle.mode == PX4_MANUAL:  # type: ignore[attr-defined]
            field.vehicle.ack(400, 1)
        else:
            arm(message)  # type: ignore[arg-type]

    field.vehicle.on_command_long = armable_by_itself  # type: ignore[method-assign]
    assert field.until(field.ready, 30)


def test_a_copter_that_disarms_before_take_off_is_armed_again() -> None:
    field = Field("ardupilot-copter")
    field.until(lambda: field.vehicle.armed, 20)
    field.vehicle.armed, field.vehicle.target = False, None
    assert field.until(field.ready, 40)


def test_a_vehicle_disarmed_by_somebody_else_is_left_alone() -> None:
    field = Field("ardupilot-rover")
    field.until(field.ready, 30)
    field.run(3, Mission(((2, 9),)))
    field.vehicle.armed = False
    field.run(3)
    mark = len(field.vehicle.received)
    field.run(5, Mission(((2, 9),)))
    assert set(field.commands_since(mark)) <= {511, 512}
    assert field.driver.state(field.now).phase == "pilot"


def test_px4_going_to_hold_after_its_last_item_is_not_the_pilot() -> None:
    field = Field("px4-rover")
    field.until(field.ready, 30)
    assert field.until(field.arrived, 60, Mission(((2, 6),)))
    field.run(5, Mission(((2, 6),)))
    assert field.vehicle.mode == PX4_LOITER
    assert field.driver.state(field.now).phase == "ready"
    assert field.until(field.arrived, 60, Mission(((5, 6),)))


def test_px4_put_on_hold_in_the_middle_of_its_mission_is_the_pilot() -> None:
    field = Field("px4-rover")
    field.until(field.ready, 30)
    field.run(4, Mission(((2, 11),)))
    field.vehicle.set_mode(PX4_LOITER)
    field.run(2, Mission(((2, 11),)))
    assert field.driver.state(field.now).phase == "pilot"


def test_a_mission_that_somebody_else_uploads_is_noticed_and_replaced() -> None:
    field = Field("ardupilot-rover", failed_retry_s=3.0)
    field.until(field.ready, 30)
    field.run(5, Mission(((2, 11),)))
    field.vehicle.mission = [*field.vehicle.mission, *field.vehicle.mission]
    field.run(2, Mission(((2, 11),)))
    assert "status: stale_target" in field.events
    assert field.until(field.arrived, 60, Mission(((2, 11),)))
    assert len(field.vehicle.mission) == 2


@pytest.mark.parametrize("stack", ["ardupilot-rover", "px4-rover"])
@pytest.mark.parametrize("corners", [((6, 3), (10, 3)), ((6, 3),), ()])
def test_a_mission_that_was_replaced_while_the_vehicle_held_is_put_on_board_again(
    stack: str, corners: tuple[Cell, ...]
) -> None:
    field, north = Field(stack), Mission(((2, 11),))
    field.until(field.ready, 30)
    field.run(5, north)
    field.run(3, Hold("wait"))
    field.vehicle.replace_mission([cell_to_wgs84(GRID, cell) for cell in corners])
    field.run(3, Hold("wait"))
    field.visited.clear()
    assert field.until(field.arrived, 60, north)
    assert field.driver.state(field.now).cell == (2, 11)
    if len(corners) != 1:  # of another length: that is told, and the other mission is never driven
        assert {cell[0] for cell in field.visited if cell is not None} == {2}


def test_a_target_moved_by_somebody_else_is_set_again() -> None:
    field = Field("ardupilot-copter")
    field.until(field.ready, 30)
    field.run(3, Goto((9, 8)))
    field.vehicle.target = (*cell_to_wgs84(GRID, (0, 0)), 20.0)
    assert field.until(field.arrived, 40, Goto((9, 8)))
    assert field.driver.state(field.now).cell == (9, 8)


@pytest.mark.parametrize("stack", STACKS)
def test_noise_on_the_link_changes_nothing(stack: str) -> None:
    field, rng = Field(stack), random.Random(3)
    assert field.until(field.ready, 30)
    for _ in range(300):
        field.driver.receive(rng.randbytes(rng.randrange(80)), field.now)
    field.driver.receive(bytes(600), field.now)
    assert field.ready()


def test_every_message_of_the_autopilot_with_random_content_is_survived() -> None:
    field, rng = Field("ardupilot-rover"), random.Random(4)
    field.until(field.ready, 30)
    for _ in range(40):
        for message_id in (0, 1, 33, 40, 42, 44, 47, 51, 73, 77, 87, 242, 245, 253):
            kind = mav.mavlink_map[message_id]
            payload = rng.randbytes(kind.unpacker.size)
            header = bytes([0xFD, len(payload), 0, 0, 0, 7, 1, message_id, 0, 0])
            crc = mav.x25crc(header[1:] + payload + bytes([kind.crc_extra])).crc
            field.driver.receive(header + payload + crc.to_bytes(2, "little"), field.now)
        field.now += STEP
        field.driver.command(Mission(((2, 9),)), field.now)
        field.driver.poll(field.now)
        assert field.driver.state(field.now).t_ns == field.now


def test_twelve_vehicles_on_one_link_do_not_hear_each_other() -> None:
    fields = []
    for sysid in range(1, 13):
        vehicle = FakeVehicle("ardupilot-rover", sysid, *cell_to_wgs84(GRID, (sysid, 3)))
        fields.append((vehicle, VehicleDriver(DriverConfig(sysid, RobotKind.UGV, GRID, sysid), 0)))
    rng, now = random.Random(1), 0
    for _ in range(30 * 20):
        now += STEP
        for vehicle, driver in fields:
            if driver.state(now).ready:
                driver.command(Mission(((vehicle.peer[0], 6),)), now)
        everything = b"".join(driver.poll(now) for _, driver in fields)
        answers = [vehicle.poll(now, everything) for vehicle, _ in fields]
        rng.shuffle(answers)
        for _, driver in fields:
            driver.receive(b"".join(answers), now)
    assert [driver.state(now).cell for _, driver in fields] == [(sysid, 6) for sysid in range(1, 13)]


def test_a_polygon_fence_holds_a_command_that_leaves_it() -> None:
    corners = tuple(cell_to_wgs84(GRID, c) for c in ((0, 0), (8, 0), (8, 8), (0, 8)))
    field = Field("ardupilot-copter", fence_deg=corners)
    field.until(field.ready, 30)
    assert field.driver.command(Goto((12, 3)), field.now) == Hold("refused: outside the fence")
    field.now += 2 * S
    field.run(0.1)
    assert field.driver.command(Goto((7, 7)), field.now) == Goto((7, 7))


def test_a_hold_that_could_not_be_sent_is_sent_when_the_link_returns() -> None:
    field = Field("ardupilot-rover", position_max_age_s=100.0)
    field.until(field.ready, 30)
    field.run(4, Mission(((2, 11),)))
    field.vehicle.silent = True
    field.run(8, Mission(((2, 11),)))
    field.run(1, Hold("enough"))
    assert field.vehicle.mode == 10
    field.vehicle.silent = False
    field.run(3, Hold("enough"))
    assert field.vehicle.mode == 4


def test_a_heartbeat_that_was_overtaken_is_not_the_pilot() -> None:
    field = Field("ardupilot-rover")
    field.until(field.ready, 30)
    old = mav.MAVLink_heartbeat_message(10, 3, 129, 0, 4, 3)  # from before: MANUAL
    number = field.vehicle.mav.seq
    field.vehicle.mav.seq = (number - 100) % 256
    frame = old.pack(field.vehicle.mav)
    field.vehicle.mav.seq = number
    field.run(0.9)
    field.driver.receive(frame, field.now)
    field.run(1)
    assert field.driver.state(field.now).phase == "ready"


@pytest.mark.parametrize("frames_a_second", [200, 400, 700])
@pytest.mark.parametrize("after_s", [5, 6])
def test_a_pilot_is_noticed_at_once_on_a_busy_link(frames_a_second: int, after_s: int) -> None:
    """As PX4 sends to a companion: so many frames between two heartbeats that their numbers begin again."""
    field = Field("px4-rover")
    field.until(field.ready, 30)
    send, filler = field.vehicle.stream, mav.MAVLink_attitude_message(0, 0, 0, 0, 0, 0, 0)

    def stream() -> None:
        for _ in range(frames_a_second // 20):
            field.vehicle.send(filler)
        send()

    field.vehicle.stream = stream  # type: ignore[method-assign]
    field.run(after_s)
    field.vehicle.mode = PX4_MANUAL
    field.run(1)
    assert field.driver.state(field.now).phase == "pilot"


def test_a_slow_upload_stops_a_rover_that_would_drive_a_mix_of_two_missions() -> None:
    field = Field("ardupilot-rover")
    field.until(field.ready, 30)
    field.run(4, Mission(((2, 11),)))
    original, field.vehicle.ask = field.vehicle.ask, lambda: None  # every request is lost
    field.run(3, Mission(((8, 4), (8, 8))))
    assert field.vehicle.mode == 4
    field.vehicle.ask = original
    assert field.until(field.arrived, 90, Mission(((8, 4), (8, 8))))
    assert (8, 4) in field.visited


def test_a_quick_upload_does_not_stop_a_rover() -> None:
    field = Field("ardupilot-rover")
    field.until(field.ready, 30)
    field.run(4, Mission(((2, 11),)))
    mark = len(field.vehicle.received)
    field.run(5, Mission(((8, 4), (8, 8))))
    assert 176 not in field.commands_since(mark)


def test_a_mode_of_ours_that_shows_up_late_is_not_the_pilot() -> None:
    field = Field("ardupilot-rover", drive="guided")
    field.until(field.ready, 30)
    beat, field.vehicle.heartbeat = field.vehicle.heartbeat, lambda: None  # five heartbeats are lost
    field.run(5, Mission(((2, 6),)))
    field.vehicle.heartbeat = beat
    assert field.until(field.arrived, 30, Mission(((2, 6),)))


def test_a_speed_is_given_with_guided_targets_and_after_a_mission_began() -> None:
    copter = Field("ardupilot-copter", speed_m_s=3.0)
    copter.until(copter.ready, 30)
    copter.run(2, Goto((9, 8)))
    assert [m.param1 for m in copter.vehicle.received if m.get_type() == "COMMAND_INT"] == [3.0]
    # ArduCopter ignores that one, and enters its position control at its own speed
    speeds = [m.param2 for m in copter.vehicle.received if m.get_type() == "COMMAND_LONG" and m.command == 178]
    assert speeds == [3.0]
    rover = Field("ardupilot-rover", speed_m_s=2.0)
    rover.until(rover.ready, 30)
    rover.run(3, Mission(((2, 9),)))
    speeds = [m.param2 for m in rover.vehicle.received if m.get_type() == "COMMAND_LONG" and m.command == 178]
    assert speeds == [2.0]


def test_a_take_off_that_was_lost_is_asked_for_again() -> None:
    field = Field("ardupilot-copter")
    original, lost = field.vehicle.on_command_long, []

    def deaf(message: object) -> None:
        if message.command == 22 and len(lost) < 6:  # type: ignore[attr-defined]
            lost.append(message)
        else:
            original(message)

    field.vehicle.on_command_long = deaf
    assert field.until(field.ready, 60)
    assert len(lost) == 6


def test_an_upload_that_the_vehicle_refuses_is_reported_with_its_reason() -> None:
    field = Field("ardupilot-rover")
    field.until(field.ready, 30)
    field.vehicle.on_mission_count = lambda _m: field.vehicle.mission_ack(4)
    field.run(2, Mission(((2, 9),)))
    assert field.driver.status is Status.UPLOAD_FAILED
    assert "status: upload_failed: too many items for the vehicle" in field.events


def test_a_px4_mode_that_never_switches_is_reported_though_it_is_acknowledged() -> None:
    field = Field("px4-rover")
    field.until(field.ready, 30)
    field.vehicle.set_mode = lambda _mode: None
    field.run(14, Mission(((2, 9),)))
    assert field.driver.status is Status.STALE_TARGET


def test_a_px4_rover_that_ignores_its_new_current_item_is_reported() -> None:
    field = Field("px4-rover")
    field.until(field.ready, 30)
    assert field.until(field.arrived, 60, Mission(((2, 6), (4, 6))))
    field.vehicle.on_mission_set_current = lambda _m: None  # "Busy"
    field.run(8, Mission(((4, 3), (8, 3))))
    assert field.driver.status is Status.STALE_TARGET


@pytest.mark.parametrize("stack", ["ardupilot-rover", "px4-rover"])
def test_a_rover_that_goes_round_an_obstacle_by_itself_and_tells_that_place_is_driving_its_mission(stack: str) -> None:
    field = Field(stack)
    field.until(field.ready, 30)
    field.vehicle.detour_e7, field.vehicle.speed = 500, 1.5
    field.run(25, Mission(((2, 9),)))
    assert field.driver.status is Status.PURSUING
    assert field.until(lambda: field.driver.status is Status.ARRIVED, 60, Mission(((2, 9),)))


def test_without_auto_launch_nothing_is_armed_until_told() -> None:
    field = Field("ardupilot-rover", auto_launch=False)
    field.run(10)
    assert not field.vehicle.armed
    field.driver.launch()
    assert field.until(field.ready, 10)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"sysid": 0}, "sysid is 0, must be 1 to 255"),
        ({"drive": "fly"}, "drive is fly"),
        ({"altitude_m": 500.0}, "outside altitude_band_m"),
        ({"fence_deg": ((1.0, 2.0),)}, "at least 3 corners"),
        ({"heartbeat_hz": 0.0}, "heartbeat_hz"),
    ],
)
def test_a_configuration_that_cannot_be_flown_is_refused(changes: dict[str, object], text: str) -> None:
    values: dict[str, object] = {"robot_id": 1, "kind": RobotKind.UAV, "grid": GRID, "sysid": 7, **changes}
    with pytest.raises(ConfigError, match=text):
        DriverConfig(**values)  # type: ignore[arg-type]
