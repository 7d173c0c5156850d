"""Upload, download and clearing of a mission: the client's half of MAVLink's mission protocol, sans-IO.

Rule 1: the vehicle pulls. COUNT and LIST are re-sent; an item goes out each time it is requested and at no other time,
  also after the transfer has ended, because a delayed COUNT re-opens it on the vehicle.
Rule 2: every change of `step` is a row of TRANSITIONS.
Rule 3: only what comes from the vehicle's autopilot, is addressed to us and is of type 0 counts.
Rule 4: "accepted" is said only when what is on board is certain to be the new mission. Where packets of an earlier
  transfer may still be under way (PACKET_LIFE_NS), the vehicle's word is not enough: it is downloaded and compared.
Timers and their values were measured on ArduPilot 4.6.2 and PX4 of August 2025, through links that lose 20-30 %.
"""

from __future__ import annotations

import random
from collections import deque
from collections.abc import Callable

from gatar_edge.bridge import wire
from gatar_edge.bridge.commands import NEVER_NS
from gatar_edge.bridge.dialect import MissionResult
from gatar_edge.bridge.mission_items import MAX_ITEMS, Items, fingerprint, same_mission
from gatar_edge.bridge.mission_states import ACK_EVENTS, REFUSALS, TRANSITIONS, Event, Result, Step
from gatar_edge.bridge.profiles.base import Profile
from gatar_edge.bridge.wire import Address, Message
from gatar_edge.types import NS_PER_S

RESEND_NS = NS_PER_S  # COUNT, LIST, requests and CLEAR_ALL, until the first answer
RESENDS = 10
SILENCE_NS = 8_500_000_000  # ArduPilot gives an upload up after 8 s, PX4 after 5 s and without a word
LAST_ACK_NS = 2 * NS_PER_S  # then it was lost, and only a download can tell
TOTAL_NS = 60 * NS_PER_S
BACKOFF_NS = 2 * NS_PER_S  # and up to as much again, at random: another ground station is uploading
PACKET_LIFE_NS = NS_PER_S  # after this long no packet is still under way


