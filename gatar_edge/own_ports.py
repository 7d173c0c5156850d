"""On which of this machine's ports a daemon listens, and that no two of its sockets want the same one."""

from __future__ import annotations

import ipaddress
import itertools
import socket
from dataclasses import dataclass

from gatar_edge.errors import ConfigError
from gatar_edge.vehicle_config import VehicleConfig

_EVERYWHERE = ("0.0.0.0", "::")
_UDP_ENDPOINTS = ("udp", "quic")  # of zenoh's transports; the others that have ports are TCP's


@dataclass(frozen=True, slots=True)
class Listener:
    """One socket of the daemon."""

    field: str  # of vehicle.toml
    value: str  # what stands there
    protocol: str  # UDP and TCP count their ports apart
    host: str  # an address; one of `_EVERYWHERE`: all of this machine's
    port: int  # 0: the system chooses

    def collides(self, other: Listener) -> bool:
        """Whether the two cannot be open at once."""
        same_host = self.host == other.host or self.host in _EVERYWHERE or other.host in _EVERYWHERE
        return self.protocol == other.protocol and self.port == other.port != 0 and same_host


def check_ports(config: VehicleConfig) -> None:
    """Raises ConfigError where two sockets of the daemon want the same port; addresses are valid by now."""
    for one, other in itertools.combinations(listeners(config), 2):
        if one.collides(other):
            raise ConfigError(
                f"{one.field} {one.value!r} and {other.field} {other.value!r} are the same {one.protocol} port "
                f"of this machine: give {one.field} another one"
            )


def listeners(config: VehicleConfig) -> list[Listener]:
    """The sockets that the daemon opens to listen on, the most easily moved first."""
    found = []
    if config.watch.http:
        found.append(_listener("watch.http", config.watch.http, "TCP"))
    if not config.perception.listen.startswith("unix:"):
        found.append(_listener("perception.listen", config.perception.listen, "UDP"))
    scheme, _, rest = config.vehicle.url.partition(":")
    if scheme == "udpin":
        found.append(_listener("vehicle.url", config.vehicle.url, "UDP", rest.removeprefix("//")))
    net = config.net
    if net.transport == "udp":
        own = _listener("net.listen", net.listen, "UDP")
        # a socket that hears a group is bound on all addresses, whatever its interface
        found.append(Listener(own.field, own.value, "UDP", "0.0.0.0", own.port) if net.group else own)
    elif net.transport == "zenoh" and net.listen:
        scheme, _, rest = net.listen.partition("/")
        if rest.rpartition(":")[2].isdecimal():  # a device or a path has no port
            found.append(_listener("net.listen", net.listen, "UDP" if scheme in _UDP_ENDPOINTS else "TCP", rest))
    return found


def _listener(field: str, value: str, protocol: str, address: str = "") -> Listener:
    host, _, port = (address or value).rpartition(":")
    return Listener(field, value, protocol, _address(host.strip("[]")), int(port))


def _address(host: str) -> str:
    """The address of a name; the name itself where it is unknown here, which opening the socket will say."""
    try:
        return str(ipaddress.ip_address(host))
    except ValueError:
        pass
    try:
        return socket.gethostbyname(host)
    except (OSError, UnicodeError):
        return host
