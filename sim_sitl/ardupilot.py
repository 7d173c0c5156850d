"""ArduCopter and ArduRover 4.6: modes, commands, targets and missions as measured on the real binaries."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from gatar_edge.sim_sitl.core import Core, Phase, RunnerLike
from gatar_edge.sim_sitl.failsafe import Fence, use_speed_parameter
from gatar_edge.sim_sitl.mission_items import TAKEOFF, Ack, Item, check_ardupilot, stored_by_ardupilot
from gatar_edge.sim_sitl.mission_runner import ACTIVE, COMPLETE, NO_MISSION, NOT_STARTED, Runner
from gatar_edge.sim_sitl.mission_server import Rules
from gatar_edge.sim_sitl.modes import ARDUCOPTER, ARDUROVER, Does, Mode, by_name
from gatar_edge.sim_sitl.orders import COMMON, FORCE, Handler, Order, Result
from gatar_edge.sim_sitl.parameters import ARDUCOPTER as COPTER_PARAMETERS
from gatar_edge.sim_sitl.parameters import ARDUROVER as ROVER_PARAMETERS
from gatar_edge.sim_sitl.telemetry import COMMON as COMMON_STREAMS
from gatar_edge.sim_sitl.telemetry import Fields, Stream, ekf_status_report, gps_global_origin, home_position
from gatar_edge.sim_sitl.vehicle import Goal, Velocity
from gatar_edge.sim_sitl.wire import Message
from gatar_edge.types import NS_PER_S

AMSL_FRAMES = frozenset({0, 5})
TERRAIN_FRAMES = frozenset({10, 11})
TARGET_FRAMES = frozenset({0, 3, 5, 6, 10, 11})
# Bits of POSITION_TARGET_TYPEMASK: set means ignore.
_POSITION_BITS, _VELOCITY_BITS, _ACCELERATION_BITS, _FORCE_BIT = 0x007, 0x038, 0x1C0, 0x200
_ROVER_POSITION_BITS = 0x003  # a rover has no altitude to ignore
_ITEM_NAMES = {
    16: "WP",
    17: "LoitUnlim",
    19: "LoitTime",
    20: "RTL",
    21: "Land",
    22: "Takeoff",
    93: "Delay",
    177: "Jump",
}
_DONE_BEHAVE = {1: "LOITER", 3: "MANUAL"}  # MIS_DONE_BEHAVE; 0 holds, staying in AUTO

RULES = Rules(
    request="MISSION_REQUEST",
    retry_ns=NS_PER_S,
    retry_jitter_ns=NS_PER_S // 5,
    give_up_ns=8 * NS_PER_S,
    give_up_ack=Ack.OPERATION_CANCELLED,
    atomic=False,
    home_in_slot_0=True,
    wrong_seq=Ack.INVALID_SEQUENCE,
    repeated_last=Ack.ERROR,
    restart_anywhere=True,
    foreign_count=Ack.DENIED,
    foreign_list=Ack.DENIED,
    client_can_cancel=False,
    downloads_are_transfers=False,
    capacity=650,
    check=check_ardupilot,
    stored=stored_by_ardupilot,
)


class ArduRunner(Runner):
    """AUTO of ArduPilot: stays in AUTO when the mission is over; a new mission keeps the old index."""

    @property
    def _running(self) -> bool:
        return self.core.mode.does is Does.AUTO and self.state == ACTIVE

    def enter(self) -> None:
        if self.state == COMPLETE or not 0 < self.index < len(self.items):
            self.reset_jumps()
            self._start(1)
        else:
            self._start(self.index)

    def leave(self) -> None:
        self.leg = None
        if self.state == ACTIVE:
            self.state = NOT_STARTED

    def start_again(self) -> None:
        """MISSION_START on a copter: go on from the index, or from the first item when all was done."""
        self.core.lift = self.core.lift or self.core.landed
        self.enter()

    def done(self) -> None:
        core, seq = self.core, self.index
        item = self.leg
        if item is not None and item.command in _ITEM_NAMES:
            core.emit("MISSION_ITEM_REACHED", seq=seq)
            if item.command != TAKEOFF:
                core.text(6, f"Reached command #{seq}" if core.is_copter else f"Reached waypoint #{seq}")
        following = self.following()
        if 0 < following < len(self.items):
            self._start(following)
        else:
            self._complete()
        self.announce()

    def changed(self, seq: int | None) -> None:
        self.core.params.put("MIS_TOTAL", len(self.items))
        if not self._running:
            if not self.items:
                self.index, self.state, self.leg = 0, NOT_STARTED, None
        elif seq is not None and self.index < len(self.items):
            self._start(self.index)
            self.core.text(2, "Auto mission changed, restarted command")

    def received(self) -> None:
        if self.state == NO_MISSION:
            self.state = NOT_STARTED
        self.core.text(6, "Flight plan received")
        self.announce()

    def set_current(self, seq: int) -> None:
        if not self.choose(seq, reset=False):
            self.core.text(2, "Mission item does not exist")

    def choose(self, seq: int, reset: bool) -> bool:
        """DO_SET_MISSION_CURRENT: False out of range. Only `reset` starts what is complete."""
        seq = seq or 1
        if not 0 < seq < len(self.items):
            return False
        if reset:
            self.reset_jumps()
        if reset or self._running:
            self._start(seq)
        else:
            self.index, self.state, self.leg = seq, NOT_STARTED, None
        self.announce()
        return True

    def announce(self) -> None:
        """Send MISSION_CURRENT now."""
        self.core.emit("MISSION_CURRENT", **mission_current(self.core))

    def acceptance_m(self, item: Item) -> float:
        return self.core.params["WPNAV_RADIUS"] / 100 if self.core.is_copter else self.core.params["WP_RADIUS"]

    def _start(self, index: int) -> None:
        self.state = ACTIVE
        if self.core.mode.does is Does.AUTO:
            self.begin(index)
        else:
            self.index = index
        self.core.text(6, f"Mission: {index} {_ITEM_NAMES.get(self.items[index].command, 'Do')}")

    def _complete(self) -> None:
        core = self.core
        self.state, self.leg = COMPLETE, None
        if isinstance(core.nav, Goal):
            core.nav = replace(core.nav, exit_m_s=0.0)
        if core.is_copter:
            return
        core.text(5, "Mission Complete")
        behave = _DONE_BEHAVE.get(int(core.params["MIS_DONE_BEHAVE"]))
        if behave is not None:
            core.enter(by_name(core.stack.modes, behave))


def mission_current(core: Core) -> Fields:
    """MISSION_CURRENT: the total excludes home; the index is kept even where it lies behind the end."""
    total = max(0, len(core.server.items) - 1)
    runner = core.runner
    return {
        "seq": runner.index, "total": total, "mission_state": runner.state if total else NO_MISSION,
        "mission_mode": int(core.mode.does is Does.AUTO),
    }  # fmt: skip


def change_mode(core: Core, number: int) -> bool:
    """Whether the mode was entered; says why not."""
    mode = core.stack.modes.get(number)
    if mode is None:
        core.text(4, f"No such mode {number}")
        return False
    if mode.needs_position and not core.ready:
        core.text(4, f"Mode change to {mode.name} failed: requires position")
        return False
    if mode.does is Does.AUTO:
        items = core.server.items
        if len(items) <= 1:
            core.text(4, f"Mode change to {mode.name} failed: no mission")
            return False
        if core.is_copter and core.is_armed and core.landed and items[1].command != TAKEOFF:
            core.text(4, "Auto: Missing Takeoff Cmd")
            return False
    core.enter(mode)
    return True


def _to_mode(name: str) -> Handler:
    def handler(core: Core, order: Order) -> Result:
        mode = next((mode for mode in core.stack.modes.values() if mode.name == name), None)
        if mode is None:
            return Result.UNSUPPORTED
        return Result.ACCEPTED if change_mode(core, mode.number) else Result.FAILED

    return handler


def _set_mode(core: Core, order: Order) -> Result:
    flags, number = order.params[0], order.params[1]
    if not (math.isfinite(flags) and math.isfinite(number)) or not int(flags) & 1:
        return Result.DENIED
    return Result.ACCEPTED if change_mode(core, int(number)) else Result.FAILED


def _arm(core: Core, order: Order) -> Result:
    wanted, force = order.params[0], order.params[1] == FORCE
    if wanted == 0:
        if core.is_copter and not core.landed and not force:
            return Result.FAILED
        core.disarm()
        return Result.ACCEPTED
    if wanted != 1:
        return Result.UNSUPPORTED
    if core.is_armed:
        return Result.ACCEPTED
    if not core.ready and (core.is_copter or core.mode.needs_position):
        core.text(2, "Arm: Need Position Estimate")
        return Result.FAILED
    if not core.mode.armable:
        core.text(2, f"Arm: {core.mode.name} mode not armable")
        return Result.FAILED
    core.arm()
    return Result.ACCEPTED


def _take_off(core: Core, order: Order) -> Result:
    if not core.is_copter:
        return Result.UNSUPPORTED
    if not core.is_armed or not core.landed or core.mode.does is not Does.GUIDED or not 0 < order.z < 1000:
        return Result.FAILED
    core.lift = True
    core.go(Goal(core.body.east_m, core.body.north_m, core.up_of(order.z, amsl=False)))
    return Result.ACCEPTED


def _up_in_frame(core: Core, frame: int, z: float) -> float:
    if not core.is_copter:
        return 0.0
    if frame in TERRAIN_FRAMES:
        return -1.0  # without terrain data it flies into the ground, as measured
    return core.up_of(z, frame in AMSL_FRAMES)


def reposition(fence_refuses: Callable[[Goal], bool]) -> Handler:
    """MAV_CMD_DO_REPOSITION, as COMMAND_INT only."""

    def handler(core: Core, order: Order) -> Result:
        if order.frame is None:
            return Result.UNSUPPORTED
        if order.frame not in TARGET_FRAMES:
            core.text(6, f"Unknown mavlink coordinate frame {order.frame}")
            return Result.DENIED
        change = math.isfinite(order.params[1]) and bool(int(order.params[1]) & 1)
        valid = abs(order.lat_deg) <= 90 and abs(order.lon_deg) <= 180 and math.isfinite(order.z)
        if not valid or (core.mode.does is not Does.GUIDED and not change):
            return Result.DENIED
        goal = core.place(order.lat_deg, order.lon_deg, _up_in_frame(core, order.frame, order.z))
        if fence_refuses(goal):
            return Result.FAILED
        if core.mode.does is not Does.GUIDED and not change_mode(core, _guided(core).number):
            return Result.FAILED
        core.go(goal)
        return Result.ACCEPTED

    return handler


def _guided(core: Core) -> Mode:
    return by_name(core.stack.modes, "GUIDED")


def position_target(core: Core, message: Message, fence_refuses: Callable[[Goal], bool]) -> None:
    """SET_POSITION_TARGET_GLOBAL_INT: never acknowledged; what it cannot use stops the vehicle."""
    if core.mode.does is not Does.GUIDED or not core.is_armed:
        return
    mask = message.type_mask
    position_bits = _POSITION_BITS if core.is_copter else _ROVER_POSITION_BITS
    position, velocity = not mask & position_bits, not mask & _VELOCITY_BITS
    forced = mask & _FORCE_BIT and not mask & _ACCELERATION_BITS
    if message.coordinate_frame not in TARGET_FRAMES or forced:
        core.go(core.stopping_place() if core.is_copter else None)
    elif position and abs(message.lat_int) <= 900_000_000 and abs(message.lon_int) <= 1_800_000_000:
        alt = message.alt if math.isfinite(message.alt) else 0.0
        up = _up_in_frame(core, message.coordinate_frame, alt)
        goal = core.place(message.lat_int / 1e7, message.lon_int / 1e7, up)
        if not fence_refuses(goal):
            core.go(goal)
    elif velocity and not position and all(map(math.isfinite, (message.vx, message.vy, message.vz))):
        core.go(Velocity(message.vy, message.vx, -message.vz))
    else:
        core.go(core.stopping_place() if core.is_copter else None)


def _choose_item(core: Core, order: Order) -> Result:
    runner, number, reset = core.runner, order.params[0], order.params[1]
    if not isinstance(runner, ArduRunner) or not 0 <= number < 65535:
        return Result.DENIED
    return Result.ACCEPTED if runner.choose(int(number), reset=reset == 1) else Result.DENIED


def _start_mission(core: Core, order: Order) -> Result:
    if order.params[0] != 0 or order.params[1] != 0:
        return Result.DENIED
    already = core.mode.does is Does.AUTO
    if (core.is_copter and not core.is_armed) or not change_mode(core, by_name(core.stack.modes, "AUTO").number):
        return Result.FAILED
    if core.is_copter and isinstance(core.runner, ArduRunner):
        core.lift = core.lift or core.landed
        if already:
            core.runner.start_again()
    return Result.ACCEPTED  # a rover that is in AUTO already does nothing, as measured


class ArduPilot:
    """The ArduPilot stack for one copter or rover."""

    bytewise_parameters = False
    rules = RULES
    autopilot_id = 3
    announces_mode = True
    hides_parameter_index = True
    # MISSION_FLOAT, PARAM_FLOAT, MISSION_INT, COMMAND_INT, SET_POSITION_TARGET_GLOBAL_INT, MAVLINK2
    capabilities = 1 | 2 | 4 | 8 | 256 | 8192
    version = 0x040602FF  # 4.6.2, official

    def __init__(self, is_copter: bool) -> None:
        self.modes = ARDUCOPTER if is_copter else ARDUROVER
        self.parameters = COPTER_PARAMETERS if is_copter else ROVER_PARAMETERS
        self.streams = {
            **COMMON_STREAMS,
            42: Stream("MISSION_CURRENT", mission_current, 1.0),
            193: Stream("EKF_STATUS_REPORT", ekf_status_report, 0.0),
        }
        self.commands: dict[int, Handler] = {
            **COMMON,
            17: _to_mode("LOITER"),
            20: _to_mode("RTL"),
            21: _to_mode("LAND"),
            22: _take_off,
            176: _set_mode,
            224: _choose_item,
            300: _start_mission,
            400: _arm,
        }

    def start(self, core: Core) -> RunnerLike:
        """Power-on."""
        core.params.put("SYSID_THISMAV", core.config.sysid)
        speed = "WPNAV_SPEED" if core.is_copter else "WP_SPEED"
        core.params.put(speed, core.config.speed_m_s * (100 if core.is_copter else 1))
        self.fence = Fence(core)
        self.commands[192] = reposition(self.fence.refuses)
        return ArduRunner(core)

    def booted(self, core: Core) -> None:
        """Power is on."""
        core.text(6, "ArduPilot Ready")

    def home_found(self, core: Core) -> None:
        """The GPS gave a home."""
        core.emit("HOME_POSITION", **(home_position(core) or {}))
        core.text(6, "EKF3 IMU0 origin set")

    def became_ready(self, core: Core) -> None:
        """The EKF uses the GPS."""
        core.text(6, "EKF3 IMU0 is using GPS")
        core.text(6, "AHRS: EKF3 active")

    def step(self, core: Core) -> None:
        """No timers of its own."""

    def receive(self, core: Core, message: Message) -> None:
        """SET_MODE, position targets and the EKF origin."""
        name = message.get_type()
        if name == "SET_POSITION_TARGET_GLOBAL_INT":
            position_target(core, message, self.fence.refuses)
        elif name == "SET_MODE":
            changed = message.base_mode & 1 and change_mode(core, message.custom_mode)
            core.emit("COMMAND_ACK", command=11, result=int(Result.ACCEPTED if changed else Result.FAILED))
        elif name == "SET_GPS_GLOBAL_ORIGIN":  # it has one from its GPS; the answer is that one
            origin = gps_global_origin(core)
            if origin is not None:
                core.emit("GPS_GLOBAL_ORIGIN", **origin)

    def parameter_changed(self, core: Core, name: str) -> None:
        """Take a new parameter into use."""
        if name.startswith("FENCE_"):
            self.fence.refresh()
        elif name == "WPNAV_SPEED":
            use_speed_parameter(core, name, per_m_s=100)
        elif name == "WP_SPEED":
            use_speed_parameter(core, name, per_m_s=1)

    def entered(self, core: Core, before: Mode) -> None:
        """Nothing is said but the heartbeat."""

    def armed(self, core: Core) -> None:
        """A copter sets home where it is armed."""
        core.text(6, "Arming motors" if core.is_copter else "Throttle armed")
        if core.is_copter:
            core.set_home(replace(core.home, east_m=core.body.east_m, north_m=core.body.north_m))
            core.emit("HOME_POSITION", **(home_position(core) or {}))

    def disarmed(self, core: Core) -> None:
        """A copter's mission goes back to its start."""
        core.text(6, "Disarming motors" if core.is_copter else "Throttle disarmed")
        if core.is_copter:
            core.runner.index = 0

    def lifted(self, core: Core) -> None:
        """Nothing is said."""

    def touched(self, core: Core) -> None:
        """Nothing is said."""

    def idle_s(self, core: Core) -> float:
        """Landing disarms soon, standing about after DISARM_DELAY."""
        coming_down = core.mode.does in (Does.LAND, Does.RETURN) or core.phase is Phase.DESCEND
        delay_s = core.params["DISARM_DELAY"]
        return 1.0 if core.has_flown and coming_down else (delay_s + 1.0 if delay_s > 0 else math.inf)

    def return_altitude_m(self, core: Core) -> float:
        """RTL_ALT is in centimetres."""
        return core.params["RTL_ALT"] / 100

    def may_clear(self, core: Core) -> bool:
        """Not while armed and the mission runs."""
        return not (core.is_armed and core.runner.state == ACTIVE and core.mode.does is Does.AUTO)

    def status(self, core: Core) -> int:
        """HEARTBEAT.system_status: 5 in a failsafe; a rover in HOLD says 3."""
        if core.critical:
            return 5
        if core.is_copter:
            return 3 if core.landed else 4
        return 3 if core.mode.name == "HOLD" else 4
