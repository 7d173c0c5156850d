"""Real time: autopilots reached over UDP by real ground stations, and by daemons as separate processes."""

from __future__ import annotations

import socket
import time
from collections.abc import Iterable, Iterator

from gatar_edge.errors import LinkError

MAX_CLIENTS = 64
MAX_DATAGRAMS = 512  # read at once
MAX_BYTES = 2048
MAX_DATAGRAM = 1024  # sent


def parse_address(text: str, default_host: str = "127.0.0.1") -> tuple[str, int]:
    """Host and port of `udp:host:port`, `host:port` or `port`. Raises LinkError."""
    host, _, port = text.removeprefix("udp:").rpartition(":")
    if not port.isascii() or not port.isdigit() or not 0 <= int(port) <= 65535:
        raise LinkError(f"address {text!r} is not of the form udp:127.0.0.1:14550")
    return host or default_host, int(port)


class UdpSocket:
    """A UDP socket that never blocks and never fails; `send` tells everybody who ever wrote to it."""

    def __init__(self, listen: str) -> None:
        address = parse_address(listen)
        self._clients: dict[tuple[str, int], None] = {}
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.bind(address)
        except OSError as error:
            self._socket.close()
            raise LinkError(
                f"cannot listen on {address[0]}:{address[1]}: {error.strerror}; give another port"
            ) from error

    @property
    def clients(self) -> int:
        """How many have written so far."""
        return len(self._clients)

    @property
    def port(self) -> int:
        """Where it listens."""
        return int(self._socket.getsockname()[1])

    def send(self, data: bytes) -> None:
        """Tell every client; one that is gone costs nothing."""
        self.send_datagrams(datagrams_of(data) if self._clients else ())

    def send_datagrams(self, datagrams: Iterable[bytes]) -> None:
        """Tell every client, in pieces of the caller's, which may be damaged frames."""
        for datagram in datagrams:
            for client in self._clients:
                self._send(datagram, client)

    def send_to(self, data: bytes, address: tuple[str, int]) -> None:
        """Tell one address."""
        self._send(data, address)

    def receive(self) -> list[tuple[bytes, tuple[str, int]]]:
        """All datagrams that have come in, each with its sender."""
        datagrams: list[tuple[bytes, tuple[str, int]]] = []
        for _ in range(MAX_DATAGRAMS):
            try:
                data, sender = self._socket.recvfrom(MAX_BYTES)
            except BlockingIOError:
                break
            except OSError:  # an answer "port unreachable" to something sent earlier
                continue
            if len(self._clients) < MAX_CLIENTS:
                self._clients[sender] = None
            datagrams.append((data, sender))
        return datagrams

    def close(self) -> None:
        """Release the port."""
        self._socket.close()

    def _send(self, data: bytes, address: tuple[str, int]) -> None:
        try:
            self._socket.sendto(data, address)
        except OSError:
            return


class Gateway:
    """The fleet's door for ground stations: `fleet.Gateway` over one socket."""

    def __init__(self, socket_: UdpSocket) -> None:
        self._socket = socket_

    def send(self, data: bytes) -> None:
        """Tell every ground station."""
        self._socket.send(data)

    def receive(self) -> list[bytes]:
        """What ground stations said."""
        return [data for data, _ in self._socket.receive()]


def datagrams_of(stream: bytes) -> Iterator[bytes]:
    """Whole MAVLink 2 frames, as many as fit into one datagram: clients expect no frame to span two."""
    start = end = 0
    while end < len(stream):
        signed = stream[end + 2] & 1
        length = stream[end + 1] + 12 + 13 * signed  # header, checksum, signature
        if end + length - start > MAX_DATAGRAM:
            yield stream[start:end]
            start = end
        end += length
    if end > start:
        yield stream[start:end]


def paced(slice_s: float, speed: float) -> Iterator[int]:
    """Simulated times in nanoseconds, one slice apart, `speed` times as fast as the wall clock."""
    start_s, slices = time.monotonic(), 0
    while True:
        yield int(slices * slice_s * 1e9)
        slices += 1
        ahead_s = start_s + slices * slice_s / speed - time.monotonic()
        if ahead_s > 0:
            time.sleep(ahead_s)
