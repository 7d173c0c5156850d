"""Neighbour messages over Zenoh (the extra `zenoh`): beyond one subnet, through routers, with mTLS where configured.

No multicast discovery: endpoints are explicit, and robots that know one robot learn of the others from it; those that
cannot reach each other need a Zenoh router. A peer whose certificate is refused is silent in Zenoh, so each
robot holds a liveliness token and `problem` says when endpoints are configured and nobody is there.
"""

from __future__ import annotations

import contextlib
import json
import socket
from collections import deque
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from gatar_edge.errors import ConfigError, LinkError, MissingExtraError
from gatar_edge.transports.base import MAX_DATAGRAM_BYTES, MAX_DATAGRAMS_PER_RECEIVE, LinkCounters

KEY = "gatar/neighbours"
ALIVE = "gatar/alive"
MAX_CONFIG_BYTES = 1_000_000
# Reconnects within half a second instead of four (measured, see docs/adr).
_RETRY = {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 1.5}


class ZenohTransport:
    """A `Transport` on one Zenoh session.

    `listen` and `peers` are endpoints such as "tcp/10.0.0.3:7447" or "tls/..."; an empty `listen` only connects.
    `config` names a Zenoh configuration file (JSON5) for certificates and access control. Raises MissingExtraError,
    ConfigError for a file that Zenoh refuses, LinkError for an endpoint that cannot be opened.
    """

    sends = 1

    def __init__(self, robot_id: int, listen: str, peers: Sequence[str] = (), config: Path | None = None) -> None:
        try:
            import zenoh
        except ImportError:
            raise MissingExtraError("net.transport = 'zenoh'", "zenoh", "eclipse-zenoh") from None
        self.counters = LinkCounters()
        self._expects_peers = bool(peers)
        self._alive: set[str] = set()
        self._arrived: deque[bytes] = deque(maxlen=MAX_DATAGRAMS_PER_RECEIVE)
        settings = _settings(zenoh, listen, peers, config)
        try:
            self._session: Any = zenoh.open(settings)
        except zenoh.ZError as error:
            raise LinkError(f"zenoh cannot open {listen or peers}: {error}; check net.listen and net.peers") from error
        self._wake, self._woken = socket.socketpair()
        self._wake.setblocking(False)
        self._woken.setblocking(False)
        self._deleted = zenoh.SampleKind.DELETE
        own = f"{ALIVE}/{robot_id}"
        self._publisher = self._session.declare_publisher(
            KEY,
            congestion_control=zenoh.CongestionControl.DROP,  # a late message is worth nothing
            priority=zenoh.Priority.REAL_TIME,
            express=True,
            allowed_destination=zenoh.Locality.REMOTE,
        )
        self._keep = (
            self._session.declare_subscriber(KEY, self._on_sample, allowed_origin=zenoh.Locality.REMOTE),
            self._session.liveliness().declare_token(own),
            self._session.liveliness().declare_subscriber(
                f"{ALIVE}/*", lambda sample: self._on_alive(str(sample.key_expr), own, sample.kind), history=True
            ),
        )

    @property
    def alive(self) -> int:
        """Other robots whose session is up, as Zenoh knows."""
        return len(self._alive)

    @property
    def problem(self) -> str:
        """What is wrong, or empty: a refused certificate or key shows as nobody being there."""
        if self._expects_peers and not self._alive:
            return (
                "zenoh: none of net.peers is there, or they refuse this robot (check certificates and access control)"
            )
        return ""

    def send(self, data: bytes) -> None:
        """Publish one datagram; failures are counted."""
        try:
            self._publisher.put(data)
        except Exception:  # ZError, or the session was closed: a robot that cannot talk goes on alone
            self.counters.send_errors += 1
        else:
            self.counters.sent += 1
            self.counters.sent_bytes += len(data)

    def receive(self) -> list[bytes]:
        """The datagrams that have come, without waiting."""
        with contextlib.suppress(OSError):
            self._woken.recv(4096)
        received: list[bytes] = []
        while self._arrived and len(received) < MAX_DATAGRAMS_PER_RECEIVE:
            received.append(self._arrived.popleft())
        self.counters.received += len(received)
        self.counters.received_bytes += sum(map(len, received))
        return received

    def fileno(self) -> int:
        """A socket that becomes readable when something has come."""
        return self._woken.fileno()

    def close(self) -> None:
        """Close the session."""
        with contextlib.suppress(Exception):  # closing twice, or after the network went
            self._session.close()
        self._wake.close()
        self._woken.close()

    # called by Zenoh's own threads

    def _on_sample(self, sample: Any) -> None:
        payload = sample.payload
        if len(payload) > MAX_DATAGRAM_BYTES:
            self.counters.too_long += 1
            return
        self._arrived.append(payload.to_bytes())
        with contextlib.suppress(OSError):  # full: the loop is to be woken already
            self._wake.send(b"\0")

    def _on_alive(self, key: str, own: str, kind: Any) -> None:
        if key == own:
            return
        if kind == self._deleted:
            self._alive.discard(key)
        else:
            self._alive.add(key)


def _settings(zenoh: Any, listen: str, peers: Sequence[str], file: Path | None) -> Any:
    """Zenoh's configuration: the file's, then ours on top."""
    try:
        config = zenoh.Config() if file is None else zenoh.Config.from_json5(_read(file))
        for path, value in {
            "mode": "peer",
            "scouting/multicast/enabled": False,
            "connect/exit_on_failure": False,
            "connect/timeout_ms": -1,
            "connect/retry": _RETRY,
            "connect/endpoints": list(peers),
            "listen/endpoints": [listen] if listen else [],
        }.items():
            config.insert_json5(path, json.dumps(value))
    except zenoh.ZError as error:
        raise ConfigError(f"zenoh refuses its configuration {file or 'in [net]'}: {error}") from error
    return config


def _read(file: Path) -> str:
    try:
        with file.open("rb") as source:
            return source.read(MAX_CONFIG_BYTES).decode()
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"net.zenoh_config {file} cannot be read: {error}") from error
