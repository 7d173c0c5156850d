"""Our own heartbeat: it says how the robot is, and falls silent for good reason."""

from __future__ import annotations

from math import ceil

from gatar_edge.bridge import dialect, wire
from gatar_edge.types import NS_PER_S


class Heart:
    """Beats as often as configured; critical for too long, not at all: then the vehicle's own failsafe acts."""

    def __init__(self, rate_hz: float, critical_s: float, now_ns: int) -> None:
        self.critical = False
        self._period_ns = NS_PER_S / rate_hz
        self._critical_limit_ns = critical_s * NS_PER_S
        self._critical_ns: int | None = None  # since when
        self._beat_ns = now_ns - round(self._period_ns)

    @property
    def due_ns(self) -> int:
        """When `poll` has something to do again."""
        return 0 if self.critical or self._critical_ns is not None else self._beat_ns + ceil(self._period_ns)

    def poll(self, now_ns: int) -> list[wire.Message]:
        """The heartbeat, where one is due."""
        if not self.critical:
            self._critical_ns = None
        elif self._critical_ns is None:
            self._critical_ns = now_ns
        if self._critical_ns is not None and now_ns - self._critical_ns > self._critical_limit_ns:
            return []
        if now_ns - self._beat_ns < self._period_ns:
            return []
        self._beat_ns = now_ns
        state = dialect.STATE_CRITICAL if self.critical else dialect.STATE_ACTIVE
        return [wire.Heartbeat(dialect.TYPE_ONBOARD_CONTROLLER, dialect.AUTOPILOT_INVALID, 0, 0, state)]
