"""A small scripted mission server and a bad link, for the tests of the mission client: typed messages, fake clock."""

from __future__ import annotations

import heapq
import random
from dataclasses import dataclass, field

from gatar_edge.bridge import wire
from gatar_edge.bridge.dialect import MissionResult
from gatar_edge.types import NS_PER_S

ME: wire.Address = (7, 191)
VEHICLE: wire.Address = (7, 1)
MS = 1_000_000


@dataclass
class Lossy:
    """One direction of a link: loss, duplicates, and a delay that reorders."""

    rng: random.Random
    loss: float = 0.0
    duplicate: float = 0.0
    max_delay_ms: int = 0
    queue: list[tuple[int, int, object]] = field(default_factory=list)
    sent: int = 0

    def put(self, message: object, now_ns: int) -> None:
        for _ in range(2 if self.rng.random() < self.duplicate else 1):
            if self.rng.random() >= self.loss:
                self.sent += 1
                due = now_ns + int(self.rng.random() * self.max_delay_ms) * MS
                heapq.heappush(self.queue, (due, self.sent, message))

    def get(self, now_ns: int) -> list[object]:
        out = []
        while self.queue and self.queue[0][0] <= now_ns:
            out.append(heapq.heappop(self.queue)[2])
        return out


class Server:
    """A mission server. `ardupilot`: truncates at COUNT and stores as items come, re-requests each second, gives up
    after 8 s with OPERATION_CANCELLED, answers a wrong sequence with INVALID_SEQUENCE and overwrites slot 0.
    Else as PX4: stores at the end, re-requests each 250 ms, gives up after 5 s and says nothing."""

    def __init__(self, ardupilot: bool) -> None:
        self.ardupilot = ardupilot
        self.board: list[wire.MissionItem] = []
        self.new: list[wire.MissionItem] = []
        self.count = -1  # of the open upload, -1 when none
        self.last_item_ns = self.asked_ns = 0
        self.sending = -1  # next item of the open download
        self.out: list[object] = []

    def _ack(self, result: MissionResult) -> None:
        self.out.append(wire.MissionAck(ME, result))

    def _ask(self, now_ns: int) -> None:
        self.asked_ns = now_ns
        self.out.append(wire.MissionRequest(ME, len(self.new)))

    def tick(self, now_ns: int) -> None:
        if self.count < 0:
            return
        if now_ns - self.last_item_ns >= (8 if self.ardupilot else 5) * NS_PER_S:
            self.count = -1
            if self.ardupilot:
                self._ack(MissionResult.OPERATION_CANCELLED)
        elif now_ns - self.asked_ns >= (1000 if self.ardupilot else 250) * MS:
            self._ask(now_ns)

    def receive(self, message: object, now_ns: int) -> None:
        match message:
            case wire.MissionCount():
                self._on_count(message, now_ns)
            case wire.MissionItemAt():
                self._on_item(message, now_ns)
            case wire.MissionRequestList():
                if self.count >= 0:
                    if self.ardupilot:
                        self._ack(MissionResult.DENIED)
                else:
                    self.sending = 0
                    self.out.append(wire.MissionCount(ME, len(self.board)))
            case wire.MissionRequest():
                self._on_request(message)
            case wire.MissionAck():
                self.sending = -1
                if not self.ardupilot and message.result == MissionResult.OPERATION_CANCELLED:
                    self.count = -1
            case wire.MissionClearAll():
                self.board = []
                self._ack(MissionResult.ACCEPTED)

    def _on_count(self, message: wire.MissionCount, now_ns: int) -> None:
        if not self.ardupilot and self.count >= 0 and self.new:
            self._ack(MissionResult.ERROR)
            return
        self.count, self.new, self.last_item_ns = message.count, [], now_ns
        if self.ardupilot:
            self.board = self.board[: message.count]
        self._ask(now_ns)

    def _on_item(self, message: wire.MissionItemAt, now_ns: int) -> None:
        if self.count < 0:
            late = not self.ardupilot and message.seq == len(self.board) - 1
            self._ack(MissionResult.ACCEPTED if late else MissionResult.ERROR)
            return
        if message.seq != len(self.new):
            if self.ardupilot:
                self._ack(MissionResult.INVALID_SEQUENCE)
            return
        self.new.append(message.item)
        self.last_item_ns = now_ns
        if self.ardupilot:
            stored = wire.MissionItem(0, 16, (0, 0, 0, 0), 1, 2, 0.14) if message.seq == 0 else message.item
            self.board[message.seq : message.seq + 1] = [stored]
        if len(self.new) < self.count:
            self._ask(now_ns)
            return
        self.count = -1
        if not self.ardupilot:
            self.board = self.new
        self._ack(MissionResult.ACCEPTED)

    def _on_request(self, message: wire.MissionRequest) -> None:
        if self.ardupilot or message.seq in (self.sending, self.sending - 1):
            if message.seq < len(self.board):
                self.out.append(wire.MissionItemAt(ME, message.seq, self.board[message.seq]))
            else:
                self._ack(MissionResult.ERROR)
            self.sending = max(self.sending, message.seq + 1)
        else:
            self.sending = -1
            self._ack(MissionResult.ERROR)
