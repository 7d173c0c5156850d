"""Links to vehicles: UDP, TCP and serial, non-blocking, by URL. Bytes only; the codec knows what they mean.

    udpin:HOST:PORT     listen; several vehicles may speak, each is answered where its autopilot spoke from last
    udpout:HOST:PORT    speak first, to one address
    tcp:HOST:PORT       connect; lost connections are opened again, at most once a second, without waiting for them
    serial:DEVICE[:BAUD]  needs pyserial; 57600 baud unless told

Opening raises `LinkError` with one line; after that nothing raises: what cannot be sent now is dropped, as a radio
would.
"""

from __future__ import annotations

import contextlib
import errno
import importlib
import socket
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from types import TracebackType
from typing import Any

from gatar_edge.bridge import tcp
from gatar_edge.bridge.framing import datagrams, sender
from gatar_edge.errors import LinkError, MissingExtraError

MAX_READS = 256  # in one `receive`, so that a flood cannot keep the loop
READ_BYTES = 65536
RECONNECT_S = 1.0
DEFAULT_BAUD = 57600
AUTOPILOT_COMPID = 1  # MAV_COMP_ID_AUTOPILOT1


class Link(ABC):
    """One open link. `close` it, or use it in a `with`."""

    url: str

    @abstractmethod
    def receive(self) -> list[bytes]:
        """What has arrived, without waiting."""

    @abstractmethod
    def send(self, data: bytes, sysid: int | None = None) -> bool:
        """Send frames, on a link of several vehicles to the one of this system id. False: dropped."""

    @abstractmethod
    def fileno(self) -> int:
        """What `select` waits on until `receive` has something; -1 while there is no connection."""

    @abstractmethod
    def close(self) -> None:
        """Free the port."""

    def __enter__(self) -> Link:
        """Give the link itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close it."""
        self.close()


class UdpLink(Link):
    """A UDP socket that listens (`peer` None) or speaks to one address."""

    def __init__(self, url: str, host: str, port: int, *, listen: bool) -> None:
        self.url = url
        self.peers: dict[int, Any] = {}  # system id -> the address it spoke from last, its autopilot if that was heard
        self._autopilots: set[int] = set()
        try:
            family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
            self._socket = socket.socket(family, socket.SOCK_DGRAM)
        except OSError as error:
            raise _cannot_open(url, error) from None
        self._peer: Any = None if listen else address
        try:
            self._socket.setblocking(False)
            if listen:
                self._socket.bind(address)
        except OSError as error:
            self._socket.close()
            raise _cannot_open(url, error) from None

    def receive(self) -> list[bytes]:
        """All datagrams that wait, and note who sent them."""
        out: list[bytes] = []
        for _ in range(MAX_READS):
            try:
                data, address = self._socket.recvfrom(READ_BYTES)
            except BlockingIOError:
                break
            except OSError:  # an ICMP refusal of something sent before
                continue
            self._note(sender(data), address)
            out.append(data)
        return out

    def _note(self, source: tuple[int, int] | None, address: Any) -> None:
        """Where a system speaks from. A camera of its own address must not draw the autopilot's commands to it."""
        if source is None:
            return
        system, component = source
        if component == AUTOPILOT_COMPID:
            self._autopilots.add(system)
        if component == AUTOPILOT_COMPID or system not in self._autopilots:
            self.peers[system] = address

    def send(self, data: bytes, sysid: int | None = None) -> bool:
        """Send to the one address, or to where `sysid` spoke from; with no `sysid` to the only vehicle there is."""
        address = self._peer
        if address is None and sysid is not None:
            address = self.peers.get(sysid)
        elif address is None and len(self.peers) == 1:
            address = next(iter(self.peers.values()))
        if address is None:
            return False
        try:
            for datagram in datagrams(data):
                self._socket.sendto(datagram, address)
        except OSError:
            return False
        return True

    def fileno(self) -> int:
        """The socket."""
        return self._socket.fileno()

    def close(self) -> None:
        """Free the port."""
        self._socket.close()


