"""Neighbour messages over UDP (IPv4): to a list of peers, to a multicast group, or both, through one socket."""

from __future__ import annotations

import errno
import ipaddress
import socket
from collections.abc import Sequence

from gatar_edge.errors import LinkError
from gatar_edge.transports.base import MAX_DATAGRAM_BYTES, MAX_DATAGRAMS_PER_RECEIVE, LinkCounters

Address = tuple[str, int]

_MENDS = {
    errno.EADDRINUSE: "stop the program that uses it, or listen on another port",
    errno.EADDRNOTAVAIL: "this machine has no such address; use one of its own, or 0.0.0.0 for all",
    errno.EACCES: "use a port of 1024 or more",
    errno.ENODEV: "this machine has no network for the group; bring the interface up, or listen on its address",
}


class UdpTransport:
    """A `Transport` on one non-blocking socket.

    `listen` is "host:port". With a multicast `group` "239.x.y.z:port" both ports must be the same one, robots on one
    machine may share it, and the host of `listen` names the interface of the group (0.0.0.0: the system's choice).
    Names of peers are looked up once, here. Raises LinkError, one line with address and mend.
    """

    def __init__(self, listen: str, peers: Sequence[str] = (), group: str | None = None) -> None:
        self.counters = LinkCounters()
        own = parse_address(listen, "listen address")
        self._targets = [parse_address(peer, "peer", lowest_port=1) for peer in peers]
        group_address = None
        if group is not None:
            group_address = parse_group(group, own, listen)
            self._targets.append(group_address)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.setblocking(False)
            _bind(self._socket, own, group_address)
        except OSError as error:
            self._socket.close()
            what = listen if group is None else f"{listen} with group {group}"
            mend = _MENDS.get(error.errno or 0, "check the address and the network")
            raise LinkError(f"cannot listen on udp {what}: {error.strerror}; {mend}") from error

    @property
    def address(self) -> Address:
        """Where this transport listens: the port that the system chose where 0 was asked for."""
        host, port = self._socket.getsockname()
        return host, port

    @property
    def sends(self) -> int:
        """Datagrams per call of `send`."""
        return len(self._targets)

    def send(self, data: bytes) -> None:
        """Send `data` to each peer and to the group; failures are counted."""
        for target in self._targets:
            try:
                self._socket.sendto(data, target)
            except OSError:
                self.counters.send_errors += 1
            else:
                self.counters.sent += 1
                self.counters.sent_bytes += len(data)

    def receive(self) -> list[bytes]:
        """The datagrams that have come, at most `MAX_DATAGRAMS_PER_RECEIVE`, without waiting."""
        received: list[bytes] = []
        for _ in range(MAX_DATAGRAMS_PER_RECEIVE):
            try:
                data = self._socket.recv(MAX_DATAGRAM_BYTES + 1)
            except BlockingIOError:
                break
            except OSError:  # the network's complaint about an earlier datagram of ours, or a closed socket
                self.counters.receive_errors += 1
                break
            if len(data) > MAX_DATAGRAM_BYTES:
                self.counters.too_long += 1
                continue
            self.counters.received += 1
            self.counters.received_bytes += len(data)
            received.append(data)
        return received

    def fileno(self) -> int:
        """The socket, for `select`; -1 once closed."""
        return self._socket.fileno()

    def close(self) -> None:
        """Close the socket; later calls send and receive nothing."""
        self._socket.close()


def parse_address(text: str, what: str, lowest_port: int = 0) -> Address:
    """The IPv4 address and port of "host:port". Raises LinkError that names `what`, the text and the mend."""
    host, colon, port_text = text.rpartition(":")
    port = int(port_text) if port_text.isascii() and port_text.isdigit() and len(port_text) <= 5 else -1
    if not colon or not host or not lowest_port <= port <= 65535:
        raise LinkError(f"{what} {text!r} is not host:port with a port of {lowest_port}..65535, like 192.168.1.7:14600")
    try:
        return socket.gethostbyname(host), port
    except (OSError, UnicodeError) as error:
        raise LinkError(f"{what} {text!r}: host {host!r} is unknown here; give its IPv4 address") from error


def parse_group(group: str, own: Address, listen: str) -> Address:
    """A multicast group, on the port of the own address `listen`. Raises LinkError."""
    address = parse_address(group, "multicast group", lowest_port=1)
    if not ipaddress.IPv4Address(address[0]).is_multicast:
        raise LinkError(f"multicast group {group!r} is not in 224.0.0.0..239.255.255.255: use 239.255.71.1")
    if address[1] != own[1]:
        raise LinkError(f"multicast group {group!r} and listen address {listen!r} differ in port: give both the same")
    return address


def _bind(sock: socket.socket, own: Address, group: Address | None) -> None:
    if group is None:
        sock.bind(own)  # no SO_REUSEADDR: it would let two robots take each other's datagrams in silence
        return
    interface = socket.inet_aton(own[0])
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    sock.bind(("0.0.0.0", own[1]))  # a socket bound to a unicast address hears no group
    sock.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton(group[0]) + interface)
    sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, interface)
