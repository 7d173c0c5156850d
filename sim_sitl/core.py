"""What a simulated autopilot knows and does, whatever its dialect: state, modes, arming, motion."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from dataclasses import replace
from enum import Enum
from typing import Any

from msgspec import structs

from gatar_edge.sim_sitl.autopilot_config import AutopilotConfig, Truth
from gatar_edge.sim_sitl.contracts import CoreStack
from gatar_edge.sim_sitl.geodesy import LocalFrame
from gatar_edge.sim_sitl.mission_items import Item
from gatar_edge.sim_sitl.mission_server import MissionServer
from gatar_edge.sim_sitl.modes import Does, Mode
from gatar_edge.sim_sitl.parameters import ParameterStore
from gatar_edge.sim_sitl.positioning import WORKING
from gatar_edge.sim_sitl.vehicle import Blocked, Body, Goal, Limits, Target, Velocity, step_copter, step_rover
from gatar_edge.sim_sitl.wire import Send
from gatar_edge.types import NS_PER_S

_LIFTED_M = 0.3
_FLOATING_M = 0.02
_FAR_M = 10_000.0
_HIGH_M = 20_000.0
_OUTBOX_MAX = 4096


class Phase(Enum):
    """Of returning and landing."""

    NONE = "none"
    CLIMB = "climb"
    HOME = "home"
    DESCEND = "descend"


class Core:
    """The state of one vehicle and what any stack does with it."""

    def __init__(self, config: AutopilotConfig, stack: CoreStack, now_ns: int, blocked: Blocked | None) -> None:
        self.config, self.stack = config, stack
        self.boot_ns = self.now_ns = now_ns
        self.rng = random.Random(config.seed * 1009 + config.sysid)
        self.frame = LocalFrame(config.home_lat_deg, config.home_lon_deg)
        self.is_copter = config.vehicle == "copter"
        self.limits = Limits(
            config.speed_m_s, config.acceleration_m_s2, config.climb_m_s,
            turn_rad_s=math.radians(config.turn_deg_s), endurance_s=config.endurance_s,
        )  # fmt: skip
        self.cruise = self.limits
        self.body = Body(heading_rad=math.radians(config.heading_deg), charge=config.battery_percent / 100)
        self.gps = WORKING
        self.params = ParameterStore(stack.parameters, stack.bytewise_parameters)
        self.home = Goal(0.0, 0.0, 0.0)
        self.home_set = self.ready = False
        self.given_origin: tuple[int, int, int] | None = None  # lat, lon in 1e-7 degrees, mm: told before the GPS told
        self.user_blocked: Blocked = blocked or (lambda east_m, north_m: False)
        self.fence_blocks: Blocked | None = None
        self.fence_action: Callable[[Core], None] | None = None
        self.mode = next(iter(stack.modes.values()))
        self.is_armed = False
        self.landed = self.is_copter
        self.lift = False  # a copter on the ground may take off
        self.has_flown = False  # since it was armed
        self.idle_since_ns = now_ns
        self.nav: Target = None
        self.velocity_until_ns = 0
        self.phase = Phase.NONE
        self.critical = False  # a failsafe acts
        self.outbox: list[Send] = []
        self.server = MissionServer(stack.rules, self, self.rng)
        self.runner = stack.start(self)

    # What it says

    def emit(self, name: str, **fields: Any) -> None:
        """Queue a message."""
        self.queue(Send(name, fields))

    def queue(self, send: Send) -> None:
        """Queue a message; the oldest are lost when nobody takes them."""
        if len(self.outbox) >= _OUTBOX_MAX:
            del self.outbox[: _OUTBOX_MAX // 2]
        self.outbox.append(send)

    def text(self, severity: int, text: str) -> None:
        """Send a STATUSTEXT of at most 50 characters."""
        self.emit("STATUSTEXT", severity=severity, text=text.encode("ascii", "replace")[:50])

    @property
    def uptime_ms(self) -> int:
        """Since power-on, as MAVLink wants it."""
        return int((self.now_ns - self.boot_ns) // 1_000_000) & 0xFFFFFFFF

    @property
    def truth(self) -> Truth:
        """The state of the vehicle in the simulated world."""
        body = self.body
        east_m, north_m = self.gps.really(body.east_m, body.north_m)
        lat, lon = self.frame.geodetic(east_m, north_m)
        return Truth(
            lat, lon, body.up_m - self.home.up_m, east_m, north_m, body.speed_m_s,
            math.degrees(body.heading_rad) % 360.0, self.is_armed, self.mode.name, self.landed,
            body.charge * 100, self.runner.index, self.runner.state,
        )  # fmt: skip

    # Altitudes: `up` is metres above the ground at the start, which lies at config.home_alt_m

    def up_of(self, alt_m: float, amsl: bool) -> float:
        """Altitude above the sea or above home, as metres up; what is absurd is cut to twenty kilometres."""
        up_m = alt_m - self.config.home_alt_m if amsl else alt_m + self.home.up_m
        return max(-_HIGH_M, min(_HIGH_M, up_m))

    def amsl_of(self, up_m: float) -> float:
        """Metres up as altitude above the sea."""
        return up_m + self.config.home_alt_m

    def place(self, lat_deg: float, lon_deg: float, up_m: float) -> Goal:
        """A goal at a position; what lies absurdly far away is cut to ten kilometres in that direction."""
        east, north = self.frame.local(lat_deg, lon_deg)
        if not (math.isfinite(east) and math.isfinite(north)):
            return self.stopping_place()
        shrink = max(1.0, math.hypot(east, north) / _FAR_M)
        return Goal(east / shrink, north / shrink, up_m)

    def stopping_place(self) -> Goal:
        """Where it comes to rest when it brakes now."""
        body = self.body
        reach = body.speed_m_s / (2 * self.limits.acceleration_m_s2)
        return Goal(body.east_m + body.east_m_s * reach, body.north_m + body.north_m_s * reach, body.up_m)

    # What it does

    def enter(self, mode: Mode) -> None:
        """Change the mode; the same mode again changes nothing."""
        before = self.mode
        if mode == before:
            return
        if before.does is Does.AUTO:
            self.runner.leave()
        self.mode, self.phase = mode, Phase.NONE
        self.nav = self.stopping_place() if self.is_copter else None
        if mode.does is Does.AUTO:
            self.runner.enter()
        elif mode.does is Does.RETURN:
            self.begin_return()
        elif mode.does is Does.LAND:
            self.phase = Phase.DESCEND
        self.stack.entered(self, before)

    def arm(self) -> None:
        """Start the motors; whether that is allowed was asked before."""
        if self.is_armed:
            return
        self.is_armed, self.has_flown, self.lift = True, False, False
        self.idle_since_ns = self.now_ns
        self.stack.armed(self)

    def disarm(self) -> None:
        """Stop the motors: a rover stops, a copter falls."""
        if not self.is_armed:
            return
        self.is_armed, self.lift, self.nav, self.phase = False, False, None, Phase.NONE
        self.body = structs.replace(self.body, up_m=0.0, east_m_s=0.0, north_m_s=0.0, up_m_s=0.0)
        self.landed = self.is_copter
        self.stack.disarmed(self)

    def go(self, target: Target) -> None:
        """Take a new target; a velocity holds for three seconds."""
        self.nav, self.phase = target, Phase.NONE
        if isinstance(target, Velocity):
            self.velocity_until_ns = self.now_ns + 3 * NS_PER_S

    def begin_return(self) -> None:
        """Start the way home; a copter climbs first."""
        self.phase = Phase.CLIMB if self.is_copter else Phase.HOME

    def set_home(self, goal: Goal) -> None:
        """Move home: all relative altitudes move with it, the origin of the local frame does not."""
        self.home, self.home_set = goal, True

    def discharge(self, charge: float) -> None:
        """The battery drops to `charge` (0 to 1); one that is lower already stays so."""
        self.body = structs.replace(self.body, charge=min(self.body.charge, charge))

    def mislead(self, east_m: float, north_m: float) -> None:
        """From now on the vehicle believes to be so much further east and north than before."""
        gps, body = self.gps, self.body
        self.gps = replace(gps, east_m=gps.east_m + east_m, north_m=gps.north_m + north_m)
        self.body = structs.replace(body, east_m=body.east_m + east_m, north_m=body.north_m + north_m)

    # Motion

    def move(self, now_ns: int, dt_s: float) -> None:
        """One step of the world."""
        self.now_ns = now_ns
        if not self.is_armed:
            return
        if isinstance(self.nav, Velocity) and now_ns >= self.velocity_until_ns:
            self.nav = self.stopping_place() if self.is_copter else None
        if self.phase is not Phase.NONE:
            self._follow_phase()
        if self.is_copter:
            self._move_copter(dt_s)
        else:
            self.body = step_rover(self.body, self.limits, self.nav, dt_s, self._is_blocked)
        if self.fence_action is not None:
            self.fence_action(self)
        if self.mode.does is Does.AUTO:
            self.runner.step()

    def _is_blocked(self, east_m: float, north_m: float) -> bool:
        fence = self.fence_blocks
        return self.user_blocked(*self.gps.really(east_m, north_m)) or (fence is not None and fence(east_m, north_m))

    def _move_copter(self, dt_s: float) -> None:
        if self.landed and not self.lift:
            if self.now_ns - self.idle_since_ns >= self.stack.idle_s(self) * NS_PER_S:
                self.disarm()
            return
        self.body = step_copter(self.body, self.limits, self.nav, dt_s)
        if self.landed and self.body.up_m > _LIFTED_M:
            self.landed, self.lift, self.has_flown = False, False, True
            self.stack.lifted(self)
        elif not self.landed and self.body.up_m <= _FLOATING_M and self.body.up_m_s <= 0.0:
            self.landed, self.idle_since_ns = True, self.now_ns
            self.body = structs.replace(self.body, east_m_s=0.0, north_m_s=0.0, up_m_s=0.0)
            self.stack.touched(self)

    def _follow_phase(self) -> None:
        body, home = self.body, self.home
        if self.phase is Phase.CLIMB:
            up = max(body.up_m, self.up_of(self.stack.return_altitude_m(self), amsl=False))
            if up - body.up_m < 0.5:
                self.phase = Phase.HOME
            goal = self.nav if isinstance(self.nav, Goal) else self.stopping_place()
            self.nav = replace(goal, up_m=up)
        elif self.phase is Phase.HOME:
            up = self.nav.up_m if isinstance(self.nav, Goal) else body.up_m
            self.nav = Goal(home.east_m, home.north_m, up)
            if home.distance_m(body) < 0.5 and body.speed_m_s < 0.5:
                self.phase = Phase.DESCEND if self.is_copter else Phase.NONE
        elif self.phase is Phase.DESCEND:
            goal = self.nav if isinstance(self.nav, Goal) else self.stopping_place()
            self.nav = replace(goal, up_m=-1.0)  # below the ground: it comes to rest on it

    # What the mission server asks of its vehicle

    def home_item(self) -> Item:
        """Slot 0 of an ArduPilot mission: home, whatever was uploaded there."""
        lat, lon = self.frame.geodetic(self.home.east_m, self.home.north_m)
        amsl = self.amsl_of(self.home.up_m)
        return Item(0, 16, (0.0, 0.0, 0.0, 0.0), round(lat * 1e7), round(lon * 1e7), amsl)

    def mission_changed(self, seq: int | None) -> None:
        """See RunnerLike.changed."""
        self.runner.changed(seq)

    def mission_received(self) -> None:
        """See RunnerLike.received."""
        self.runner.received()

    def may_clear(self) -> bool:
        """See CoreStack.may_clear."""
        return self.stack.may_clear(self)

    def set_current(self, seq: int) -> None:
        """See RunnerLike.set_current."""
        self.runner.set_current(seq)
