"""Links by URL: what opens, what is refused in one line, and who is answered where."""

from __future__ import annotations

import contextlib
import importlib
import socket

import pytest

from gatar_edge.bridge import framing
from gatar_edge.bridge.codec import Codec
from gatar_edge.bridge.framing import datagrams, sender
from gatar_edge.bridge.link import LinkError, StreamLink, UdpLink, open_link
from gatar_edge.bridge.wire import Heartbeat
from gatar_edge.errors import MissingExtraError

BEAT = Heartbeat(10, 3, 0, 0, 4)


def free_port(kind: socket.SocketKind = socket.SOCK_DGRAM) -> int:
    with socket.socket(socket.AF_INET, kind) as s:
        s.bind(("127.0.0.1", 0))
        return int(s.getsockname()[1])


def wait(receive: object) -> list[bytes]:
    for _ in range(100_000):
        got: list[bytes] = receive()  # type: ignore[operator]
        if got:
            return got
    raise AssertionError("nothing arrived")


@pytest.mark.parametrize(
    "url",
    [
        "",
        "udp:127.0.0.1:14550",
        "udpin:14550",
        "udpin:127.0.0.1:0",
        "udpin:127.0.0.1:99999",
        "tcp:host:port",
        "serial:",
    ],
)
def test_a_url_that_cannot_be_used_is_refused_in_one_line(url: str) -> None:
    with pytest.raises(LinkError) as refused:
        open_link(url)
    assert "\n" not in str(refused.value)
    assert repr(url) in str(refused.value)


def test_an_occupied_port_is_named_with_the_mend() -> None:
    url = f"udpin:127.0.0.1:{free_port()}"
    with open_link(url), pytest.raises(LinkError, match="another program has this port"):
        open_link(url)


def test_a_refused_connection_is_named_with_the_mend() -> None:
    with pytest.raises(LinkError, match="nothing listens there"):
        open_link(f"tcp:127.0.0.1:{free_port(socket.SOCK_STREAM)}")


def test_an_unknown_host_is_a_link_error() -> None:
    with pytest.raises(LinkError, match="cannot be opened"):
        open_link("udpout:no.such.host.invalid:14550")


def test_each_vehicle_on_one_socket_is_answered_at_its_own_address() -> None:
    port = free_port()
    with open_link(f"udpin:127.0.0.1:{port}") as here:
        far = {sysid: open_link(f"udpout:127.0.0.1:{port}") for sysid in (1, 2)}
        assert not here.send(b"x", 1)
        for sysid, there in far.items():
            there.send(Codec(sysid, 1).encode(BEAT))
            wait(here.receive)
        assert not here.send(b"x")  # to whom?
        for sysid in (2, 1):
            assert here.send(bytes([sysid]), sysid)
        for sysid, there in far.items():
            assert wait(there.receive) == [bytes([sysid])]
            there.close()
        assert isinstance(here, UdpLink)
        assert set(here.peers) == {1, 2}


def test_a_camera_of_the_vehicle_with_an_address_of_its_own_does_not_get_the_autopilot_s_commands() -> None:
    port = free_port()
    with (
        open_link(f"udpin:127.0.0.1:{port}") as here,
        open_link(f"udpout:127.0.0.1:{port}") as autopilot,
        open_link(f"udpout:127.0.0.1:{port}") as camera,
    ):
        for there, compid in ((camera, 100), (autopilot, 1), (camera, 100)):
            there.send(Codec(1, compid).encode(BEAT))
            wait(here.receive)
        assert here.send(b"order", 1)
        assert wait(autopilot.receive) == [b"order"]
        assert camera.receive() == []


def test_an_autopilot_of_another_component_is_answered_too() -> None:
    port = free_port()
    with open_link(f"udpin:127.0.0.1:{port}") as here, open_link(f"udpout:127.0.0.1:{port}") as there:
        there.send(Codec(1, 50).encode(BEAT))
        wait(here.receive)
        assert here.send(b"order", 1)
        assert wait(there.receive) == [b"order"]


def test_noise_does_not_become_a_peer() -> None:
    assert sender(b"\xfd") is None
    assert sender(b"GET / HTTP/1.1\r\n") is None
    assert sender(Codec(9, 1).encode(BEAT)) == (9, 1)
    assert sender(bytes([0xFE, 9, 0, 5, 1, 0]) + b"\x00" * 11) == (5, 1)


def test_frames_are_kept_whole_in_datagrams_below_the_mtu() -> None:
    frames = [Codec(1, 1).encode(BEAT)] * 200
    packed = datagrams(b"".join(frames))
    assert b"".join(packed) == b"".join(frames)
    assert max(map(len, packed)) <= framing.MAX_DATAGRAM
    assert all(len(p) % len(frames[0]) == 0 for p in packed)
    assert len(packed) < 10


def test_a_tcp_link_carries_both_ways_and_survives_the_end_of_its_peer() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        tcp, clock = tcp_to(server)
        far, _ = server.accept()
        assert tcp.send(b"up")
        assert far.recv(10) == b"up"
        far.send(b"down")
        assert wait(tcp.receive) == [b"down"]
        far.close()
        while tcp._port is not None:
            assert tcp.receive() == []
        assert not tcp.send(b"lost")
        clock[0] += 2
        assert wait(lambda: tcp.send(b"again"))
        far, _ = server.accept()
        assert far.recv(10) == b"again"
        far.close()
        tcp.close()
        clock[0] += 2
        assert not tcp.send(b"closed")


def test_a_far_end_that_does_not_answer_is_not_waited_for() -> None:
    with socket.create_server(("127.0.0.1", 0), backlog=0) as server, contextlib.ExitStack() as stack:
        tcp, clock = tcp_to(server)
        stack.callback(tcp.close)
        far, _ = server.accept()
        far.close()
        while tcp._port is not None:
            assert tcp.receive() == []
        for _ in range(4):  # the queue is full: what comes now is not answered
            other = stack.enter_context(socket.socket())
            other.setblocking(False)
            other.connect_ex(server.getsockname())
        clock[0] += 2
        assert tcp.receive() == []
        assert not tcp.send(b"lost")
        with pytest.raises(OSError, match="not connected"):
            tcp._port.getpeername()


def tcp_to(server: socket.socket) -> tuple[StreamLink, list[float]]:
    """A link to a server, and its clock."""
    host, port = server.getsockname()
    tcp, clock = open_link(f"tcp:{host}:{port}"), [0.0]
    assert isinstance(tcp, StreamLink)
    tcp._clock, tcp._tried_s = lambda: clock[0], 0.0
    return tcp, clock


def test_serial_without_pyserial_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> object:
        raise ImportError(name)

    monkeypatch.setattr(importlib, "import_module", missing)
    with pytest.raises(MissingExtraError, match=r"gatar-edge\[serial\]"):
        open_link("serial:/dev/ttyAMA0")


def test_a_serial_device_that_is_not_there_is_a_link_error(monkeypatch: pytest.MonkeyPatch) -> None:
    class Serial:
        def Serial(self, device: str, baud: int, **_options: object) -> object:  # noqa: N802 - pyserial's name
            assert (device, baud) == ("/dev/nothing", 9600)
            raise FileNotFoundError(2, "No such file or directory")

    monkeypatch.setattr(importlib, "import_module", lambda _name: Serial())
    with pytest.raises(LinkError, match="No such file"):
        open_link("serial:/dev/nothing:9600")
