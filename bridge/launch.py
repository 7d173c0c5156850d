"""From a vehicle on the ground to one that obeys: mode, arming, take-off. Sans-IO; one table of transitions.

Arming FAILs until the filters are ready (42-45 s after boot on ArduPilot): it is asked for again each second for as
long as it takes. A ground vehicle is armed in the mode in which it stands and then put on hold; its mission mode comes
with its first mission. A copter that is armed and airborne already, because the companion restarted, is not taken off
again.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum

from gatar_edge.bridge.commands import NEVER_NS, CommandClient
from gatar_edge.bridge.dialect import LANDED_ON_GROUND, Command
from gatar_edge.bridge.modes import ModeKeeper
from gatar_edge.bridge.profiles.base import Profile, Takeoff
from gatar_edge.bridge.telemetry import Telemetry
from gatar_edge.types import NS_PER_S

ARM_RETRY_NS = NS_PER_S
CLIMB_NS = 5 * NS_PER_S  # without 0.5 m of climb the take-off is asked for again
REACHED_M = 1.0  # this much below the altitude counts as there, half of a low one
AIRBORNE_M = 2.0


class Phase(Enum):
    """Where a vehicle is on its way to obeying."""

    SEARCHING = "searching"  # no heartbeat of an autopilot yet
    UNSUPPORTED = "unsupported"  # there is no profile for it
    WAITING = "waiting"  # for its position, home and origin
    MODE = "mode"
    ARMING = "arming"
    TAKEOFF = "takeoff"
    SETTLING = "settling"  # armed and airborne, not yet in the mode in which it waits for commands
    READY = "ready"
    PILOT = "pilot"  # somebody else took over

    __hash__ = object.__hash__  # looked up at each poll, and Enum's own is slow


class Event(Enum):
    """What happened."""

    FOUND = "an autopilot with a profile"
    REFUSED = "an autopilot without one"
    LOCATED = "position, home and origin are known"
    ARMABLE = "in a mode in which it can be armed"
    ARMED = "armed"
    DISARMED = "disarmed"
    AIRBORNE = "at its altitude, or it does not fly"
    DRIVING = "on our own mission already: the companion restarted"
    SETTLED = "in the mode in which it waits"
    TAKEN = "somebody else changed its mode or disarmed it, now or before a restart of ours"
    ENABLED = "told to command again"


_P, _E = Phase, Event
TRANSITIONS: dict[Phase, dict[Event, Phase]] = {
    _P.SEARCHING: {_E.FOUND: _P.WAITING, _E.REFUSED: _P.UNSUPPORTED},
    _P.UNSUPPORTED: {},
    _P.WAITING: {_E.LOCATED: _P.MODE, _E.TAKEN: _P.PILOT},
    _P.MODE: {_E.ARMABLE: _P.ARMING, _E.TAKEN: _P.PILOT},
    _P.ARMING: {_E.ARMED: _P.TAKEOFF, _E.TAKEN: _P.PILOT},
    _P.TAKEOFF: {
        _E.AIRBORNE: _P.SETTLING,
        _E.DRIVING: _P.READY,
        _E.DISARMED: _P.ARMING,
        _E.TAKEN: _P.PILOT,
    },
    _P.SETTLING: {_E.SETTLED: _P.READY, _E.DISARMED: _P.ARMING, _E.TAKEN: _P.PILOT},
    _P.READY: {_E.DISARMED: _P.PILOT, _E.TAKEN: _P.PILOT},
    _P.PILOT: {_E.ENABLED: _P.WAITING},
}


class Launch:
    """Brings one vehicle to READY and tells the phase."""

    def __init__(self, profile: Profile, commands: CommandClient, modes: ModeKeeper, altitude_m: float) -> None:
        self.profile, self.commands, self.modes = profile, commands, modes
        self.phase = Phase.WAITING
        self.driving = False  # set by the caller: it drives a mission of ours, and is not to be put on hold
        self._altitude_m = altitude_m
        self._there_m = altitude_m - min(REACHED_M, altitude_m / 2)
        self._watched: Phase | None = None  # at the last poll: a new phase is looked at without waiting
        self._asked_ns = -ARM_RETRY_NS
        self._climbed_m, self._climbed_ns = 0.0, 0

    def fire(self, event: Event, now_ns: int) -> None:
        """Take the row of TRANSITIONS for `event`, if there is one."""
        to = TRANSITIONS[self.phase].get(event)
        if to is None:
            return
        self.phase = to
        self._asked_ns = now_ns - ARM_RETRY_NS
        if to is Phase.TAKEOFF:
            self._climbed_m, self._climbed_ns = 0.0, now_ns - CLIMB_NS
        elif to is Phase.SETTLING:
            self.modes.want(self.profile.hold_mode)
        elif event is Event.DRIVING:
            self.modes.want(self.profile.mission_mode)  # ours: leaving it is somebody else's doing
        elif to in (Phase.PILOT, Phase.READY):
            self.modes.want(None)

    @property
    def due_ns(self) -> int:
        """When `poll` has something to do again, unless something arrives or is commanded first."""
        if self.phase is Phase.READY or self.phase is Phase.PILOT:
            return NEVER_NS
        if self.phase is not self._watched or self.phase is Phase.WAITING:
            return 0
        if self.phase is Phase.ARMING:
            return self._asked_ns + ARM_RETRY_NS
        return self._climbed_ns + CLIMB_NS if self.phase is Phase.TAKEOFF else NEVER_NS

    @property
    def watches(self) -> bool:
        """Whether the vehicle's position and its current item give `poll` something to do before `due_ns`."""
        return self.phase is Phase.TAKEOFF

    def poll(self, seen: Telemetry, now_ns: int) -> None:
        """Take the next step if the vehicle shows that the last one is done."""
        self._watched = self.phase
        watch = _WATCHERS.get(self.phase)
        if watch is not None:
            watch(self, seen, now_ns)

    def airborne(self, seen: Telemetry) -> bool:
        """Whether it is in the air, or need not be."""
        if self.profile.takeoff is Takeoff.NONE:
            return True
        return seen.landed_state != LANDED_ON_GROUND and seen.alt_rel_m >= min(AIRBORNE_M, self._there_m)

    def _wait(self, seen: Telemetry, now_ns: int) -> None:
        if seen.home is not None and seen.position is not None and seen.has_origin(now_ns):
            self.fire(Event.LOCATED, now_ns)

    def _set_mode(self, seen: Telemetry, now_ns: int) -> None:
        ours = (self.profile.guided_mode, self.profile.mission_mode, self.profile.hold_mode)
        if seen.custom_mode in self.profile.arm_modes or (seen.armed and seen.custom_mode in ours):
            if self.profile.takeoff is not Takeoff.NONE:  # who breaks off the take-off is to keep the vehicle
                self.modes.adopt(seen.custom_mode)
            self.fire(Event.ARMABLE, now_ns)
        else:
            self.modes.want(self.profile.guided_mode)

    def _arm(self, seen: Telemetry, now_ns: int) -> None:
        if seen.armed:
            self.commands.forget(Command.COMPONENT_ARM_DISARM)
            self.fire(Event.ARMED, now_ns)
        elif now_ns - self._asked_ns >= ARM_RETRY_NS:
            self._asked_ns = now_ns
            self.commands.long(Command.COMPONENT_ARM_DISARM, 1.0)

    def _take_off(self, seen: Telemetry, now_ns: int) -> None:
        if not seen.armed:
            self.fire(Event.DISARMED, now_ns)
        elif self.driving:
            self.fire(Event.DRIVING, now_ns)
        elif self.profile.takeoff is Takeoff.NONE or seen.alt_rel_m >= self._there_m:
            self.commands.forget(Command.NAV_TAKEOFF)
            self.fire(Event.AIRBORNE, now_ns)
        elif seen.alt_rel_m >= self._climbed_m + 0.5:
            self._climbed_m, self._climbed_ns = seen.alt_rel_m, now_ns
        elif now_ns - self._climbed_ns >= CLIMB_NS:
            if self._climbed_m >= AIRBORNE_M:  # flying, and not climbing: where it is will do, a target brings it up
                self.fire(Event.AIRBORNE, now_ns)
                return
            self._climbed_ns = now_ns
            self._ask_takeoff(seen)

    def _ask_takeoff(self, seen: Telemetry) -> None:
        home_m = seen.home.alt_amsl_mm / 1e3 if seen.home else 0.0
        altitude_m = self._altitude_m + (home_m if self.profile.takeoff is Takeoff.NAV_AMSL else 0.0)
        yaw = self.profile.yaw_param
        self.commands.long(Command.NAV_TAKEOFF, 0.0, 0.0, 0.0, yaw, yaw, yaw, altitude_m)

    def _settle(self, seen: Telemetry, now_ns: int) -> None:
        if not seen.armed:
            self.fire(Event.DISARMED, now_ns)
        elif seen.custom_mode == self.profile.hold_mode:
            self.fire(Event.SETTLED, now_ns)

    def _watch(self, seen: Telemetry, now_ns: int) -> None:
        if not seen.armed:
            self.fire(Event.DISARMED, now_ns)


_WATCHERS: dict[Phase, Callable[[Launch, Telemetry, int], None]] = {
    Phase.WAITING: Launch._wait,
    Phase.MODE: Launch._set_mode,
    Phase.ARMING: Launch._arm,
    Phase.TAKEOFF: Launch._take_off,
    Phase.SETTLING: Launch._settle,
    Phase.READY: Launch._watch,
}
