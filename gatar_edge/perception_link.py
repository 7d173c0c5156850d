"""Where observations arrive: a UDP socket or a Unix datagram socket of this machine."""

from __future__ import annotations

import contextlib
import ipaddress
import os
import socket
from pathlib import Path

from gatar_edge.errors import LinkError
from gatar_edge.perception import MAX_OBSERVATION_BYTES
from gatar_edge.transports.udp import parse_address

MAX_PER_RECEIVE = 64
_PATH_BYTES = 107  # of a Unix socket, see unix(7)
_BUFFER_BYTES = 1 << 20  # for a few large observations


class PerceptionSocket:
    """A `ports.Source` on "host:port" or "unix:/path".

    Observations are not signed, so only this machine may send them unless `allow_remote` is given.
    Raises LinkError, one line with address and mend.
    """

    def __init__(self, listen: str, *, allow_remote: bool = False) -> None:
        self._path: Path | None = None
        if listen.startswith("unix:"):
            self._path = unix_path(listen)
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
            _remove_stale(self._path)
            address: str | tuple[str, int] = str(self._path)
        else:
            address = local_address(listen, allow_remote=allow_remote)
            self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.setblocking(False)
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_BYTES)
            self._socket.bind(address)
        except OSError as error:
            self._socket.close()
            raise LinkError(
                f"perception cannot be received on {listen} ({error.strerror}): stop the program that uses it, "
                "or give another address in perception.listen"
            ) from error

    @property
    def address(self) -> str:
        """Where observations are to be sent."""
        if self._path is not None:
            return f"unix:{self._path}"
        host, port = self._socket.getsockname()
        return f"{host}:{port}"

    def receive(self) -> list[bytes]:
        """The datagrams that have come, at most 64, without waiting."""
        received: list[bytes] = []
        with contextlib.suppress(OSError):  # BlockingIOError: no more
            while len(received) < MAX_PER_RECEIVE:
                received.append(self._socket.recv(MAX_OBSERVATION_BYTES + 1))
        return received

    def fileno(self) -> int:
        """The socket, for `select`."""
        return self._socket.fileno()

    def close(self) -> None:
        """Close the socket and remove its file."""
        self._socket.close()
        if self._path is not None:
            self._path.unlink(missing_ok=True)


def unix_path(listen: str) -> Path:
    """The path in "unix:/path". Raises LinkError where no socket can be made there."""
    path = Path(listen.removeprefix("unix:"))
    if not path.parent.is_dir() or path.is_dir() or len(os.fsencode(path)) > _PATH_BYTES:
        raise LinkError(
            f"perception.listen {listen!r} is no place for a socket: give a path of at most {_PATH_BYTES} bytes "
            "in a folder that exists"
        )
    return path


def local_address(listen: str, *, allow_remote: bool = False) -> tuple[str, int]:
    """The address in "host:port". Raises LinkError for one that other machines can reach, unless allowed."""
    host, port = parse_address(listen, "perception.listen")
    if not ipaddress.IPv4Address(host).is_loopback and not allow_remote:
        raise LinkError(
            f"perception.listen {listen!r} can be reached by other machines, and observations are not signed: "
            "use 127.0.0.1 or unix:/path, or set perception.allow_remote = true on a network of your own"
        )
    return host, port


def _remove_stale(path: Path) -> None:
    """Remove the socket file that a killed daemon left; never another kind of file, nor one still in use."""
    if not path.is_socket():
        return
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(str(path))
        except OSError:
            path.unlink(missing_ok=True)
