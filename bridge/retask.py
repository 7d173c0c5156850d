"""Missions for a ground vehicle: upload, start at the first waypoint, and watch that it is driven.

Sans-IO; every change of `step` is a row of TRANSITIONS. A new mission in AUTO keeps the old current index on both
stacks, and an accepted mission is stored, not driven: so the current item is set in each stack's measured way
(`Profile.set_current`), the heartbeat must show the mode, and the vehicle's own target must be the waypoint.
"""

from __future__ import annotations

import math
from collections import deque
from enum import Enum

from gatar_edge.bridge import wire
from gatar_edge.bridge.commands import NEVER_NS, CommandClient
from gatar_edge.bridge.dialect import MISSION_COMPLETE, Command, CommandResult
from gatar_edge.bridge.mission_items import build
from gatar_edge.bridge.mission_states import Result
from gatar_edge.bridge.mission_transfer import MissionClient
from gatar_edge.bridge.modes import ModeKeeper
from gatar_edge.bridge.profiles.base import Profile, SetCurrent
from gatar_edge.bridge.status import Status
from gatar_edge.bridge.telemetry import Progress, Telemetry, distance_m
from gatar_edge.bridge.wire import Message
from gatar_edge.types import NS_PER_S

RETRY_NS = NS_PER_S
CONFIRM_NS = 5 * NS_PER_S
TOTAL_NS = 5 * NS_PER_S
MODE_PATIENCE_NS = 10 * NS_PER_S  # then STALE_TARGET is reported; the mode is still asked for
STARTS = 3
NEARER_M = 2.0  # in CONFIRM_NS: the last proof, where a vehicle tells of no target, or of where it goes round
# An upload that takes longer stops the vehicle: until it is complete, ArduPilot drives a mix of the old and the new
# mission, straight to whatever now stands at the old index.
MIXED_NS = NS_PER_S
MOST_ENDS = 8  # of missions commanded one after the other before the vehicle was seen to drive one

Points = tuple[tuple[float, float], ...]


class Step(Enum):
    """What is being waited for."""

    IDLE = "nothing"
    ADOPT = "what is on board, to compare it with what was remembered"
    UPLOAD = "the mission to be on board"
    TOTAL = "the vehicle to count its new mission"
    SET = "the current item to be the first"
    MODE = "the mission mode"
    CONFIRM = "the vehicle's own word that it goes there"
    DRIVE = "the distance to shrink"
    ARRIVED = "nothing: it is there"
    FAILED = "another command"

    __hash__ = object.__hash__  # looked up at each poll, and Enum's own is slow


class Event(Enum):
    """What happened."""

    DRIVE = "a mission was commanded"
    RESUME = "a mission was commanded that is being driven, if memory serves"
    ON_BOARD = "the mission is on board"
    NOT_ON_BOARD = "the upload failed"
    COUNTED = "the vehicle counts the new mission"
    CURRENT = "the current item is set"
    IN_MODE = "the vehicle is in the mission mode"
    MODE_ENTERED = "it was not before: the current item must be set again"
    CONFIRMED = "the vehicle goes to the waypoint"
    UNCONFIRMED = "it does not"
    GIVEN_UP = "tried often enough"
    REOPENED = "a delayed packet has opened the upload again"
    REACHED = "the last waypoint is reached"


_S, _E = Step, Event
_ANY: dict[Event, Step] = {_E.DRIVE: _S.UPLOAD, _E.REOPENED: _S.UPLOAD}
TRANSITIONS: dict[Step, dict[Event, Step]] = {
    _S.IDLE: {_E.DRIVE: _S.UPLOAD, _E.RESUME: _S.ADOPT},
    _S.ADOPT: {_E.DRIVE: _S.UPLOAD, _E.ON_BOARD: _S.CONFIRM, _E.NOT_ON_BOARD: _S.UPLOAD},
    _S.UPLOAD: {_E.DRIVE: _S.UPLOAD, _E.ON_BOARD: _S.TOTAL, _E.NOT_ON_BOARD: _S.FAILED},
    _S.TOTAL: {**_ANY, _E.COUNTED: _S.SET, _E.GIVEN_UP: _S.FAILED},
    _S.SET: {**_ANY, _E.CURRENT: _S.MODE, _E.GIVEN_UP: _S.FAILED},
    _S.MODE: {**_ANY, _E.IN_MODE: _S.CONFIRM, _E.MODE_ENTERED: _S.SET},
    _S.CONFIRM: {**_ANY, _E.CONFIRMED: _S.DRIVE, _E.UNCONFIRMED: _S.SET, _E.GIVEN_UP: _S.FAILED},
    _S.DRIVE: {**_ANY, _E.REACHED: _S.ARRIVED, _E.UNCONFIRMED: _S.SET},
    _S.ARRIVED: {_E.DRIVE: _S.UPLOAD},
    _S.FAILED: {_E.DRIVE: _S.UPLOAD},
}