class StreamLink(Link):
    """A TCP connection or a serial port, opened again when it breaks."""

    def __init__(self, url: str, connect: Callable[[], Any], clock: Callable[[], float] = time.monotonic) -> None:
        """`connect` does not wait: what it returns may still be connecting, and breaks if that fails."""
        self.url = url
        self._connect, self._clock = connect, clock
        self._port: Any = None
        self._tried_s = clock()
        try:
            self._port = connect()
        except OSError as error:
            raise _cannot_open(url, error) from None

    def receive(self) -> list[bytes]:
        """What has arrived; a broken connection is tried again."""
        port = self._alive()
        if port is None:
            return []
        try:
            data: bytes = port.recv(READ_BYTES)
        except BlockingIOError:
            return []
        except OSError:
            data = b""
        if not data:
            self._drop()
        return [data] if data else []

    def send(self, data: bytes, sysid: int | None = None) -> bool:
        """Send all of it or, where the buffer is full, drop the rest: the frames' checksums tell."""
        del sysid  # a stream has one far end
        port = self._alive()
        if port is None or not data:
            return False
        try:
            return bool(port.send(data) == len(data))
        except BlockingIOError:
            return False
        except OSError:
            self._drop()
            return False

    def fileno(self) -> int:
        """The connection; another one after it broke."""
        return -1 if self._port is None else int(self._port.fileno())

    def close(self) -> None:
        """Free the port; it is not opened again."""
        self._tried_s = float("inf")
        self._drop()

    def _drop(self) -> None:
        if self._port is not None:
            with contextlib.suppress(OSError):
                self._port.close()
            self._port = None

    def _alive(self) -> Any:
        if self._port is None and self._clock() - self._tried_s >= RECONNECT_S:
            self._tried_s = self._clock()
            with contextlib.suppress(OSError):
                self._port = self._connect()
        return self._port


class _SerialPort:
    """A pyserial port with a socket's manners."""

    def __init__(self, module: Any, device: str, baud: int) -> None:
        # SerialException is an OSError
        self._port = module.Serial(device, baud, timeout=0, write_timeout=0)

    def recv(self, size: int) -> bytes:
        data: bytes = self._port.read(size)
        if not data:
            raise BlockingIOError
        return data

    def send(self, data: bytes) -> int:
        return int(self._port.write(data) or 0)

    def fileno(self) -> int:
        return int(self._port.fileno())

    def close(self) -> None:
        self._port.close()


def check_url(url: str) -> None:
    """Whether a URL could be opened, without opening it; `LinkError` with one line where it could not."""
    scheme, _, rest = url.partition(":")
    if scheme == "serial":
        _device_baud(url, rest)
    elif scheme in ("udpin", "udpout", "tcp"):
        _host_port(url, rest)
    else:
        raise LinkError(f"link {url!r}: {scheme!r} is unknown; use udpin:, udpout:, tcp: or serial:")


def open_link(url: str) -> Link:
    """Open a link by its URL; `LinkError` with one line where that fails, `MissingExtraError` without pyserial."""
    check_url(url)
    scheme, _, rest = url.partition(":")
    if scheme == "serial":
        return _open_serial(url, *_device_baud(url, rest))
    host, port = _host_port(url, rest)
    if scheme == "tcp":
        try:
            connect = tcp.connections(host, port)
        except OSError as error:
            raise _cannot_open(url, error) from None
        return StreamLink(url, connect)
    return UdpLink(url, host, port, listen=scheme == "udpin")


def _host_port(url: str, rest: str) -> tuple[str, int]:
    host, _, port = rest.removeprefix("//").rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise LinkError(f"link {url!r}: expected HOST:PORT with a port of 1 to 65535, as in udpin:0.0.0.0:14550")
    return host.strip("[]"), int(port)


def _device_baud(url: str, rest: str) -> tuple[str, int]:
    device, _, baud = rest.rpartition(":")
    if not device or not baud.isdecimal():
        device, baud = rest, str(DEFAULT_BAUD)
    if not device:
        raise LinkError(f"link {url!r}: expected serial:DEVICE or serial:DEVICE:BAUD, as in serial:/dev/ttyAMA0:57600")
    return device, int(baud)


def _open_serial(url: str, device: str, baud: int) -> Link:
    try:
        module = importlib.import_module("serial")
    except ImportError:
        raise MissingExtraError("a serial link", "serial", "pyserial") from None
    return StreamLink(url, lambda: _SerialPort(module, device, baud))


def _cannot_open(url: str, error: OSError) -> LinkError:
    hint = ""
    if error.errno == errno.EADDRINUSE:
        hint = "; another program has this port: stop it, or use another port"
    elif error.errno == errno.ECONNREFUSED:
        hint = "; nothing listens there: start the vehicle first"
    return LinkError(f"link {url!r} cannot be opened: {error.strerror or error}{hint}")
