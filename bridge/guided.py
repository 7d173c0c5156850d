"""Guided targets: COMMAND_INT DO_REPOSITION, acknowledged, echoed by the vehicle, and then watched by distance.

Sans-IO; every change of `step` is a row of TRANSITIONS. A list of points is visited one after another. The target is
given once and re-sent only while it is not confirmed: position targets never time out on either stack.
Where so configured it is SET_POSITION_TARGET_GLOBAL_INT: that has no acknowledgement, so it is re-sent until the echo
comes, and is ignored outside of the guided mode, so that comes first. Not on PX4, which would need a stream of it and
OFFBOARD, whose loss is a failsafe.

With its own avoidance of obstacles on, ArduRover echoes where it goes round. So a rover that keeps telling another
target, and gets nearer all the same, is believed, and watched by distance alone.
"""

from __future__ import annotations

import math
from enum import Enum

from gatar_edge.bridge import wire
from gatar_edge.bridge.commands import NEVER_NS, CommandClient
from gatar_edge.bridge.dialect import Command, CommandResult
from gatar_edge.bridge.geo import deg_e7
from gatar_edge.bridge.modes import ModeKeeper
from gatar_edge.bridge.profiles.base import Profile
from gatar_edge.bridge.status import Status
from gatar_edge.bridge.telemetry import Progress, Telemetry, distance_m
from gatar_edge.bridge.wire import CommandInt, Message
from gatar_edge.types import NS_PER_S, RobotKind

ECHO_NS = 2 * NS_PER_S  # the echo comes at 2 Hz
ASKS = 3
RESEND_NS = NS_PER_S  # of what is not acknowledged
RESENDS = 5
MODE_PATIENCE_NS = 10 * NS_PER_S
NEARER_M = 2.0  # since the first time of asking: the proof where the vehicle tells where it goes round
STANDS_NS = 3 * NS_PER_S  # without getting nearer, so near that it is there all the same
CHANGE_MODE_FLAG = 1.0  # MAV_DO_REPOSITION_FLAGS_CHANGE_MODE: without it PX4 answers UNSUPPORTED, ArduPilot DENIED
KEEP_SPEED = -1.0

Points = tuple[tuple[float, float], ...]


class Step(Enum):
    """What is being waited for."""

    IDLE = "nothing"
    ASKED = "the acknowledgement"
    ECHO = "the vehicle's own word that it goes there"
    GOING = "the distance to shrink"
    ARRIVED = "nothing: it is there"
    FAILED = "another command"


class Event(Enum):
    """What happened."""

    GO = "a target was commanded"
    ACCEPTED = "the command was acknowledged"
    ECHOED = "the vehicle says that it goes there"
    DEVIATED = "the vehicle says that it goes somewhere else"
    REFUSED = "the vehicle refused"
    GIVEN_UP = "asked often enough"
    NEXT = "a point is reached, others follow"
    REACHED = "the last point is reached"


_S, _E = Step, Event
TRANSITIONS: dict[Step, dict[Event, Step]] = {
    _S.IDLE: {_E.GO: _S.ASKED},
    _S.ASKED: {
        _E.GO: _S.ASKED,
        _E.ACCEPTED: _S.ECHO,
        _E.ECHOED: _S.GOING,
        _E.REFUSED: _S.FAILED,
        _E.GIVEN_UP: _S.FAILED,
    },
    _S.ECHO: {_E.GO: _S.ASKED, _E.ECHOED: _S.GOING, _E.DEVIATED: _S.ASKED, _E.GIVEN_UP: _S.FAILED},
    _S.GOING: {
        _E.GO: _S.ASKED,
        _E.DEVIATED: _S.ASKED,
        _E.GIVEN_UP: _S.FAILED,
        _E.NEXT: _S.ASKED,
        _E.REACHED: _S.ARRIVED,
    },
    _S.ARRIVED: {_E.GO: _S.ASKED},
    _S.FAILED: {_E.GO: _S.ASKED},
}