class Retask:
    """Drives one vehicle along missions, and tells how that goes in `status`."""

    def __init__(
        self,
        profile: Profile,
        commands: CommandClient,
        modes: ModeKeeper,
        transfer: MissionClient,
        *,
        arrive_m: float,
        near_m: float,
        progress_s: float,
        speed_m_s: float | None,
    ) -> None:
        self.profile, self.commands, self.modes, self.transfer = profile, commands, modes, transfer
        self.step, self.status = Step.IDLE, Status.IDLE
        self._arrive_m, self._near_m, self._speed_m_s = arrive_m, near_m, speed_m_s
        self._progress = Progress(round(progress_s * NS_PER_S))
        self._points: Points = ()
        self._ends_before: deque[tuple[float, float]] = deque(maxlen=MOST_ENDS)
        self._since_ns = self._sent_ns = self._uploaded_ns = 0
        self._starts = self._start_index = 0
        self._mode_was_other = False
        self._confirm_from_m = math.inf  # the way that remained when it was last told to start
        self._out: list[Message] = []

    def drive(self, points: Points, now_ns: int) -> None:
        """Drive along (lat, lon) points."""
        # a mission before may come to its end while this one is on its way: any that was commanded since the last that
        # the vehicle was seen to drive, and that one itself
        self._ends_before.extend(self._points[-1:])
        self._points = points
        self._starts = self._start_index = 0
        self._fire(Event.DRIVE, now_ns, Status.STARTING)

    def resume(self, points: Points, now_ns: int) -> None:
        """Go on with a mission that the vehicle seems to be driving; nothing is uploaded where it is on board."""
        self._points, self._starts = points, 0
        self._fire(Event.RESUME, now_ns, Status.STARTING)

    def stop(self) -> None:
        """Send nothing more; what stops the vehicle is a mode."""
        self.commands.forget(Command.DO_SET_MISSION_CURRENT)
        self.step, self.status = Step.IDLE, Status.IDLE

    def index(self, seen: Telemetry) -> int:
        """Which of the points is being approached, as far as the vehicle tells."""
        seq = seen.current.seq if seen.current and seen.current_ns > self._uploaded_ns else 0
        return min(max(seq - self.profile.first_item_seq, 0), len(self._points) - 1) if self._points else 0

    def at_end(self, seen: Telemetry) -> bool:
        """Whether leaving the mission mode now is the vehicle's own doing."""
        complete = seen.current is not None and seen.current.state == MISSION_COMPLETE
        ends = (*self._points[-1:], *self._ends_before)
        return complete or any(seen.distance_m(end) <= self._near_m for end in ends)

    @property
    def due_ns(self) -> int:
        """When `poll` has something to do again, unless something arrives or is commanded first."""
        if self.step is Step.DRIVE:
            return self._progress.due_ns
        return 0 if self.step in _WATCHERS else NEVER_NS

    @property
    def watches(self) -> bool:
        """Whether the vehicle's position and its current item give `poll` something to do before `due_ns`."""
        return self.step is Step.DRIVE

    def poll(self, seen: Telemetry, now_ns: int) -> list[Message]:
        """Read the vehicle's answers, go on, and hand over messages to send now."""
        watch = _WATCHERS.get(self.step)
        if watch is not None:
            if self.transfer.active and self.step is not Step.UPLOAD and Event.REOPENED in TRANSITIONS[self.step]:
                if self.step is Step.DRIVE:
                    self._start_index = self.index(seen)  # go on from there, not from the first waypoint
                self._fire(Event.REOPENED, now_ns, Status.STARTING)
                watch = _WATCHERS[self.step]
            watch(self, seen, now_ns)
        out, self._out = self._out, []
        return out

    def _fire(self, event: Event, now_ns: int, status: Status) -> None:
        self.step = TRANSITIONS[self.step][event]
        self.status, self._since_ns = status, now_ns
        if self.step is Step.ADOPT:
            self.transfer.download(now_ns)
        elif self.step is Step.UPLOAD and event is not Event.REOPENED:
            self.transfer.upload(build(self.profile, self._points, 0.0), now_ns)
        elif self.step is Step.SET:
            self._confirm_from_m = math.inf
            self._set_current(now_ns)
        elif self.step is Step.MODE:
            self._mode_was_other = False
            self.modes.want(self.profile.mission_mode)
        elif self.step is Step.FAILED:
            self.commands.forget(Command.DO_SET_MISSION_CURRENT)

    def _set_current(self, now_ns: int) -> None:
        self._sent_ns = now_ns
        seq = self.profile.first_item_seq + self._start_index
        if self.profile.set_current is SetCurrent.COMMAND_WITH_RESET:
            self.commands.long(Command.DO_SET_MISSION_CURRENT, seq, 1.0)
        else:
            self._out.append(wire.MissionSetCurrent(self.transfer.vehicle, seq))

    def _watch_adopt(self, seen: Telemetry, now_ns: int) -> None:
        if self.transfer.active:
            return
        if self.transfer.adopt(build(self.profile, self._points, 0.0)):
            self._start_index, self._sent_ns = self.index(seen), now_ns
            self.modes.want(self.profile.mission_mode)
            self._fire(Event.ON_BOARD, now_ns, Status.STARTING)
        else:
            self._start_index = 0
            self._fire(Event.NOT_ON_BOARD, now_ns, Status.STARTING)

    def _watch_upload(self, seen: Telemetry, now_ns: int) -> None:
        result = self.transfer.result
        if self.transfer.active or result is None:
            mixed = not self.profile.atomic_upload and seen.custom_mode == self.profile.mission_mode
            if mixed and now_ns - self._since_ns >= MIXED_NS:
                self.modes.want(self.profile.hold_mode)
            return
        if result in (Result.ACCEPTED, Result.ALREADY_ON_BOARD):
            self._uploaded_ns = now_ns
            self._fire(Event.ON_BOARD, now_ns, Status.STARTING)
        else:
            self._fire(Event.NOT_ON_BOARD, now_ns, Status.UPLOAD_FAILED)

    def _watch_total(self, seen: Telemetry, now_ns: int) -> None:
        command = self.profile.set_current is SetCurrent.COMMAND_WITH_RESET
        counted = seen.current is not None and seen.current.total == len(self._points)
        if command or (counted and seen.current_ns > self._since_ns):
            self._fire(Event.COUNTED, now_ns, Status.STARTING)
        elif now_ns - self._since_ns >= TOTAL_NS:
            self.transfer.forget()
            self._fire(Event.GIVEN_UP, now_ns, Status.STALE_TARGET)

    def _watch_set(self, seen: Telemetry, now_ns: int) -> None:
        if self.profile.set_current is SetCurrent.COMMAND_WITH_RESET:
            result = self.commands.result(Command.DO_SET_MISSION_CURRENT)
            if result is CommandResult.NO_ANSWER:
                self._fire(Event.GIVEN_UP, now_ns, Status.STALE_TARGET)
            elif result is not None:  # refused outside AUTO is no harm: it is sent again there, and watched
                self._fire(Event.CURRENT, now_ns, Status.STARTING)
        elif self._current_is_first(seen):
            self._fire(Event.CURRENT, now_ns, Status.STARTING)
        elif now_ns - self._since_ns >= CONFIRM_NS:
            self._fire(Event.GIVEN_UP, now_ns, Status.STALE_TARGET)
        elif now_ns - self._sent_ns >= RETRY_NS:
            self._set_current(now_ns)

    def _watch_mode(self, seen: Telemetry, now_ns: int) -> None:
        if seen.custom_mode == self.profile.mission_mode:
            again = self._mode_was_other and self.profile.set_current is SetCurrent.COMMAND_WITH_RESET
            self._fire(Event.MODE_ENTERED if again else Event.IN_MODE, now_ns, Status.STARTING)
            return
        self._mode_was_other = True
        if now_ns - self._since_ns >= MODE_PATIENCE_NS:
            self.status = Status.STALE_TARGET

    def _watch_confirm(self, seen: Telemetry, now_ns: int) -> None:
        going = self._current_is_first(seen) and seen.echoes(self._points[self.index(seen)], self._sent_ns)
        there = seen.distance_m(self._points[-1]) <= self._arrive_m
        late = now_ns - self._since_ns >= CONFIRM_NS
        if math.isinf(self._confirm_from_m):
            self._confirm_from_m = self._remaining_m(seen)
        nearer = self._current_is_first(seen) and self._remaining_m(seen) <= self._confirm_from_m - NEARER_M
        if going or there or (late and self._starts + 1 == STARTS and nearer):
            self._starts = 0
            self._ends_before.clear()
            self._progress.start(self._remaining_m(seen), now_ns)
            if self._speed_m_s is not None:  # ground speed; entering the mode has set it back to the vehicle's own
                self.commands.long(Command.DO_CHANGE_SPEED, 1.0, self._speed_m_s, -1.0)
            self.modes.want(None)  # PX4 leaves it at the end; re-entered, it would start at the old index
            self._fire(Event.CONFIRMED, now_ns, Status.PURSUING)
        elif late and self.transfer.result is Result.ALREADY_ON_BOARD:
            self.transfer.forget()  # then it may be another's, as long as ours
            self._fire(Event.DRIVE, now_ns, Status.STARTING)
        elif late:
            self._starts += 1
            last = self._starts >= STARTS
            self._fire(
                Event.GIVEN_UP if last else Event.UNCONFIRMED, now_ns, Status.STALE_TARGET if last else Status.STARTING
            )

    def _watch_drive(self, seen: Telemetry, now_ns: int) -> None:
        last_m = seen.distance_m(self._points[-1])
        if last_m <= self._arrive_m or (self.at_end(seen) and last_m <= self._near_m and self._complete(seen)):
            self._fire(Event.REACHED, now_ns, Status.ARRIVED)
        elif seen.current and not seen.current.may_be(len(self._points)):
            self.transfer.forget()  # somebody else has uploaded
            self.status = Status.STALE_TARGET
        else:
            stalled = self._progress.stalled(self._remaining_m(seen), now_ns)
            self.status = Status.NOT_PROGRESSING if stalled else Status.PURSUING

    def _complete(self, seen: Telemetry) -> bool:
        return seen.current is not None and seen.current.state == MISSION_COMPLETE and seen.current_ns > self._sent_ns

    def _current_is_first(self, seen: Telemetry) -> bool:
        """Whether the vehicle, asked since, is at the first waypoint, or past such as it stood on already."""
        current = seen.current
        if current is None or seen.current_ns <= self._sent_ns:
            return False
        if not current.may_be(len(self._points)):
            return False
        index = current.seq - self.profile.first_item_seq
        skipped = self._points[self._start_index : index]
        return index >= self._start_index and all(seen.distance_m(p) <= self._near_m for p in skipped)

    def _remaining_m(self, seen: Telemetry) -> float:
        rest = self._points[self.index(seen) :]
        return seen.distance_m(rest[0]) + sum(map(distance_m, rest, rest[1:]))


_WATCHERS = {
    Step.ADOPT: Retask._watch_adopt,
    Step.UPLOAD: Retask._watch_upload,
    Step.TOTAL: Retask._watch_total,
    Step.SET: Retask._watch_set,
    Step.MODE: Retask._watch_mode,
    Step.CONFIRM: Retask._watch_confirm,
    Step.DRIVE: Retask._watch_drive,
}
