"""The same small mission over each transport: three daemons share what they see and never two go for one target."""

from __future__ import annotations

import contextlib
import dataclasses
import socket
import time
from collections.abc import Callable, Iterator

import pytest
from fake_ports import Rig

from gatar_edge.transports.base import Transport
from gatar_edge.transports.mavlink_tunnel import MavlinkTunnel
from gatar_edge.transports.udp import UdpTransport
from gatar_edge.transports.zenoh import ZenohTransport
from gatar_edge.types import Cell, CellState, Goto

TARGETS: list[Cell] = [(2, 2), (2, 12), (7, 7), (12, 2), (12, 12), (14, 7)]
STARTS: dict[int, Cell] = {1: (0, 0), 2: (0, 14), 3: (14, 0)}
Opened = tuple[dict[int, Transport], Callable[[], bool]]  # by robot, and a wait for what is on its way: whether it came


def over_udp(stack: contextlib.ExitStack) -> Opened:
    probes = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in STARTS]
    for probe in probes:
        probe.bind(("127.0.0.1", 0))
    addresses = dict(zip(STARTS, (f"127.0.0.1:{probe.getsockname()[1]}" for probe in probes), strict=True))
    for probe in probes:
        probe.close()
    transports: dict[int, Transport] = {}
    for robot_id, address in addresses.items():
        others = [other for other in addresses.values() if other != address]
        transports[robot_id] = stack.enter_context(contextlib.closing(UdpTransport(address, others)))
    return transports, lambda: True  # loopback delivers at once


def over_mavlink(stack: contextlib.ExitStack) -> Opened:
    tunnels: dict[int, MavlinkTunnel] = {}

    def air(author: int) -> Callable[[bytes], None]:
        def send(frame: bytes) -> None:
            for robot_id, tunnel in tunnels.items():
                if robot_id != author:
                    tunnel.feed(frame)

        return send

    tunnels.update({robot_id: MavlinkTunnel(air(robot_id), lambda: -1, robot_id) for robot_id in STARTS})
    return dict(tunnels), lambda: True


def over_zenoh(stack: contextlib.ExitStack) -> Opened:
    pytest.importorskip("zenoh", reason="pip install 'gatar-edge[zenoh]'")
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    endpoint = f"tcp/127.0.0.1:{port}"
    sessions: dict[int, ZenohTransport] = {}
    for robot_id in STARTS:
        listen, peers = (endpoint, ()) if robot_id == 1 else ("tcp/127.0.0.1:0", (endpoint,))
        sessions[robot_id] = stack.enter_context(contextlib.closing(ZenohTransport(robot_id, listen, peers)))

    become_acquainted(sessions)
    began = {robot_id: (each.counters.sent, each.counters.received) for robot_id, each in sessions.items()}

    def all_arrived() -> bool:
        sent = {robot_id: each.counters.sent - began[robot_id][0] for robot_id, each in sessions.items()}
        return all(
            each.counters.received - began[robot_id][1] + len(each._arrived) == sum(sent.values()) - sent[robot_id]
            for robot_id, each in sessions.items()
        )

    # one may be lost when two sessions that met over a third connect directly: no reason to wait long
    return dict(sessions), lambda: until(all_arrived, 0.2)


def until(condition: Callable[[], bool], limit_s: float = 30.0) -> bool:
    """Wait for other threads; false when the time is up."""
    end_s = time.monotonic() + limit_s
    while not condition():
        if time.monotonic() > end_s:
            return False
        time.sleep(0.002)
    return True


def become_acquainted(sessions: dict[int, ZenohTransport]) -> None:
    """A session that is up does not yet know all subscribers: talk until each has heard both others, then be quiet."""
    heard: dict[int, set[bytes]] = {robot_id: set() for robot_id in sessions}

    def all_heard() -> bool:
        for robot_id, session in sessions.items():
            session.send(bytes([robot_id]))
            heard[robot_id] |= set(session.receive())
        return all(len(names) == 2 for names in heard.values())

    assert until(all_heard)
    quiet: dict[int, set[bytes]] = {robot_id: set() for robot_id in sessions}
    for robot_id, session in sessions.items():
        session.send(bytes([robot_id]) * 2)  # the last one from here

    def all_quiet() -> bool:
        for robot_id, session in sessions.items():
            quiet[robot_id] |= {data for data in session.receive() if len(data) == 2}
        return all(len(names) == 2 for names in quiet.values())

    assert until(all_quiet)


@pytest.fixture(params=[over_udp, over_mavlink, over_zenoh], ids=["udp", "mavlink", "zenoh"])
def opened(request: pytest.FixtureRequest) -> Iterator[Opened]:
    with contextlib.ExitStack() as stack:
        yield request.param(stack)


def test_a_team_localizes_all_targets_over_any_transport_without_going_twice(opened: Opened) -> None:
    transports, wait = opened
    rigs = {robot_id: Rig(robot_id) for robot_id in STARTS}
    for robot_id, rig in rigs.items():
        rig.daemon._ports = dataclasses.replace(rig.daemon._ports, radio=transports[robot_id])
    cells = dict(STARTS)
    all_came = True
    for _ in range(20):
        goals = []
        for robot_id, rig in rigs.items():
            rig.see(cell=cells[robot_id], targets=TARGETS)
            rig.run(0.2, seeing=False)
            all_came &= wait()
            command = rig.vehicle.commands[-1]
            if isinstance(command, Goto):
                goals.append(command.cell)
                cells[robot_id] = command.cell
        assert not all_came or len(goals) == len(set(goals))
    for rig in rigs.values():
        assert all(rig.agent.belief[cell] == CellState.LOCALIZED for cell in TARGETS)
        assert len(rig.last.neighbors) == 2