class Guided:
    """Sends one vehicle to points, and tells how that goes in `status`."""

    def __init__(
        self,
        profile: Profile,
        commands: CommandClient,
        modes: ModeKeeper,
        *,
        arrive_m: float,
        near_m: float,
        progress_s: float,
        setpoints: bool = False,
    ) -> None:
        """`setpoints`: SET_POSITION_TARGET_GLOBAL_INT, on stacks that have a `position_frame`."""
        self.profile, self.commands, self.modes = profile, commands, modes
        self.step, self.status = Step.IDLE, Status.IDLE
        self._arrive_m, self._near_m = arrive_m, near_m
        self._progress = Progress(round(progress_s * NS_PER_S))
        self._approach, self._is_near = Progress(STANDS_NS), False
        self._asked_from_m, self._heeds_echo = math.inf, True
        self._setpoints, self._sent_ns, self._sends = setpoints, 0, 0
        self._out: list[Message] = []
        self._points: Points = ()
        self._index = self._asks = 0
        self._alt_m = self._home_amsl_m = 0.0
        self._speed_m_s = KEEP_SPEED
        self._hold = False
        self._since_ns = self._matched_ns = 0

    def go(self, points: Points, alt_rel_m: float, home_amsl_m: float, now_ns: int, *, hold: bool = False) -> None:
        """Visit (lat, lon) points in order, `alt_rel_m` above home. `hold`: the point is where it is already."""
        self._points, self._alt_m, self._home_amsl_m = points, alt_rel_m, home_amsl_m
        self._index, self._hold = 0, hold
        self._begin(now_ns)

    def speed(self, speed_m_s: float) -> None:
        """Ground speed for the targets from now on."""
        self._speed_m_s = speed_m_s

    def stop(self) -> None:
        """Send nothing more."""
        self.commands.forget(Command.DO_REPOSITION)
        self.step, self.status = Step.IDLE, Status.IDLE

    @property
    def due_ns(self) -> int:
        """When `poll` has something to do again, unless something arrives or is commanded first."""
        if self.step is Step.GOING:
            progress_ns = NEVER_NS if self._hold else self._progress.due_ns
            return min(progress_ns, self._approach.due_ns) if self._is_near else progress_ns
        if self.step is Step.ECHO:
            return self._since_ns + ECHO_NS
        return 0 if self.step is Step.ASKED else NEVER_NS

    @property
    def watches(self) -> bool:
        """Whether the vehicle's position gives `poll` something to do before `due_ns`."""
        return self.step is Step.GOING

    @property
    def listens(self) -> bool:
        """Whether the vehicle's echo of the target does."""
        return self.step is Step.GOING or self.step is Step.ECHO

    def poll(self, seen: Telemetry, now_ns: int) -> list[Message]:
        """Read the vehicle's answers, ask again where they are missing, and hand over messages to send now."""
        if math.isinf(self._asked_from_m) and self._points:
            self._asked_from_m = seen.distance_m(self._point())
        if self.step is Step.ASKED and self._setpoints:
            self._watch_setpoint(seen, now_ns)
        elif self.step is Step.ASKED:
            self._watch_ack(seen, now_ns)
        elif self.step is Step.ECHO:
            self._watch_echo(seen, now_ns)
        elif self.step is Step.GOING:
            self._watch_distance(seen, now_ns)
        out, self._out = self._out, []
        return out

    def _point(self) -> tuple[float, float]:
        return self._points[self._index]

    def _begin(self, now_ns: int) -> None:
        self._asks = 0
        self._fire(Event.GO, now_ns, Status.STARTING)

    def _fire(self, event: Event, now_ns: int, status: Status) -> None:
        self.step = TRANSITIONS[self.step][event]
        self.status = Status.HOLDING if self._hold and not status.failed else status
        if self.step is Step.ASKED:
            self._ask(now_ns)
        elif self.step is Step.FAILED:
            self.commands.forget(Command.DO_REPOSITION)

    def _ask(self, now_ns: int) -> None:
        if not self._asks:
            self._asked_from_m, self._heeds_echo = math.inf, True
        self._asks += 1
        self._since_ns = now_ns
        if self._setpoints:
            self._sent_ns, self._sends = now_ns - RESEND_NS, 0
            self.modes.want(self.profile.guided_mode)
            return
        lat, lon = self._point()
        self.modes.expect(self.profile.guided_mode, now_ns)
        self.commands.send(
            CommandInt(
                to=self.commands.vehicle,
                frame=self.profile.reposition_frame,
                command=Command.DO_REPOSITION,
                params=(self._speed_m_s, CHANGE_MODE_FLAG, 0.0, math.nan),
                lat_e7=deg_e7(lat),
                lon_e7=deg_e7(lon),
                alt_m=self._alt_m + (self._home_amsl_m if self.profile.reposition_amsl else 0.0),
            )
        )

    def _watch_setpoint(self, seen: Telemetry, now_ns: int) -> None:
        if seen.custom_mode != self.profile.guided_mode:  # entering it would cancel what is echoed now
            if now_ns - self._since_ns >= MODE_PATIENCE_NS:
                self._fire(Event.GIVEN_UP, now_ns, Status.STALE_TARGET)
        elif self._sends and seen.echoes(self._point(), self._since_ns):
            self._confirmed(seen, now_ns)
        elif now_ns - self._sent_ns >= RESEND_NS:
            if self._sends < RESENDS:
                self._send_setpoint(now_ns)
            elif seen.echo_ns <= self._since_ns:  # no echo of anything arrives: then only the distance can tell
                self._confirmed(seen, now_ns)
            elif self._goes_round(seen):
                self._confirmed(seen, now_ns)
                self._heeds_echo = False
            else:  # it keeps its old target: a copter's own fence refuses in silence
                self._fire(Event.GIVEN_UP, now_ns, Status.STALE_TARGET)

    def _send_setpoint(self, now_ns: int) -> None:
        assert self.profile.position_frame is not None
        self._sent_ns, self._sends = now_ns, self._sends + 1
        lat, lon = self._point()
        self._out.append(
            wire.SetPositionTarget(
                to=self.commands.vehicle,
                frame=self.profile.position_frame,
                type_mask=self.profile.position_type_mask,
                lat_e7=deg_e7(lat),
                lon_e7=deg_e7(lon),
                alt_m=self._alt_m,
            )
        )

    def _watch_ack(self, seen: Telemetry, now_ns: int) -> None:
        result = self.commands.result(Command.DO_REPOSITION)
        if seen.echoes(self._point(), self._since_ns):
            self._confirmed(seen, now_ns)
        elif result is CommandResult.ACCEPTED:
            self._fire(Event.ACCEPTED, now_ns, Status.STARTING)
        elif result is CommandResult.FAILED:  # what Copter says to a target outside its fence
            self._fire(Event.REFUSED, now_ns, Status.REFUSED_FENCE)
        elif result is CommandResult.NO_ANSWER:
            self._fire(Event.GIVEN_UP, now_ns, Status.STALE_TARGET)
        elif result is not None:
            self._fire(Event.REFUSED, now_ns, Status.REFUSED)

    def _watch_echo(self, seen: Telemetry, now_ns: int) -> None:
        if seen.echoes(self._point(), self._since_ns):
            self._confirmed(seen, now_ns)
        elif now_ns - self._since_ns >= ECHO_NS:
            if seen.echo_ns <= self._since_ns:  # no echo of anything arrives: then only the distance can tell
                self._confirmed(seen, now_ns)
            elif self._asks >= ASKS and self._goes_round(seen):
                self._confirmed(seen, now_ns)
                self._heeds_echo = False
            else:
                self._deviated(now_ns)

    def _confirmed(self, seen: Telemetry, now_ns: int) -> None:
        self._asks, self._matched_ns = 0, now_ns
        self.commands.forget(Command.DO_REPOSITION)
        self._progress.start(self._remaining_m(seen), now_ns)
        self._approach.start(seen.distance_m(self._point()), now_ns)
        self._is_near = False
        if self._speed_m_s > 0:  # ArduCopter ignores the speed of a reposition, and its first one sets back its own
            self.commands.long(Command.DO_CHANGE_SPEED, 1.0, self._speed_m_s, -1.0)
        self._fire(Event.ECHOED, now_ns, Status.PURSUING)

    def _deviated(self, now_ns: int) -> None:
        """Ask again: most likely a delayed copy of an older command arrived after the newer one."""
        if self._asks >= ASKS:
            self._fire(Event.GIVEN_UP, now_ns, Status.STALE_TARGET)
        else:
            self._fire(Event.DEVIATED, now_ns, Status.STARTING)

    def _goes_round(self, seen: Telemetry) -> bool:
        """Whether a rover gets nearer, whatever it tells. Of a copter that may be chance: its old target lies there."""
        nearer = seen.distance_m(self._point()) <= self._asked_from_m - NEARER_M
        return self.profile.kind is RobotKind.UGV and nearer

    def _watch_distance(self, seen: Telemetry, now_ns: int) -> None:
        if not self._heeds_echo or seen.echoes(self._point(), self._matched_ns) or seen.echo_ns <= self._matched_ns:
            self._matched_ns = max(self._matched_ns, seen.echo_ns)
        elif seen.echo_ns - self._matched_ns >= ECHO_NS:
            self._deviated(now_ns)
            return
        if self._is_there(seen, now_ns):
            if self._index + 1 < len(self._points):
                self._index, self._asks = self._index + 1, 0
                self._fire(Event.NEXT, now_ns, Status.PURSUING)
            else:
                self._fire(Event.REACHED, now_ns, Status.ARRIVED)
        elif not self._hold:
            stalled = self._progress.stalled(self._remaining_m(seen), now_ns)
            self.status = Status.NOT_PROGRESSING if stalled else Status.PURSUING

    def _is_there(self, seen: Telemetry, now_ns: int) -> bool:
        """Whether it is at the point, or stands by it: ArduRover stops within WP_RADIUS, once 2.1 m before."""
        away_m = seen.distance_m(self._point())
        stands, self._is_near = self._approach.stalled(away_m, now_ns), away_m <= self._near_m
        return away_m <= self._arrive_m or (stands and self._is_near)

    def _remaining_m(self, seen: Telemetry) -> float:
        rest = self._points[self._index :]
        return seen.distance_m(rest[0]) + sum(map(distance_m, rest, rest[1:]))
