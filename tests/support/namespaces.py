"""Network namespaces of this test alone: a bridge in one, each robot in another, nothing in the machine's own network.

Needs Linux, iproute2 and the right to make namespaces. All names carry the process id; all are removed at the end.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import shutil
import subprocess
from collections.abc import Iterator, Sequence

CLONE_NEWNET = 0x4000_0000
NETWORK = "10.71.0"


class NoNamespacesError(Exception):
    """This machine does not let us make any; says why."""


class Bridge:
    """A switch: `hub` is its namespace, at .254; `add` plugs in further ones."""

    def __init__(self, stack: contextlib.ExitStack) -> None:
        self._stack = stack
        self._count = 0
        self.hub = self._make()
        self.host = f"{NETWORK}.254"
        _ip("-n", self.hub, "link", "add", "bridge", "type", "bridge")
        _ip("-n", self.hub, "address", "add", f"{self.host}/24", "dev", "bridge")
        _ip("-n", self.hub, "link", "set", "bridge", "up")

    def add(self) -> tuple[str, Sequence[str]]:
        """Another namespace on the bridge: its address, and the command that runs another one in it."""
        name, number = self._make(), self._count - 1
        host, port = f"{NETWORK}.{number}", f"port{number}"
        _ip("-n", self.hub, "link", "add", port, "type", "veth", "peer", "name", "radio", "netns", name)
        _ip("-n", self.hub, "link", "set", port, "master", "bridge", "up")
        _ip("-n", name, "address", "add", f"{host}/24", "dev", "radio")
        _ip("-n", name, "link", "set", "radio", "up")
        return host, (_command(), "netns", "exec", name)

    def _make(self) -> str:
        name = f"gatar-{os.getpid()}-{self._count}"
        self._count += 1
        _ip("netns", "add", name)
        self._stack.callback(_ip, "netns", "delete", name)  # takes its links along
        _ip("-n", name, "link", "set", "lo", "up")
        return name


@contextlib.contextmanager
def inside(name: str) -> Iterator[None]:
    """Sockets made in this thread meanwhile belong to the namespace, and stay in it."""
    libc = ctypes.CDLL(None, use_errno=True)
    with open("/proc/thread-self/ns/net") as home, open(f"/run/netns/{name}") as there:
        _enter(libc, there.fileno())
        try:
            yield
        finally:
            _enter(libc, home.fileno())


def _enter(libc: ctypes.CDLL, descriptor: int) -> None:
    if libc.setns(descriptor, CLONE_NEWNET) != 0:
        raise OSError(ctypes.get_errno(), "setns")


def _command() -> str:
    command = shutil.which("ip", path=f"{os.environ.get('PATH', '')}:/usr/sbin:/sbin")
    if command is None:
        raise NoNamespacesError("iproute2 is not installed")
    return command


def _ip(*arguments: str) -> None:
    done = subprocess.run([_command(), *arguments], capture_output=True, text=True, check=False)
    if done.returncode:
        raise NoNamespacesError(f"ip {' '.join(arguments)}: {done.stderr.strip()}")
