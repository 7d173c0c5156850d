"""TCP connections for a loop that must not wait: only the very first one is waited for."""

from __future__ import annotations

import socket
from collections.abc import Callable
from typing import Any

CONNECT_S = 3.0
GONE_S = 5.0  # a far end that does not answer for this long, before or after the connection is made, is gone


def connections(host: str, port: int) -> Callable[[], socket.socket]:
    """Connect, and give what returns that connection first, later new ones to the same address. Raises OSError."""
    first = socket.create_connection((host, port), timeout=CONNECT_S)
    family, address = first.family, first.getpeername()
    made = [_tuned(first)]
    return lambda: made.pop() if made else _connecting(family, address)


def _connecting(family: int, address: Any) -> socket.socket:
    """A connection in the making. Until it is made it neither takes nor gives bytes; if it fails, it breaks."""
    connection = _tuned(socket.socket(family, socket.SOCK_STREAM))
    try:
        connection.connect(address)
    except BlockingIOError:
        pass
    except OSError:
        connection.close()
        raise
    return connection


def _tuned(connection: socket.socket) -> socket.socket:
    connection.setblocking(False)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    if hasattr(socket, "TCP_USER_TIMEOUT"):  # where it is not, the system takes minutes to notice
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, round(GONE_S * 1000))
    return connection
