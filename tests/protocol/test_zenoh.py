"""Zenoh between real sessions on loopback: messages arrive, a lost peer is noticed, and comes back."""

from __future__ import annotations

import select
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from zenoh_peers import endpoint, until

from gatar_edge.errors import ConfigError, LinkError, MissingExtraError
from gatar_edge.transports.zenoh import ZenohTransport


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    pytest.importorskip("zenoh", reason="pip install 'gatar-edge[zenoh]'")
    with ExitStack() as stack:
        yield stack


def opened(stack: ExitStack, robot_id: int, listen: str, *peers: str) -> ZenohTransport:
    transport = ZenohTransport(robot_id, listen, peers)
    stack.callback(transport.close)
    return transport


def test_messages_reach_all_others_wake_the_loop_and_do_not_come_back(stack: ExitStack) -> None:
    here = endpoint()
    one, two, three = opened(stack, 1, here), opened(stack, 2, endpoint(), here), opened(stack, 3, endpoint(), here)
    until(lambda: one.alive == 2 and two.alive == 2 and three.alive == 2)
    until(lambda: one.send(b"hello") or bool(select.select([two.fileno()], [], [], 0.05)[0]))
    until(lambda: b"hello" in two.receive())
    until(lambda: b"hello" in three.receive())
    assert one.receive() == []
    two.send(b"x" * 300)
    two.send(b"end")
    until(lambda: b"end" in one.receive())
    assert one.counters.too_long == 1


def test_a_peer_that_is_not_there_is_a_problem_until_it_comes_and_again_when_it_goes(stack: ExitStack) -> None:
    there = endpoint()
    one = opened(stack, 1, "", there)
    assert "none of net.peers" in one.problem
    one.send(b"into the void")
    two = opened(stack, 2, there)
    until(lambda: one.problem == "")
    two.close()
    until(lambda: one.problem != "")
    opened(stack, 2, there)
    until(lambda: one.problem == "")


def test_a_bad_endpoint_or_file_is_one_clear_line(stack: ExitStack, tmp_path: Path) -> None:
    here = endpoint()
    opened(stack, 1, here)
    with pytest.raises(LinkError, match=here):
        ZenohTransport(2, here)
    (tmp_path / "bad.json5").write_text("{ mode: 7 ")
    with pytest.raises(ConfigError, match=r"bad\.json5"):
        ZenohTransport(2, "", config=tmp_path / "bad.json5")
    with pytest.raises(ConfigError, match=r"absent\.json5"):
        ZenohTransport(2, "", config=tmp_path / "absent.json5")


def test_without_the_library_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "zenoh", None)
    with pytest.raises(MissingExtraError, match=r"gatar-edge\[zenoh\]"):
        ZenohTransport(1, "")
