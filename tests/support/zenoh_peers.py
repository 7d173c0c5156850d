"""What the tests of Zenoh share."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable

TIMEOUT_S = 30


def endpoint(protocol: str = "tcp") -> str:
    """A free one on this machine."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"{protocol}/127.0.0.1:{probe.getsockname()[1]}"


def until(condition: Callable[[], bool]) -> None:
    """Wait for other threads; far longer than it ever takes before it counts as failed."""
    end_s = time.monotonic() + TIMEOUT_S
    while not condition():
        assert time.monotonic() < end_s, "nothing happened"
        time.sleep(0.005)
