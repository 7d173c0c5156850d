"""Message rates: asked for, counted, and asked for again where they fall short: a ground station may change them.

SET_MESSAGE_INTERVAL's acknowledgement does not say for which message it is, and does not prove anything: only the
messages that arrive do. So nothing here waits for one.
"""

from __future__ import annotations

from collections.abc import Sequence

from gatar_edge.bridge.dialect import Command, MessageId
from gatar_edge.bridge.wire import Address, CommandLong, Message
from gatar_edge.types import NS_PER_S

WANTED_HZ: dict[int, float] = {
    MessageId.GLOBAL_POSITION_INT: 5.0,
    MessageId.MISSION_CURRENT: 2.0,
    MessageId.POSITION_TARGET_GLOBAL_INT: 2.0,
    MessageId.EXTENDED_SYS_STATE: 1.0,
    MessageId.SYS_STATUS: 0.5,
}
WINDOW_NS = 10 * NS_PER_S
ENOUGH = 0.8  # of the wanted rate
# less is short; PX4 tells its current item once a second, whatever is asked for
ENOUGH_HZ = {**{i: ENOUGH * hz for i, hz in WANTED_HZ.items()}, MessageId.MISSION_CURRENT: ENOUGH * 1.0}
ONCE_RETRY_NS = NS_PER_S


class RateWatch:
    """Keeps one autopilot telling what is needed, and asks for its home and origin until they are known."""

    def __init__(self, vehicle: Address, now_ns: int) -> None:
        self._vehicle = vehicle
        self._counts = dict.fromkeys(WANTED_HZ, 0)
        self._window_ns = now_ns
        self._once_asked_ns = now_ns - ONCE_RETRY_NS
        self._short: list[int] = list(WANTED_HZ)

    def count(self, message_id: int) -> None:
        """Take note of a message from the autopilot."""
        if message_id in self._counts:
            self._counts[message_id] += 1

    def due_ns(self, unknown: Sequence[int]) -> int:
        """When `poll` has something to do again."""
        if self._short:
            return 0
        window_ns = self._window_ns + WINDOW_NS
        return min(window_ns, self._once_asked_ns + ONCE_RETRY_NS) if unknown else window_ns

    def poll(self, unknown: Sequence[int], now_ns: int) -> tuple[list[Message], list[int]]:
        """Messages to send now, and the ids whose rate had fallen short; `unknown` ids are needed once.

        A target is told while there is one alone, so few of them prove nothing: it is asked for without a word.
        """
        out: list[Message] = []
        short: list[int] = []
        if now_ns - self._window_ns >= WINDOW_NS:
            window_s = (now_ns - self._window_ns) / NS_PER_S
            short = [i for i, n in self._counts.items() if n < ENOUGH_HZ[i] * window_s]
            self._short += short
            short = [i for i in short if i != MessageId.POSITION_TARGET_GLOBAL_INT]
            self._counts = dict.fromkeys(WANTED_HZ, 0)
            self._window_ns = now_ns
        if self._short:
            out += [self._long(Command.SET_MESSAGE_INTERVAL, i, 1e6 / WANTED_HZ[i]) for i in self._short]
            self._short = []
        if unknown and now_ns - self._once_asked_ns >= ONCE_RETRY_NS:
            self._once_asked_ns = now_ns
            out += [self._long(Command.REQUEST_MESSAGE, i, 0.0) for i in unknown]
        return out, short

    def _long(self, command: int, p1: float, p2: float) -> CommandLong:
        return CommandLong(self._vehicle, command, (p1, p2, 0.0, 0.0, 0.0, 0.0, 0.0))
