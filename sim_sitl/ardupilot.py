"""The ArduPilot dialect: ArduCopter and ArduRover 4.6."""

from __future__ import annotations

import math
from dataclasses import replace

from gatar_edge.sim_sitl.ardupilot_commands import COMMANDS, change_mode, position_target, reposition
from gatar_edge.sim_sitl.ardupilot_mission import RULES, ArduRunner, mission_current
from gatar_edge.sim_sitl.contracts import RunnerLike
from gatar_edge.sim_sitl.core import Core, Phase
from gatar_edge.sim_sitl.failsafe import Fence, use_speed_parameter
from gatar_edge.sim_sitl.mission_runner import ACTIVE
from gatar_edge.sim_sitl.modes import ARDUCOPTER, ARDUROVER, Does, Mode
from gatar_edge.sim_sitl.orders import Result
from gatar_edge.sim_sitl.parameters import ARDUCOPTER as COPTER_PARAMETERS
from gatar_edge.sim_sitl.parameters import ARDUROVER as ROVER_PARAMETERS
from gatar_edge.sim_sitl.streams import COMMON as COMMON_STREAMS
from gatar_edge.sim_sitl.streams import Stream, ekf_status_report, home_position, take_origin
from gatar_edge.sim_sitl.vehicle import Goal
from gatar_edge.sim_sitl.wire import Message


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
        self._reported: Goal | None = None
        self.streams = {
            **COMMON_STREAMS,
            42: Stream("MISSION_CURRENT", mission_current, 1.0),
            193: Stream("EKF_STATUS_REPORT", ekf_status_report, 0.0),
        }
        self.commands = dict(COMMANDS)

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
        """A rover in GUIDED reports item 0 when it has reached its target."""
        nav = core.nav
        if core.is_copter or core.mode.does is not Does.GUIDED or nav is self._reported or not isinstance(nav, Goal):
            return
        if nav.distance_m(core.body) < core.params["WP_RADIUS"]:
            self._reported = nav
            core.emit("MISSION_ITEM_REACHED", seq=0)

    def receive(self, core: Core, message: Message) -> None:
        """SET_MODE, position targets and the EKF origin."""
        name = message.get_type()
        if name == "SET_POSITION_TARGET_GLOBAL_INT":
            position_target(core, message, self.fence.refuses)
        elif name == "SET_MODE":
            changed = message.base_mode & 1 and change_mode(core, message.custom_mode)
            core.emit("COMMAND_ACK", command=11, result=int(Result.ACCEPTED if changed else Result.FAILED))
        elif name == "SET_GPS_GLOBAL_ORIGIN":
            take_origin(core, message)

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
