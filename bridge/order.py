"""The frames of one source in the order in which it sent them, told from the one byte that numbers them."""

from __future__ import annotations

from gatar_edge.types import NS_PER_S

REORDERED_NS = 2 * NS_PER_S  # a frame numbered before one this young was overtaken; later it is a rebooted vehicle's


class Order:
    """Numbers frames on beyond 255. Tell it every frame: an autopilot sends hundreds between two heartbeats."""

    def __init__(self) -> None:
        self._newest = 0
        self._newest_ns = -REORDERED_NS

    def number(self, seq: int, now_ns: int) -> int:
        """The number of a frame: above all before it, or, where newer frames overtook it, among theirs."""
        ahead = (seq - self._newest) % 256
        if ahead > 128 and now_ns - self._newest_ns < REORDERED_NS:
            return self._newest + ahead - 256
        self._newest, self._newest_ns = self._newest + ahead, now_ns
        return self._newest
