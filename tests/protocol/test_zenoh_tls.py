"""Zenoh with certificates on both sides: the team hears itself, a stranger gets silence, and both can be told apart."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from certificates import authority, signed_by
from zenoh_peers import endpoint, until

from gatar_edge.transports.zenoh import ZenohTransport

Open = Callable[..., ZenohTransport]


@pytest.fixture
def opened(tmp_path: Path) -> Iterator[Open]:
    """Opens a robot's transport: its id, where it listens, its peers, whom it trusts, and its own certificate."""
    pytest.importorskip("zenoh", reason="pip install 'gatar-edge[zenoh]'")
    if shutil.which("openssl") is None:
        pytest.skip("the openssl command makes the certificates, and is not installed")
    with ExitStack() as stack:

        def make(robot_id: int, listen: str, *peers: str, trusts: Path, shows: Path | None) -> ZenohTransport:
            tls: dict[str, object] = {"root_ca_certificate": str(trusts), "enable_mtls": True}
            for side in ("listen", "connect") if shows is not None else ():
                tls |= {f"{side}_certificate": str(shows), f"{side}_private_key": f"{shows}.key"}
            file = tmp_path / f"robot{robot_id}.json5"
            file.write_text(json.dumps({"transport": {"link": {"tls": tls}}}))
            transport = ZenohTransport(robot_id, listen, peers, file)
            stack.callback(transport.close)
            return transport

        yield make


def test_robots_with_certificates_of_one_authority_hear_each_other(opened: Open, tmp_path: Path) -> None:
    team, there = authority(tmp_path, "team"), endpoint("tls")
    one = opened(1, there, trusts=team, shows=signed_by(team, "robot1"))
    two = opened(2, "", there, trusts=team, shows=signed_by(team, "robot2"))
    until(lambda: one.alive == 1 and two.alive == 1)
    assert two.problem == ""
    until(lambda: two.send(b"hello") or b"hello" in one.receive())
    until(lambda: one.send(b"and you") or b"and you" in two.receive())


@pytest.mark.parametrize("stranger", ["signed by another authority", "trusts and is of another", "shows none"])
def test_a_stranger_is_refused_in_silence_and_its_own_problem_says_so(
    opened: Open, tmp_path: Path, stranger: str
) -> None:
    team, others, there = authority(tmp_path, "team"), authority(tmp_path, "others"), endpoint("tls")
    one = opened(1, there, trusts=team, shows=signed_by(team, "robot1"))
    foreign = signed_by(others, "robot3")
    three = opened(
        3,
        "",
        there,
        trusts=others if stranger == "trusts and is of another" else team,
        shows=None if stranger == "shows none" else foreign,
    )
    two = opened(2, "", there, trusts=team, shows=signed_by(team, "robot2"))  # opened after it, and let in
    until(lambda: one.alive == 1 and two.alive == 1)
    three.send(b"let me in")
    heard: list[bytes] = []
    until(lambda: two.send(b"hello") or heard.extend(one.receive()) or b"hello" in heard)
    assert set(heard) == {b"hello"}
    assert (three.alive, one.alive) == (0, 1)
    assert "check certificates" in three.problem


def test_a_robot_that_is_refused_until_it_has_its_certificate_joins_without_anybody_else_starting_anew(
    opened: Open, tmp_path: Path
) -> None:
    team, others, there = authority(tmp_path, "team"), authority(tmp_path, "others"), endpoint("tls")
    one = opened(1, there, trusts=team, shows=signed_by(team, "robot1"))
    refused = opened(2, "", there, trusts=team, shows=signed_by(others, "stranger"))
    assert refused.problem != ""
    refused.close()
    two = opened(2, "", there, trusts=team, shows=signed_by(team, "robot2"))
    until(lambda: one.alive == 1 and two.problem == "")
