"""Being watched: the service manager is told the truth, HTTP sees a hung loop, and numbers come out as they are."""

from __future__ import annotations

import http.client
import json
import socket
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest
from fake_ports import Rig

from gatar_edge.errors import LinkError
from gatar_edge.health import Snapshot
from gatar_edge.notify import Notifier
from gatar_edge.types import NS_PER_S
from gatar_edge.watch import HttpWatch


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[socket.socket]:
    """A service manager's end of the notification socket."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as receiver:
        receiver.bind(str(tmp_path / "notify"))
        receiver.setblocking(False)
        yield receiver


def notified(manager: socket.socket) -> list[str]:
    lines = []
    while True:
        try:
            lines += manager.recv(4096).decode().split("\n")
        except BlockingIOError:
            return lines


def snapshot(**changes: object) -> Snapshot:
    rig = Rig()
    rig.run(0.4)
    return msgspec.structs.replace(rig.last, **changes)


snapshot_of_all = snapshot()


def get(watch: HttpWatch, path: str) -> tuple[int, str]:
    connection = http.client.HTTPConnection(*watch.address, timeout=20)
    connection.request("GET", path)
    response = connection.getresponse()
    body = response.read().decode()
    connection.close()
    return response.status, body


def test_the_manager_hears_ready_once_the_watchdog_each_tick_and_the_status_each_second(manager: socket.socket) -> None:
    notifier = Notifier({"NOTIFY_SOCKET": manager.getsockname()})
    for tick in range(11):
        notifier.published(tick * NS_PER_S // 5, snapshot)
    lines = notified(manager)
    assert lines.count("READY=1") == 1
    assert lines.count("WATCHDOG=1") == 11
    statuses = [line for line in lines if line.startswith("STATUS=")]
    assert len(statuses) == 3
    assert "UAV 1 at 0,0: target 5,5; 0 neighbours" in statuses[0]
    notifier.stopping()
    assert "STOPPING=1" in notified(manager)
    notifier.close()


def test_without_a_manager_or_with_a_vanished_one_nothing_happens(tmp_path: Path) -> None:
    for environment in ({}, {"NOTIFY_SOCKET": str(tmp_path / "gone")}, {"NOTIFY_SOCKET": "@gatar-absent"}):
        notifier = Notifier(environment)
        notifier.published(0, snapshot)
        notifier.close()


def test_a_manager_that_does_not_read_does_not_hold_up_the_loop(manager: socket.socket) -> None:
    notifier = Notifier({"NOTIFY_SOCKET": manager.getsockname()})
    for _ in range(2000):  # more than any system queues
        notifier.published(0, lambda: snapshot_of_all)
    assert "READY=1" in notified(manager)
    notifier.close()


def test_health_is_200_while_all_is_well_and_503_with_the_problem_otherwise() -> None:
    now_ns = [0]
    watch = HttpWatch("127.0.0.1:0", lambda: now_ns[0])
    try:
        assert get(watch, "/healthz")[0] == 503
        good = snapshot()
        now_ns[0] = good.t_ns
        watch.published(good.t_ns, lambda: good)
        assert get(watch, "/healthz")[0] == 200
        now_ns[0] += 3 * NS_PER_S  # the loop hangs
        status, body = get(watch, "/healthz")
        assert (status, json.loads(body)["problems"]) == (503, ["no tick for 3.0 s"])
        watch.published(now_ns[0], lambda: snapshot(t_ns=now_ns[0], vehicle_connected=False))
        assert json.loads(get(watch, "/healthz")[1])["problems"] == ["no heartbeat from the autopilot"]
        assert get(watch, "/")[0] == 404
    finally:
        watch.close()


def test_metrics_have_gauges_and_counters_with_units_in_their_names() -> None:
    pytest.importorskip("prometheus_client", reason="pip install 'gatar-edge[metrics]'")
    watch = HttpWatch("127.0.0.1:0", lambda: 0)
    try:
        watch.published(0, snapshot)
        status, text = get(watch, "/metrics")
    finally:
        watch.close()
    assert status == 200
    assert "gatar_perception_age_seconds 0.0" in text
    assert "gatar_ticks_total 2.0" in text
    assert "gatar_heard_forged_total 0.0" in text


def test_metrics_without_the_library_name_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gatar_edge.watch.exporter", lambda latest: lambda: None)
    watch = HttpWatch("127.0.0.1:0", lambda: 0)
    try:
        assert watch.answer("/metrics")[0] == 501
        assert b"gatar-edge[metrics]" in watch.answer("/metrics")[2]
    finally:
        watch.close()


def test_a_port_in_use_is_one_clear_line() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as used:
        used.bind(("127.0.0.1", 0))
        used.listen()
        with pytest.raises(LinkError, match=r"watch\.http cannot listen on .*in use"):
            HttpWatch(f"127.0.0.1:{used.getsockname()[1]}", lambda: 0)
