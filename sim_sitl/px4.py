"""The PX4 dialect: multicopter and rover."""

from __future__ import annotations

import math

from gatar_edge.sim_sitl.contracts import RunnerLike
from gatar_edge.sim_sitl.core import Core
from gatar_edge.sim_sitl.failsafe import use_speed_parameter
from gatar_edge.sim_sitl.modes import PX4 as MODES
from gatar_edge.sim_sitl.modes import Does, Mode, by_name
from gatar_edge.sim_sitl.parameters import PX4 as PARAMETERS
from gatar_edge.sim_sitl.px4_commands import Offboard, change_mode, commands
from gatar_edge.sim_sitl.px4_mission import RULES, Px4Runner, mission_current
from gatar_edge.sim_sitl.streams import COMMON as COMMON_STREAMS
from gatar_edge.sim_sitl.streams import Stream, extended_sys_state, home_position, take_origin
from gatar_edge.sim_sitl.vehicle import Goal
from gatar_edge.sim_sitl.wire import Message

_THERE_M = 0.3


class Px4:
    """The PX4 stack for one multicopter or rover."""

    modes = MODES
    parameters = PARAMETERS
    bytewise_parameters = True
    rules = RULES
    autopilot_id = 12
    announces_mode = False
    hides_parameter_index = False
    # MISSION_FLOAT, MISSION_INT, COMMAND_INT, PARAM_ENCODE_BYTEWISE, SET_POSITION_TARGET_GLOBAL_INT, MAVLINK2
    capabilities = 1 | 4 | 8 | 16 | 256 | 8192
    version = 0x011000FF  # 1.16.0, release

    def __init__(self) -> None:
        self.offboard = Offboard()
        self.commands = commands(self.offboard)
        self.streams = {
            **COMMON_STREAMS,
            42: Stream("MISSION_CURRENT", mission_current, 1.0, fixed=True),
            242: Stream("HOME_POSITION", home_position, 0.5),
            245: Stream("EXTENDED_SYS_STATE", extended_sys_state, 1.0),
        }

    def start(self, core: Core) -> RunnerLike:
        """Power-on, in AUTO.LOITER."""
        core.params.put("MAV_SYS_ID", core.config.sysid)
        core.params.put("MPC_XY_CRUISE", core.config.speed_m_s)
        core.mode = by_name(MODES, "AUTO.LOITER")
        return Px4Runner(core)

    def booted(self, core: Core) -> None:
        """Nothing is said."""

    def home_found(self, core: Core) -> None:
        """Nothing is said: home is streamed."""

    def became_ready(self, core: Core) -> None:
        """Nothing is said."""

    def step(self, core: Core) -> None:
        """Announcements, the end of a takeoff, the loss of the target stream."""
        runner, nav = core.runner, core.nav
        if isinstance(runner, Px4Runner):
            runner.timers()
        taken_off = core.mode.does is Does.TAKEOFF and not core.landed and isinstance(nav, Goal)
        if taken_off and isinstance(nav, Goal) and abs(nav.up_m - core.body.up_m) < _THERE_M:
            core.enter(by_name(MODES, "AUTO.LOITER"))
        self.offboard.step(core)

    def receive(self, core: Core, message: Message) -> None:
        """SET_MODE (without an answer) and position targets."""
        name = message.get_type()
        if name == "SET_POSITION_TARGET_GLOBAL_INT":
            self.offboard.receive(core, message)
        elif name == "SET_GPS_GLOBAL_ORIGIN":
            take_origin(core, message)
        elif name == "SET_MODE":
            mode = MODES.get(message.custom_mode)
            if mode is not None:
                change_mode(core, self.offboard, mode)

    def parameter_changed(self, core: Core, name: str) -> None:
        """Take a new parameter into use."""
        if name == "MPC_XY_CRUISE":
            use_speed_parameter(core, name, per_m_s=1)

    def entered(self, core: Core, before: Mode) -> None:
        """AUTO.TAKEOFF climbs to its default altitude unless told otherwise."""
        if core.mode.does is Does.TAKEOFF:
            place = core.stopping_place()
            up = core.up_of(core.params["MIS_TAKEOFF_ALT"], amsl=False)
            core.nav = Goal(place.east_m, place.north_m, max(up, place.up_m))
            core.lift = core.landed

    def armed(self, core: Core) -> None:
        """Home is where it is armed."""
        core.set_home(Goal(core.body.east_m, core.body.north_m, core.body.up_m))
        core.text(6, "Armed by external command")

    def disarmed(self, core: Core) -> None:
        """Say so."""
        core.text(6, "Disarmed by landing" if core.has_flown else "Disarmed by external command")

    def lifted(self, core: Core) -> None:
        """Say so."""
        core.text(6, "Takeoff detected")

    def touched(self, core: Core) -> None:
        """Say so."""
        core.text(6, "Landing detected")

    def idle_s(self, core: Core) -> float:
        """After a landing, or without a takeoff."""
        delay_s = core.params["COM_DISARM_LAND" if core.has_flown else "COM_DISARM_PRFLT"]
        return delay_s if delay_s > 0 else math.inf

    def return_altitude_m(self, core: Core) -> float:
        """RTL_RETURN_ALT is in metres."""
        return core.params["RTL_RETURN_ALT"]

    def may_clear(self, core: Core) -> bool:
        """Always, also in flight."""
        return True

    def status(self, core: Core) -> int:
        """HEARTBEAT.system_status."""
        if not core.ready:
            return 0
        if core.critical:
            return 5
        return 4 if core.is_armed else 3
