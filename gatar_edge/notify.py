"""Being watched by the service manager: sd_notify(3)."""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Callable, Mapping

from gatar_edge.health import Snapshot
from gatar_edge.types import NS_PER_S

STATUS_NS = NS_PER_S


class Notifier:
    """sd_notify(3): READY=1 after the first tick, WATCHDOG=1 with each, STATUS= once a second; silent elsewhere."""

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        address = environment.get("NOTIFY_SOCKET", "")
        self._address = "\0" + address[1:] if address.startswith("@") else address  # @: an abstract socket
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) if address else None
        if self._socket is not None:
            self._socket.setblocking(False)  # a manager that does not read must not hold up the robot
        self._ready = False
        self._status_ns: int | None = None

    def published(self, t_ns: int, snapshot: Callable[[], Snapshot]) -> None:
        """Tell the service manager that a tick has been done."""
        lines = ["WATCHDOG=1"]
        if not self._ready:
            lines.append("READY=1")
            self._ready = True
        if self._status_ns is None or t_ns - self._status_ns >= STATUS_NS:
            lines.append("STATUS=" + snapshot().line)
            self._status_ns = t_ns
        self._send(lines)

    def stopping(self) -> None:
        """Tell that the end has begun."""
        self._send(["STOPPING=1", "STATUS=stopping"])

    def close(self) -> None:
        """Give the socket back."""
        if self._socket is not None:
            self._socket.close()

    def _send(self, lines: list[str]) -> None:
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.sendto("\n".join(lines).encode(), self._address)
