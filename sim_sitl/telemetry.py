"""When each of the messages that a simulated autopilot sends by itself is due."""

from __future__ import annotations

import math

from gatar_edge.sim_sitl.core import Core
from gatar_edge.sim_sitl.streams import Stream
from gatar_edge.sim_sitl.wire import Send
from gatar_edge.types import NS_PER_S

_MIN_INTERVAL_NS = 20_000_000  # faster is not simulated
_NEVER_NS = 1 << 62


class Telemetry:
    """The streams of one vehicle and when each is due."""

    def __init__(self, core: Core, table: dict[int, Stream]) -> None:
        self._core = core
        self._table = table
        self._interval_ns: dict[int, int] = {}
        self._due_ns: dict[int, int] = {}
        self._next_ns = 0
        for message_id in table:
            self.set_interval(message_id, 0)

    def knows(self, message_id: int) -> bool:
        """Whether the message can be streamed or requested."""
        return message_id in self._table

    def interval_us(self, message_id: int) -> int:
        """As MESSAGE_INTERVAL says it: -1 is off."""
        interval = self._interval_ns[message_id]
        return -1 if interval >= _NEVER_NS else interval // 1000

    def set_interval(self, message_id: int, interval_us: float) -> bool:
        """MAV_CMD_SET_MESSAGE_INTERVAL: 0 is the default, below 0 is off. False where there is nothing to set."""
        stream = self._table.get(message_id)
        if stream is None or not math.isfinite(interval_us) or (stream.fixed and interval_us):
            return False
        hz = stream.default_hz
        if interval_us < 0 or (interval_us == 0 and hz == 0):
            interval = _NEVER_NS
        elif interval_us == 0:
            interval = int(NS_PER_S / hz)
        else:
            interval = max(_MIN_INTERVAL_NS, int(min(interval_us, 1e9) * 1000))
        self._interval_ns[message_id] = interval
        self._due_ns[message_id] = _NEVER_NS if interval >= _NEVER_NS else self._core.now_ns + interval
        self._next_ns = min(self._due_ns.values())
        return True

    def send(self, message_id: int) -> bool:
        """Send one message now; False where it has nothing to say."""
        stream = self._table[message_id]
        fields = stream.fill(self._core)
        if fields is not None:
            self._core.queue(Send(stream.name, fields))
        return fields is not None

    def step(self, now_ns: int) -> None:
        """Send all that is due; after a long pause each message once, not for each interval missed."""
        if now_ns < self._next_ns:
            return
        for message_id, due_ns in self._due_ns.items():
            if now_ns >= due_ns:
                self.send(message_id)
                interval = self._interval_ns[message_id]
                after_ns = due_ns + interval
                self._due_ns[message_id] = after_ns if after_ns > now_ns else now_ns + interval
        self._next_ns = min(self._due_ns.values())