class MissionClient:
    """Moves missions between one vehicle's autopilot and us; one transfer at a time.

    `receive` and `poll` may be called with anything at any time. `result` is None while a transfer is under way.
    """

    def __init__(self, profile: Profile, me: Address, vehicle: Address, jitter: random.Random) -> None:
        self.profile, self.me, self.vehicle = profile, me, vehicle
        self.step = Step.IDLE
        self.result: Result | None = None
        self.downloaded: Items = ()
        self.on_board: str | None = None  # fingerprint of the mission that is certainly on board
        self._jitter = jitter
        self._goal = Event.DOWNLOAD
        self._items: Items = ()
        self._requested: set[int] = set()
        self._doubt = False
        self._seen_denied = self._seen_error = False
        self._count = 0
        self._fetched: list[wire.MissionItem] = []
        self._sends = 0
        self._timer_ns = self._deadline_ns = 0
        self._traffic_ns = -PACKET_LIFE_NS
        self._out: deque[Message] = deque(maxlen=256)

    @property
    def active(self) -> bool:
        """Whether a transfer is under way."""
        return self.step is not Step.IDLE

    def upload(self, items: Items, now_ns: int) -> None:
        """Put a mission on board, first giving up any transfer under way. Nothing is sent if it is there already."""
        if not 0 < len(items) <= MAX_ITEMS or not all(map(wire.sendable, items)):
            self._finish(Result.NOT_SENDABLE)
        elif not self.active and self.on_board == fingerprint(items, self.profile.first_item_seq):
            self._finish(Result.ALREADY_ON_BOARD)
        else:
            self._begin(Event.UPLOAD, now_ns, items)

    def download(self, now_ns: int) -> None:
        """Read what is on board into `downloaded`."""
        self._begin(Event.DOWNLOAD, now_ns, self._items)

    def clear(self, now_ns: int) -> None:
        """Remove the mission. Never a way to stop: ArduRover drives its old leg on at full speed."""
        self._begin(Event.CLEAR, now_ns, ())

    def forget(self) -> None:
        """Somebody else changed the mission on board: the next upload is sent whatever it is."""
        self.on_board = None

    def adopt(self, items: Items) -> bool:
        """Whether what was just downloaded is this mission; then it counts as on board, as if uploaded."""
        if self.result is not Result.DOWNLOADED or not same_mission(items, self.downloaded, self.profile):
            return False
        self._goal, self._items, self._requested = Event.UPLOAD, items, set()
        self._finish(Result.ACCEPTED)
        return True

    def abandon(self) -> None:
        """Stop without another word, also answering late requests: somebody else commands the vehicle."""
        self._finish(Result.CANCELLED)
        self._items, self.on_board = (), None
        self._out.clear()

    def receive(self, source: Address, message: Message, now_ns: int) -> None:
        """Take one message from the wire; what is not part of our transfer is ignored."""
        if source != self.vehicle:
            return
        match message:
            case wire.MissionRequest(target=self.me, mission_type=0):
                self._on_request(message, now_ns)
            case wire.MissionAck(target=self.me, mission_type=0):
                self._on_ack(message, now_ns)
            case wire.MissionCount(target=self.me, mission_type=0):
                self._on_count(message, now_ns)
            case wire.MissionItemAt(target=self.me, mission_type=0):
                self._on_item(message, now_ns)
            case wire.MissionCurrent() if not self.active and now_ns - self._traffic_ns >= PACKET_LIFE_NS:
                if not message.may_be(len(self._items) - self.profile.first_item_seq):
                    self.forget()

    @property
    def due_ns(self) -> int:
        """When `poll` has something to do again, unless something arrives or is commanded first."""
        return 0 if self.active or self._out else NEVER_NS

    def poll(self, now_ns: int) -> list[Message]:
        """Run the timers and hand over all messages to send now."""
        if self.step is not Step.IDLE:
            self._run_timers(now_ns)
        if not self._out:
            return []
        out = list(self._out)
        self._out.clear()
        self._traffic_ns = now_ns
        return out

    def _begin(self, goal: Event, now_ns: int, items: Items) -> None:
        self._doubt = self.active or now_ns - self._traffic_ns < PACKET_LIFE_NS
        if self.active:  # PX4 stops at once; ArduPilot ignores it and restarts at our COUNT
            self._send_ack(MissionResult.OPERATION_CANCELLED)
            self.step = Step.IDLE
        if goal is not Event.DOWNLOAD:
            self.on_board = None
        self._goal, self._items, self.result = goal, items, None
        self._seen_denied = self._seen_error = False
        self._deadline_ns = now_ns + TOTAL_NS
        self._fire(goal, now_ns)

    def _fire(self, event: Event, now_ns: int, result: Result | None = None) -> bool:
        """Take the row of TRANSITIONS for `event`, if there is one."""
        to = TRANSITIONS[self.step].get(event)
        if to is None:
            return False
        entered, self.step = to is not self.step, to
        self._timer_ns = now_ns
        if to is Step.IDLE:
            self._finish(result or Result.TIMEOUT)
        elif entered or event is Event.COUNTED:
            self._sends = 0
            _ENTER[to](self, now_ns)
        return True

    def _finish(self, result: Result) -> None:
        self.step, self.result = Step.IDLE, result
        if result is Result.ACCEPTED:
            self.on_board = fingerprint(self._items, self.profile.first_item_seq)

    # --- what is sent ---

    def _send_count(self, now_ns: int) -> None:
        if self._sends == 0:
            self._requested.clear()
        self._resend(wire.MissionCount(self.vehicle, len(self._items)), now_ns)

    def _send_list(self, now_ns: int) -> None:
        self._resend(wire.MissionRequestList(self.vehicle), now_ns)

    def _send_clear(self, now_ns: int) -> None:
        self._resend(wire.MissionClearAll(self.vehicle), now_ns)

    def _send_request(self, now_ns: int) -> None:
        self._resend(wire.MissionRequest(self.vehicle, len(self._fetched)), now_ns)

    def _send_ack(self, result: MissionResult) -> None:
        self._out.append(wire.MissionAck(self.vehicle, result))

    def _resend(self, message: Message, now_ns: int) -> None:
        self._out.append(message)
        self._sends += 1
        self._timer_ns = now_ns

    def _back_off(self, now_ns: int) -> None:
        self._timer_ns = now_ns + int(self._jitter.random() * BACKOFF_NS)

    def _wait(self, now_ns: int) -> None:
        """Nothing to send: the vehicle asks."""

    # --- what time does ---

    def _run_timers(self, now_ns: int) -> None:
        if now_ns >= self._deadline_ns:
            busy = self._seen_denied and not self._requested
            self._finish(Result.DENIED if busy else Result.TIMEOUT)
            return
        limit_ns, event = _TIMEOUTS[self.step]
        if now_ns - self._timer_ns < limit_ns:
            return
        if event is not Event.UNANSWERED:
            self._fire(event, now_ns)
        elif self._sends >= RESENDS:
            self._fire(event, now_ns, self._unanswered())
        else:
            _ENTER[self.step](self, now_ns)

    def _unanswered(self) -> Result:
        if self._seen_denied:
            return Result.DENIED
        return Result.PEER_ERROR if self._seen_error else Result.NO_ANSWER

    # --- what the vehicle says ---

    def _on_request(self, message: wire.MissionRequest, now_ns: int) -> None:
        if message.seq >= len(self._items):
            return
        self._out.append(wire.MissionItemAt(self.vehicle, message.seq, self._items[message.seq]))
        if self._goal is not Event.UPLOAD:
            self.on_board = None  # re-opened by a delayed COUNT: what will be on board is open
            return
        if not self.active:
            if self.on_board is None:
                return  # that upload failed, and was reported so
            self._requested.clear()
            self._deadline_ns = now_ns + TOTAL_NS
            self.result, self.on_board, self._doubt = None, None, True
        self._requested.add(message.seq)
        complete = len(self._requested) == len(self._items)
        self._fire(Event.ALL_REQUESTED if complete else Event.REQUEST, now_ns)

    def _on_ack(self, message: wire.MissionAck, now_ns: int) -> None:
        self._seen_denied |= message.result == MissionResult.DENIED
        self._seen_error |= message.result == MissionResult.ERROR
        if message.result == MissionResult.ACCEPTED:
            self._on_accepted(now_ns)
        elif message.result in ACK_EVENTS:
            ends = Result.DENIED if message.result == MissionResult.DENIED else Result.PEER_ERROR
            self._fire(ACK_EVENTS[message.result], now_ns, ends)
        elif message.result in REFUSALS:
            self._fire(Event.REFUSED, now_ns, REFUSALS[message.result])

    def _on_accepted(self, now_ns: int) -> None:
        if self._goal is Event.CLEAR:
            self._fire(Event.ACCEPTED, now_ns, Result.CLEARED)
        elif self._goal is Event.UPLOAD:  # no row takes it before every item was requested
            if self.step is Step.FETCH and not self._doubt:
                self._send_ack(MissionResult.ACCEPTED)  # PX4 takes no set-current while a download is open
            self._fire(Event.DOUBTFUL if self._doubt else Event.ACCEPTED, now_ns, Result.ACCEPTED)

    def _on_count(self, message: wire.MissionCount, now_ns: int) -> None:
        if self.step not in (Step.LIST, Step.FETCH):
            return
        if self._goal is Event.UPLOAD and message.count != len(self._items):
            self._send_ack(MissionResult.ACCEPTED)
            self._fire(Event.DIFFERENT, now_ns)
            return
        self._count, self._fetched = min(message.count, MAX_ITEMS), []
        if self._count:
            self._fire(Event.COUNTED, now_ns)
        else:
            self._end_fetch(now_ns)

    def _on_item(self, message: wire.MissionItemAt, now_ns: int) -> None:
        if self.step is not Step.FETCH or message.seq != len(self._fetched):
            return
        self._fetched.append(message.item)
        self._sends = 0
        if len(self._fetched) < self._count:
            self._send_request(now_ns)
        else:
            self._end_fetch(now_ns)

    def _end_fetch(self, now_ns: int) -> None:
        self._send_ack(MissionResult.ACCEPTED)
        if self._goal is Event.DOWNLOAD:
            self.downloaded = tuple(self._fetched)
            self._fire(Event.COMPLETE, now_ns, Result.DOWNLOADED)
        elif same_mission(self._items, tuple(self._fetched), self.profile):
            self._fire(Event.SAME, now_ns, Result.ACCEPTED)
        else:
            self._fire(Event.DIFFERENT, now_ns)


_ENTER: dict[Step, Callable[[MissionClient, int], None]] = {
    Step.COUNT: MissionClient._send_count,
    Step.ITEMS: MissionClient._wait,
    Step.LAST_ACK: MissionClient._wait,
    Step.LIST: MissionClient._send_list,
    Step.FETCH: MissionClient._send_request,
    Step.BACKOFF: MissionClient._back_off,
    Step.CLEAR: MissionClient._send_clear,
}

_TIMEOUTS: dict[Step, tuple[int, Event]] = {
    Step.COUNT: (RESEND_NS, Event.UNANSWERED),
    Step.ITEMS: (SILENCE_NS, Event.SILENT),
    Step.LAST_ACK: (LAST_ACK_NS, Event.SILENT),
    Step.LIST: (RESEND_NS, Event.UNANSWERED),
    Step.FETCH: (RESEND_NS, Event.UNANSWERED),
    Step.BACKOFF: (BACKOFF_NS, Event.BACKED_OFF),
    Step.CLEAR: (RESEND_NS, Event.UNANSWERED),
}
