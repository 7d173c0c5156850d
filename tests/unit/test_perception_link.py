"""Where observations arrive: on this machine alone, over UDP or a Unix socket, also after a crash."""

from __future__ import annotations

import contextlib
import socket
from pathlib import Path

import pytest

from gatar_edge.errors import LinkError
from gatar_edge.perception_link import MAX_PER_RECEIVE, PerceptionSocket


def send(address: str, *datagrams: bytes) -> None:
    unix = address.startswith("unix:")
    target: object = address[5:] if unix else (address.split(":", maxsplit=1)[0], int(address.split(":")[1]))
    with socket.socket(socket.AF_UNIX if unix else socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for data in datagrams:
            sender.sendto(data, target)  # type: ignore[arg-type]


@pytest.mark.parametrize("unix", [False, True])
def test_datagrams_arrive_in_order_and_never_block(unix: bool, tmp_path: Path) -> None:
    with contextlib.closing(PerceptionSocket(f"unix:{tmp_path}/p.sock" if unix else "127.0.0.1:0")) as link:
        assert link.receive() == []
        send(link.address, b"one", b"two" * 10_000)
        assert link.receive() == [b"one", b"two" * 10_000]


def test_a_flood_is_taken_in_portions() -> None:
    with contextlib.closing(PerceptionSocket("127.0.0.1:0")) as link:
        send(link.address, *[b"x"] * (MAX_PER_RECEIVE + 1))
        assert len(link.receive()) == MAX_PER_RECEIVE
        assert len(link.receive()) == 1


def test_an_address_that_other_machines_reach_must_be_asked_for() -> None:
    with pytest.raises(LinkError, match="allow_remote"):
        PerceptionSocket("0.0.0.0:0")
    PerceptionSocket("0.0.0.0:0", allow_remote=True).close()


def test_the_socket_file_of_a_killed_daemon_is_replaced_but_not_that_of_a_living_one(tmp_path: Path) -> None:
    path = f"unix:{tmp_path}/p.sock"
    killed = PerceptionSocket(path)
    killed._socket.close()
    with contextlib.closing(PerceptionSocket(path)), pytest.raises(LinkError, match="in use"):
        PerceptionSocket(path)
    assert not (tmp_path / "p.sock").exists()


def test_an_occupied_port_is_one_clear_line() -> None:
    with contextlib.closing(PerceptionSocket("127.0.0.1:0")) as link, pytest.raises(LinkError, match="in use") as error:
        PerceptionSocket(link.address)
    assert "\n" not in str(error.value)
