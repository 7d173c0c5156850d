"""Neighbour messages over real sockets on loopback; waiting is by `select`, which ends when something has come."""

from __future__ import annotations

import errno
import select
import socket
from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest

from gatar_edge.errors import LinkError
from gatar_edge.transports import udp
from gatar_edge.transports.base import MAX_DATAGRAM_BYTES, MAX_DATAGRAMS_PER_RECEIVE, Transport
from gatar_edge.transports.udp import UdpTransport

LIMIT_S = 10.0
GROUP = "239.255.71.1"
Opener = Callable[..., UdpTransport]


@pytest.fixture
def opened() -> Iterator[Opener]:
    """Opens transports that are closed at the end of the test."""
    with ExitStack() as stack:

        def open_one(
            listen: str = "127.0.0.1:0", peers: tuple[str, ...] = (), group: str | None = None
        ) -> UdpTransport:
            transport = UdpTransport(listen, peers, group)
            stack.callback(transport.close)
            return transport

        yield open_one


def name(transport: UdpTransport) -> str:
    return "{}:{}".format(*transport.address)


def gather(transport: Transport, count: int) -> list[bytes]:
    """The next `count` datagrams."""
    found: list[bytes] = []
    while len(found) < count:
        ready, _, _ = select.select([transport], [], [], LIMIT_S)
        assert ready, f"{len(found)} of {count} datagrams came"
        found += transport.receive()
    return found


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def test_each_peer_of_the_list_receives_what_is_sent(opened: Opener) -> None:
    one, other = opened(), opened()
    sender = opened(peers=(name(one), name(other)))
    sender.send(b"here")
    assert gather(one, 1) == gather(other, 1) == [b"here"]
    assert (sender.sends, sender.counters.sent, sender.counters.sent_bytes) == (2, 2, 8)
    assert (one.counters.received, one.counters.received_bytes) == (1, 4)


def test_receiving_does_not_wait(opened: Opener) -> None:
    assert opened().receive() == []


def test_robots_of_one_machine_share_a_multicast_group(opened: Opener) -> None:
    port = free_port()
    try:
        one, other = (opened(f"127.0.0.1:{port}", group=f"{GROUP}:{port}") for _ in range(2))
        one.send(b"to all")
    except LinkError as error:
        pytest.skip(f"no multicast here: {error}")
    if one.counters.send_errors:
        pytest.skip("no multicast here: loopback refuses to send it")
    assert gather(other, 1) == [b"to all"]
    assert one.sends == 1


