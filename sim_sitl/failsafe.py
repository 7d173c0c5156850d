"""What a vehicle does by itself: the ground-station failsafe and the fence, as measured on each stack."""

from __future__ import annotations

import math
from dataclasses import replace

from gatar_edge.sim_sitl.core import Core
from gatar_edge.sim_sitl.modes import Does, by_name
from gatar_edge.sim_sitl.vehicle import Goal
from gatar_edge.types import NS_PER_S

_CIRCLE, _ALT_MAX = 2, 1  # bits of FENCE_TYPE
_ROVER_STOPS_BEFORE_M = 1.0  # besides the margin: at 47 m of 50, as measured
_COPTER_ACTION = {1: "RTL", 2: "RTL", 3: "RTL", 4: "RTL", 5: "LAND", 6: "RTL", 7: "BRAKE"}  # by FS_GCS_ENABLE
_ROVER_ACTION = {1: "RTL", 2: "HOLD", 3: "RTL", 4: "HOLD"}  # by FS_ACTION
_CONTINUE_IN_AUTO = 2  # bit of FS_OPTIONS
_PX4_NOTICES_AFTER_S = 2.3  # measured: 7.3 s with COM_DL_LOSS_T = 5
_GCS_TYPE = 6


class GroundStationWatch:
    """Counts the heartbeats that this stack counts; inactive until one has been seen."""

    def __init__(self, core: Core) -> None:
        self._core = core
        self._seen_ns: int | None = None
        self._lost = False
        self._act_ns: int | None = None  # when PX4 goes from Hold to its action

    def heartbeat(self, sysid: int, mav_type: int) -> None:
        """A HEARTBEAT arrived."""
        core = self._core
        ardupilot = core.config.stack == "ardupilot"
        if sysid != core.params["SYSID_MYGCS"] if ardupilot else mav_type != _GCS_TYPE:
            return
        self._seen_ns = core.now_ns
        if not self._lost:
            return
        self._lost, self._act_ns = False, None
        if ardupilot:
            core.critical = False
            core.text(4 if core.is_copter else 6, "GCS Failsafe Cleared")
        else:
            core.text(6, "GCS connection regained")

    def step(self) -> None:
        """Look whether the ground station is gone."""
        core = self._core
        if self._seen_ns is None or (not self._lost and core.now_ns - self._seen_ns < NS_PER_S):
            return
        silence_s = (core.now_ns - self._seen_ns) / NS_PER_S
        if core.config.stack == "ardupilot":
            self._step_ardupilot(silence_s)
        else:
            self._step_px4(silence_s)

    def _step_ardupilot(self, silence_s: float) -> None:
        core = self._core
        limit_s = core.params["FS_GCS_TIMEOUT"] + (0.0 if core.is_copter else core.params["FS_TIMEOUT"])
        if self._lost or not core.is_armed or core.params["FS_GCS_ENABLE"] == 0 or silence_s < limit_s:
            return
        self._lost = core.critical = True
        if core.is_copter:
            self._copter_acts()
        else:
            self._rover_acts()

    def _copter_acts(self) -> None:
        core = self._core
        if core.mode.does is Does.AUTO and int(core.params["FS_OPTIONS"]) & _CONTINUE_IN_AUTO:
            core.text(4, "GCS Failsafe - Continuing Auto Mode")
            return
        core.text(4, "GCS Failsafe")
        if core.landed:
            core.disarm()
        elif core.mode.does is not Does.LAND:
            name = _COPTER_ACTION.get(int(core.params["FS_GCS_ENABLE"]), "RTL")
            core.enter(by_name(core.stack.modes, name))

    def _rover_acts(self) -> None:
        core = self._core
        radio = core.params["FS_THR_ENABLE"]
        core.text(4, "Radio Failsafe" if radio else "GCS Failsafe")
        if core.mode.does is Does.AUTO and core.params["FS_GCS_ENABLE"] == 2 and radio != 1:
            core.text(4, "Failsafe - Continuing Auto Mode")
            return
        name = _ROVER_ACTION.get(int(core.params["FS_ACTION"]))
        if name is not None:
            core.enter(by_name(core.stack.modes, name))

    def _step_px4(self, silence_s: float) -> None:
        core, params = self._core, self._core.params
        action = int(params["NAV_DLL_ACT"])
        if self._lost:
            if self._act_ns is not None and core.now_ns >= self._act_ns:
                self._act_ns = None
                core.enter(by_name(core.stack.modes, "AUTO.LAND" if action == 3 else "AUTO.RTL"))
            return
        excepted = core.mode.does is Does.AUTO and int(params["COM_DLL_EXCEPT"]) & 1
        if not core.is_armed or action == 0 or excepted or silence_s < params["COM_DL_LOSS_T"] + _PX4_NOTICES_AFTER_S:
            return
        self._lost = core.critical = True
        if action > 1:
            self._act_ns = core.now_ns + int(params["COM_FAIL_ACT_T"] * NS_PER_S)
        core.enter(by_name(core.stack.modes, "AUTO.LOITER"))


class Fence:
    """ArduPilot's circle and ceiling round home: a copter outside returns, a rover stops before it in silence."""

    def __init__(self, core: Core) -> None:
        self._core = core
        self.breaches = 0
        self._breached = False
        self.refresh()

    def refresh(self) -> None:
        """Take over the FENCE_ parameters."""
        core = self._core
        self._types = int(core.params["FENCE_TYPE"]) if core.params["FENCE_ENABLE"] else 0
        self._radius_m = core.params["FENCE_RADIUS"]
        self._stop_m = self._radius_m - core.params["FENCE_MARGIN"] - _ROVER_STOPS_BEFORE_M
        circle = bool(self._types & _CIRCLE)
        core.fence_blocks = self._beyond_stop if circle and not core.is_copter else None
        core.fence_action = self._watch if self._types and core.is_copter else None

    def refuses(self, goal: Goal) -> bool:
        """Whether a copter refuses to fly there."""
        return self._core.is_copter and self._outside(goal.east_m, goal.north_m, goal.up_m)

    def _outside(self, east_m: float, north_m: float, up_m: float) -> bool:
        home = self._core.home
        far = math.hypot(east_m - home.east_m, north_m - home.north_m) > self._radius_m
        high = up_m - home.up_m > self._core.params["FENCE_ALT_MAX"]
        return bool(self._types & _CIRCLE and far) or bool(self._types & _ALT_MAX and high)

    def _beyond_stop(self, east_m: float, north_m: float) -> bool:
        home = self._core.home
        return math.hypot(east_m - home.east_m, north_m - home.north_m) > self._stop_m

    def _watch(self, core: Core) -> None:
        body = core.body
        outside = self._outside(body.east_m, body.north_m, body.up_m)
        if outside == self._breached:
            return
        self._breached = outside
        if not outside:
            core.text(5, "Fence breach cleared")
            return
        self.breaches += 1
        circle = self._types & _CIRCLE and self._outside(body.east_m, body.north_m, core.home.up_m)
        core.text(5, "Circle fence breached" if circle else "Max Alt fence breached")
        core.emit(
            "FENCE_STATUS",
            breach_status=1, breach_count=self.breaches, breach_type=3, breach_time=core.uptime_ms, breach_mitigation=1,
        )  # fmt: skip
        if core.params["FENCE_ACTION"] and not core.landed:
            core.enter(by_name(core.stack.modes, "RTL"))


def use_speed_parameter(core: Core, name: str, per_m_s: float) -> None:
    """Let a speed parameter set the speed over ground."""
    speed = core.params[name] / per_m_s
    if speed > 0:
        core.limits = replace(core.limits, speed_m_s=min(speed, 30.0))
