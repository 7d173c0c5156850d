"""A limit on what one robot puts on the air: own messages first, relays give way, never exceeded.

A token bucket in whole byte-nanoseconds. It holds `burst_bytes` and is filled with `bytes_per_s - burst_bytes` a
second, so that no second, wherever it begins, sees more than `bytes_per_s`; what can be sent for ever is the filling.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from gatar_edge.errors import ConfigError
from gatar_edge.types import NS_PER_S

RESERVE_BYTES = 128  # that relays leave for the next own message


@dataclass(slots=True)
class BudgetCounters:
    """Messages and bytes since the start; a message to several peers counts once, its bytes for each."""

    own_sent: int = 0
    own_dropped: int = 0
    relays_sent: int = 0
    relays_dropped: int = 0
    bytes_sent: int = 0


class ByteBudget:
    """Decides which messages of a tick may be sent; `sends` is the transport's datagrams per message.

    `burst_bytes` (a fifth of the budget, one tick's share at 5 Hz, where not given) is the most that leaves at once.
    Raises ConfigError where the budget is too small for an own message and a relay.
    """

    def __init__(self, bytes_per_s: int, burst_bytes: int | None = None, sends: int = 1) -> None:
        self.counters = BudgetCounters()
        self._sends = max(1, sends)
        self._reserve = RESERVE_BYTES * self._sends * NS_PER_S
        message = RESERVE_BYTES * self._sends
        smallest = 3 * message  # an own message, a relay and the reserve: else no relay could ever leave
        burst = max(bytes_per_s // 5, smallest) if burst_bytes is None else burst_bytes
        if burst < smallest or bytes_per_s < burst + message:
            raise ConfigError(
                f"a budget of {bytes_per_s} bytes/s with bursts of {burst} is too small: where one message makes "
                f"{self._sends} datagrams, bursts must be >= {smallest}, and the budget {message} more than the bursts"
            )
        self._rate = bytes_per_s - burst
        self._full = burst * NS_PER_S
        self._tokens = self._full
        self._filled_ns: int | None = None
        self._turn = 0

    def admit(self, own: Sequence[bytes], relays: Sequence[bytes], now_ns: int) -> list[bytes]:
        """The messages that may be sent at `now_ns`, own ones first; the rest is dropped and counted.

        Where only some relays fit, the turn goes round, so that no author is dropped for ever.
        """
        self._fill(now_ns)
        own_sent = [data for data in own if self._take(data, 0)]
        start = self._turn % len(relays) if relays else 0
        relays_sent = [data for data in (*relays[start:], *relays[:start]) if self._take(data, self._reserve)]
        self._turn = 0 if len(relays_sent) == len(relays) else start + len(relays_sent)
        self.counters.own_sent += len(own_sent)
        self.counters.own_dropped += len(own) - len(own_sent)
        self.counters.relays_sent += len(relays_sent)
        self.counters.relays_dropped += len(relays) - len(relays_sent)
        return own_sent + relays_sent

    def _fill(self, now_ns: int) -> None:
        if self._filled_ns is None or now_ns > self._filled_ns:
            passed_ns = 0 if self._filled_ns is None else now_ns - self._filled_ns
            self._tokens = min(self._full, self._tokens + passed_ns * self._rate)
            self._filled_ns = now_ns

    def _take(self, data: bytes, reserve: int) -> bool:
        size = len(data) * self._sends
        if self._tokens - size * NS_PER_S < reserve:
            return False
        self._tokens -= size * NS_PER_S
        self.counters.bytes_sent += size
        return True