def test_one_call_receives_a_bounded_number_and_leaves_the_rest(
    opened: Opener, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(udp, "MAX_DATAGRAMS_PER_RECEIVE", 3)
    receiver = opened()
    sender = opened(peers=(name(receiver),))
    for number in range(7):
        sender.send(bytes((number,)))
    batches: list[list[bytes]] = []
    while sum(map(len, batches)) < 7:
        assert select.select([receiver], [], [], LIMIT_S)[0]
        batches.append(receiver.receive())
    assert [data[0] for batch in batches for data in batch] == list(range(7))
    assert max(map(len, batches)) <= 3


def test_a_datagram_longer_than_any_message_is_dropped_and_counted(opened: Opener) -> None:
    receiver = opened()
    sender = opened(peers=(name(receiver),))
    sender.send(bytes(MAX_DATAGRAM_BYTES + 1))
    sender.send(bytes(60_000))
    sender.send(bytes(MAX_DATAGRAM_BYTES))
    sender.send(b"")
    assert gather(receiver, 2) == [bytes(MAX_DATAGRAM_BYTES), b""]
    assert receiver.counters.too_long == 2


def test_a_peer_that_is_not_there_changes_nothing(opened: Opener) -> None:
    receiver = opened()
    sender = opened(peers=(f"127.0.0.1:{free_port()}", name(receiver)))
    for _ in range(3):
        sender.send(b"still here")
        assert sender.receive() == []
    assert gather(receiver, 3) == [b"still here"] * 3


def test_a_peer_that_cannot_be_reached_is_counted_and_the_others_are_served(opened: Opener) -> None:
    receiver = opened()
    sender = opened(peers=("255.255.255.255:9", name(receiver)))  # the system refuses: broadcast is not allowed
    sender.send(b"on")
    assert gather(receiver, 1) == [b"on"]
    assert (sender.counters.send_errors, sender.counters.sent) == (1, 1)


def test_an_error_of_the_network_while_receiving_is_counted(opened: Opener, monkeypatch: pytest.MonkeyPatch) -> None:
    class Refused:
        def recv(self, size: int) -> bytes:
            raise ConnectionRefusedError(errno.ECONNREFUSED, "Connection refused")

    receiver = opened()
    with monkeypatch.context() as patch:
        patch.setattr(receiver, "_socket", Refused())
        assert receiver.receive() == []
    assert receiver.counters.receive_errors == 1


def test_a_closed_transport_sends_and_receives_nothing(opened: Opener) -> None:
    transport = opened(peers=("127.0.0.1:9",))
    transport.close()
    transport.close()
    transport.send(b"late")
    assert transport.receive() == []
    assert transport.fileno() == -1
    assert transport.counters.sent == 0


def test_an_occupied_port_is_named_with_the_mend(opened: Opener) -> None:
    taken = name(opened())
    with pytest.raises(LinkError) as caught:
        opened(taken)
    assert str(caught.value) == (
        f"cannot listen on udp {taken}: Address already in use; "
        "stop the program that uses it, or listen on another port"
    )


def test_a_group_does_not_join_a_port_that_another_program_holds(opened: Opener) -> None:
    port = opened().address[1]
    with pytest.raises(LinkError, match=f"with group {GROUP}:{port}: Address already in use; stop"):
        opened(f"127.0.0.1:{port}", group=f"{GROUP}:{port}")


def test_a_refused_transport_leaves_no_socket_open(opened: Opener) -> None:
    taken = name(opened())
    for _ in range(20):  # an unclosed socket would warn, and warnings are errors
        with pytest.raises(LinkError):
            UdpTransport(taken)


@pytest.mark.parametrize(
    ("listen", "peers", "group", "text"),
    [
        ("127.0.0.1", (), None, "listen address '127.0.0.1' is not host:port"),
        (":14600", (), None, "listen address ':14600' is not host:port"),
        ("127.0.0.1:65536", (), None, "listen address '127.0.0.1:65536' is not host:port with a port of 0..65535"),
        ("127.0.0.1:-1", (), None, "listen address '127.0.0.1:-1' is not host:port"),
        ("127.0.0.1:²", (), None, "listen address '127.0.0.1:²' is not host:port"),
        ("127.0.0.1:" + "9" * 5000, (), None, "listen address '127.0.0.1:9"),
        (
            "192.0.2.1:14600",
            (),
            None,
            "cannot listen on udp 192.0.2.1:14600: Cannot assign requested address; this machine",
        ),
        ("127.0.0.1:0", ("127.0.0.1:0",), None, "peer '127.0.0.1:0' is not host:port with a port of 1..65535"),
        (
            "127.0.0.1:0",
            ("[::1]:14600",),
            None,
            "peer '[::1]:14600': host '[::1]' is unknown here; give its IPv4 address",
        ),
        ("127.0.0.1:0", ("a..b:1",), None, "peer 'a..b:1': host 'a..b' is unknown here; give its IPv4 address"),
        (
            "0.0.0.0:14600",
            (),
            "10.0.0.1:14600",
            "multicast group '10.0.0.1:14600' is not in 224.0.0.0..239.255.255.255",
        ),
        ("0.0.0.0:14601", (), "239.255.71.1:14600", "multicast group '239.255.71.1:14600' and listen address"),
    ],
)
def test_a_bad_address_is_named_in_one_line(
    opened: Opener, listen: str, peers: tuple[str, ...], group: str | None, text: str
) -> None:
    with pytest.raises(LinkError) as caught:
        opened(listen, peers, group)
    assert str(caught.value).startswith(text)
    assert "\n" not in str(caught.value)


def test_a_team_of_sixty_four_fits_one_call() -> None:
    assert MAX_DATAGRAMS_PER_RECEIVE >= 2 * 63
