"""The vehicle's side of the mission protocol: the receiver pulls. Two dialects, one table each; no clock, no sockets.

Rule 1: what a state does with a message stands in `HANDLERS`; what the dialects answer differently stands in `Rules`.
Rule 2: a client is (sysid, compid); while a transfer is open, everybody else is turned away.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Any, Protocol

from gatar_edge.sim_sitl.mission_items import Ack, Item, item_from
from gatar_edge.sim_sitl.wire import Message

Client = tuple[int, int]


class State(Enum):
    """Of the one transfer that a vehicle has."""

    IDLE = "idle"
    RECEIVING = "receiving"
    SENDING = "sending"


@dataclass(frozen=True, slots=True)
class Rules:
    """What the two stacks do differently, as measured."""

    request: str  # the message an upload is pulled with
    retry_ns: int
    retry_jitter_ns: int
    give_up_ns: int
    give_up_ack: Ack | None  # None: only a text
    atomic: bool  # the old mission stays until the last item is in
    home_in_slot_0: bool
    wrong_seq: Ack | None
    repeated_last: Ack  # the last item once more, after the transfer
    restart_anywhere: bool  # a second COUNT of the same client restarts at any item, else at the first only
    foreign_count: Ack
    foreign_list: Ack | None  # None: a text only
    client_can_cancel: bool
    downloads_are_transfers: bool  # a download occupies the server until it is acknowledged
    capacity: int
    check: Callable[[Item], Ack]
    stored: Callable[[Item], Item]


class Owner(Protocol):
    """What a mission server needs of its vehicle."""

    def emit(self, name: str, **fields: Any) -> None:
        """Send a message."""

    def text(self, severity: int, text: str) -> None:
        """Send a STATUSTEXT."""

    def home_item(self) -> Item:
        """Slot 0 of an ArduPilot mission."""

    def mission_changed(self, seq: int | None) -> None:
        """Item `seq` was stored, or (None) the list was cut or replaced."""

    def mission_received(self) -> None:
        """An upload is complete."""

    def may_clear(self) -> bool:
        """Whether CLEAR_ALL is obeyed now."""

    def set_current(self, seq: int) -> None:
        """MISSION_SET_CURRENT."""


class MissionServer:
    """Holds the mission of one vehicle and its one transfer."""

    def __init__(self, rules: Rules, owner: Owner, rng: random.Random) -> None:
        self.rules = rules
        self.items: list[Item] = []
        self.state = State.IDLE
        self._owner = owner
        self._rng = rng
        self._client: Client = (0, 0)
        self._count = 0
        self._seq = 0  # the item wanted next, or offered next
        self._staged: list[Item] = []
        self._asked_ns = 0
        self._active_ns = 0
        self._wait_ns = 0

    def receive(self, message: Message, now_ns: int) -> None:
        """Handle one mission message that is addressed to this vehicle."""
        client = (message.get_srcSystem(), message.get_srcComponent())
        name = message.get_type()
        if getattr(message, "mission_type", 0) != 0:  # fence and rally points are not simulated: say so
            if name in ("MISSION_COUNT", "MISSION_REQUEST_LIST", "MISSION_CLEAR_ALL"):
                self._ack(client, Ack.UNSUPPORTED, message.mission_type)
            return
        handler = HANDLERS.get((self.state, name)) or HANDLERS.get((None, name))
        if handler is not None:
            handler(self, message, client, now_ns)

    def step(self, now_ns: int) -> None:
        """Ask again, or give up."""
        if self.state is State.IDLE:
            return
        if now_ns - self._active_ns >= self.rules.give_up_ns:
            sending, self.state = self.state is State.SENDING, State.IDLE
            if self.rules.give_up_ack is not None and not sending:
                self._ack(self._client, self.rules.give_up_ack)
            elif self.rules.give_up_ack is None:
                self._owner.text(2, "Operation timeout")
        elif self.state is State.RECEIVING and now_ns - self._asked_ns >= self._wait_ns:
            self._ask(now_ns)

    @property
    def busy(self) -> bool:
        """Whether a transfer is open."""
        return self.state is not State.IDLE

    def _ack(self, client: Client, result: Ack, mission_type: int = 0) -> None:
        system, component = client
        self._owner.emit(
            "MISSION_ACK",
            target_system=system, target_component=component, type=int(result), mission_type=mission_type,
        )  # fmt: skip

    def _ask(self, now_ns: int) -> None:
        self._asked_ns = now_ns
        jitter = self.rules.retry_jitter_ns
        self._wait_ns = self.rules.retry_ns + (self._rng.randint(-jitter, jitter) if jitter else 0)
        system, component = self._client
        self._owner.emit(
            self.rules.request,
            target_system=system, target_component=component, seq=self._seq, mission_type=0,
        )  # fmt: skip

    # Uploads

    def _open(self, message: Message, client: Client, now_ns: int) -> None:
        if message.count > self.rules.capacity:
            self.state = State.IDLE
            self._ack(client, Ack.NO_SPACE)
            return
        self._client, self._count, self._seq, self._staged = client, message.count, 0, []
        self._active_ns = now_ns
        if not self.rules.atomic and len(self.items) > self._count:
            del self.items[self._count :]
            self._owner.mission_changed(None)
        if self._count == 0:
            self._finish()
        else:
            self.state = State.RECEIVING
            self._ask(now_ns)

    def _count_again(self, message: Message, client: Client, now_ns: int) -> None:
        if client != self._client:
            self._refuse_count(client, self.rules.foreign_count)
        elif self.rules.restart_anywhere or (self.state is State.RECEIVING and self._seq == 0):
            self._open(message, client, now_ns)
        else:
            self._refuse_count(client, Ack.ERROR)

    def _refuse_count(self, client: Client, result: Ack) -> None:
        self._ack(client, result)
        if self.rules.atomic:
            self._owner.text(2, "WPM: IGN MISSION_COUNT: Busy")

    def _item(self, message: Message, client: Client, now_ns: int) -> None:
        if client != self._client:
            self._ack(client, Ack.DENIED if self.rules.home_in_slot_0 else Ack.ERROR)
        elif message.seq != self._seq:
            if self.rules.wrong_seq is not None:
                self._ack(client, self.rules.wrong_seq)
        else:
            item = item_from(message)
            result = Ack.INVALID if item is None else self.rules.check(item)
            if item is None or result is not Ack.ACCEPTED:
                self.state = State.IDLE
                self._ack(client, result)
                return
            self._active_ns = now_ns
            self._store(self.rules.stored(item))
            if self._seq < self._count:
                self._ask(now_ns)
            else:
                self._finish()

    def _store(self, item: Item) -> None:
        seq, self._seq = self._seq, self._seq + 1
        if self.rules.atomic:
            self._staged.append(item)
            return
        self.items[seq : seq + 1] = [item]
        self._owner.mission_changed(seq)

    def _finish(self) -> None:
        self.state = State.IDLE
        if self.rules.atomic:
            self.items = self._staged
        self._ack(self._client, Ack.ACCEPTED)
        self._owner.mission_received()

    def _late_item(self, message: Message, client: Client, now_ns: int) -> None:
        again = client == self._client and self._count > 0 and message.seq + 1 == self._seq == self._count
        self._ack(client, self.rules.repeated_last if again else Ack.ERROR)

    # Downloads

    def _list(self, message: Message, client: Client, now_ns: int) -> None:
        system, component = client
        if self.rules.downloads_are_transfers:
            self.state = State.SENDING
            self._client, self._seq, self._count, self._active_ns = client, 0, len(self.items), now_ns
        self._owner.emit(
            "MISSION_COUNT",
            target_system=system, target_component=component, count=len(self.items), mission_type=0,
        )  # fmt: skip

    def _list_when_busy(self, message: Message, client: Client, now_ns: int) -> None:
        if self.state is State.SENDING and client == self._client:
            self._list(message, client, now_ns)  # rewinds
        elif self.rules.foreign_list is None:
            self._owner.text(2, "WPM: IGN REQUEST LIST: Busy")
        else:
            self._ack(client, self.rules.foreign_list)

    def _request(self, message: Message, client: Client, now_ns: int) -> None:
        if message.seq >= len(self.items):
            self._ack(client, Ack.INVALID_SEQUENCE)
        else:
            self._offer(message, client)

    def _request_in_order(self, message: Message, client: Client, now_ns: int) -> None:
        if client != self._client:
            self._ack(client, Ack.ERROR)
            return
        self._active_ns = now_ns
        if message.seq in (self._seq, self._seq - 1) and message.seq < len(self.items):
            self._seq = message.seq + 1
            self._offer(message, client)
        else:
            self.state = State.IDLE
            self._ack(client, Ack.ERROR)

    def _request_when_busy(self, message: Message, client: Client, now_ns: int) -> None:
        self._ack(client, Ack.DENIED if self.rules.home_in_slot_0 else Ack.ERROR)

    def _request_unlisted(self, message: Message, client: Client, now_ns: int) -> None:
        if self.rules.downloads_are_transfers:
            self._ack(client, Ack.ERROR)
        else:
            self._request(message, client, now_ns)

    def _offer(self, message: Message, client: Client) -> None:
        seq = message.seq
        item = self._owner.home_item() if seq == 0 and self.rules.home_in_slot_0 else self.items[seq]
        fields = item.fields(seq, 1 if seq == 0 and self.rules.atomic else 0)
        name = "MISSION_ITEM_INT"
        if message.get_type() == "MISSION_REQUEST":
            name = "MISSION_ITEM"
            fields["x"], fields["y"] = fields["x"] / 1e7, fields["y"] / 1e7
        system, component = client
        self._owner.emit(name, target_system=system, target_component=component, mission_type=0, **fields)

    # The rest

    def _acked(self, message: Message, client: Client, now_ns: int) -> None:
        if client == self._client and (self.state is State.SENDING or self.rules.client_can_cancel):
            self.state = State.IDLE

    def _clear(self, message: Message, client: Client, now_ns: int) -> None:
        if self.busy or not self._owner.may_clear():
            self._ack(client, Ack.ERROR)
            return
        self.items = []
        self._ack(client, Ack.ACCEPTED)
        self._owner.mission_changed(None)

    def _set_current(self, message: Message, client: Client, now_ns: int) -> None:
        if self.busy and self.rules.downloads_are_transfers:
            self._owner.text(2, "WPM: IGN WP CURR CMD: Busy")
        else:
            self._owner.set_current(message.seq)

    def _partial(self, message: Message, client: Client, now_ns: int) -> None:
        self._ack(client, Ack.UNSUPPORTED)


Handler = Callable[[MissionServer, Message, Client, int], None]
_S = MissionServer
# Private to this file: the table is the class's own dispatch, kept beside it to be read as a whole.
HANDLERS: dict[tuple[State | None, str], Handler] = {
    (State.IDLE, "MISSION_COUNT"): _S._open,
    (None, "MISSION_COUNT"): _S._count_again,
    (State.RECEIVING, "MISSION_ITEM_INT"): _S._item,
    (State.RECEIVING, "MISSION_ITEM"): _S._item,
    (None, "MISSION_ITEM_INT"): _S._late_item,
    (None, "MISSION_ITEM"): _S._late_item,
    (State.IDLE, "MISSION_REQUEST_LIST"): _S._list,
    (None, "MISSION_REQUEST_LIST"): _S._list_when_busy,
    (State.IDLE, "MISSION_REQUEST_INT"): _S._request_unlisted,
    (State.IDLE, "MISSION_REQUEST"): _S._request_unlisted,
    (State.SENDING, "MISSION_REQUEST_INT"): _S._request_in_order,
    (State.SENDING, "MISSION_REQUEST"): _S._request_in_order,
    (State.RECEIVING, "MISSION_REQUEST_INT"): _S._request_when_busy,
    (State.RECEIVING, "MISSION_REQUEST"): _S._request_when_busy,
    (None, "MISSION_ACK"): _S._acked,
    (None, "MISSION_CLEAR_ALL"): _S._clear,
    (None, "MISSION_SET_CURRENT"): _S._set_current,
    (None, "MISSION_WRITE_PARTIAL_LIST"): _S._partial,
    (None, "MISSION_REQUEST_PARTIAL_LIST"): _S._partial,
}
