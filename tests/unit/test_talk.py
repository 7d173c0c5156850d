"""Datagrams between allocators: signed, of one team, each let in once."""

from __future__ import annotations

import pytest
from builders import observation
from hypothesis import given
from hypothesis import strategies as st

from gatar_edge.agent import Agent, Identity, Inbox
from gatar_edge.allocators.cbba import Cbba
from gatar_edge.allocators.greedy import Greedy
from gatar_edge.config import AgentConfig
from gatar_edge.keys import DEMO_KEY
from gatar_edge.neighbors import HearOutcome
from gatar_edge.talk import MAX_DATAGRAM_BYTES, MAX_PAYLOAD_BYTES, Talk
from gatar_edge.types import RobotKind

OPEN = [(x, y) for x in range(15) for y in range(15)]


def talk(robot_id: int = 1, key: bytes = DEMO_KEY, digest: int = 7) -> Talk:
    return Talk(robot_id, key, digest, 1)


def test_payload_arrives_as_it_was_sent() -> None:
    for payload in (b"x", bytes(MAX_PAYLOAD_BYTES)):
        datagram = talk().seal(payload)
        assert len(datagram) <= MAX_DATAGRAM_BYTES
        assert talk(2).open(datagram) == (HearOutcome.TALK, payload)


@pytest.mark.parametrize("payload", [b"", bytes(MAX_PAYLOAD_BYTES + 1)])
def test_payload_that_does_not_fit_is_not_sealed(payload: bytes) -> None:
    with pytest.raises(ValueError, match="payload has"):
        talk().seal(payload)


def test_a_datagram_is_let_in_once_and_none_that_it_overtook() -> None:
    speaker, listener = talk(), talk(2)
    first, second = speaker.seal(b"1"), speaker.seal(b"2")
    assert [listener.open(data)[0] for data in (second, second, first)] == [
        HearOutcome.TALK,
        HearOutcome.OLDER,
        HearOutcome.OLDER,
    ]


def test_strangers_and_echoes_are_told_apart() -> None:
    assert talk(2).open(talk(key=bytes(32)).seal(b"x"))[0] is HearOutcome.FORGED
    assert talk(2).open(talk(digest=8).seal(b"x"))[0] is HearOutcome.FOREIGN_CONFIG
    assert talk(1).open(talk().seal(b"x"))[0] is HearOutcome.OWN


@given(st.binary(max_size=200))
def test_any_bytes_are_judged_without_an_exception(data: bytes) -> None:
    assert talk(2).open(b"\xc1" + data)[0] in (HearOutcome.MALFORMED, HearOutcome.FORGED)


def test_agents_with_an_auction_talk_and_hear_each_other() -> None:
    one, two = (Agent(Identity(i, RobotKind.UAV, 1.0), AgentConfig(), Cbba(), DEMO_KEY) for i in (1, 2))
    one.tick(0, Inbox(observation((5, 3), OPEN, (), [(6, 3), (0, 3)], robot_id=1)))
    said = one.tick(0, Inbox())
    out = two.tick(0, Inbox(observation((4, 3), OPEN, (), [(6, 3), (0, 3)], robot_id=2), (said.message, *said.talks)))
    assert said.talks
    assert two.neighbors.counters[HearOutcome.TALK] == len(said.talks)
    assert out.decision.assignment.cell == (0, 3)  # the nearer one bids more for the other


def test_agents_whose_rule_does_not_talk_say_nothing_and_count_what_they_hear() -> None:
    silent = Agent(Identity(2, RobotKind.UAV, 1.0), AgentConfig(), Greedy(), DEMO_KEY)
    talker = Agent(Identity(1, RobotKind.UAV, 1.0), AgentConfig(), Cbba(), DEMO_KEY)
    said = talker.tick(0, Inbox(observation((5, 3), OPEN, (), [(6, 3)], robot_id=1))).talks
    out = silent.tick(0, Inbox(observation((4, 3), OPEN, (), [(6, 3)], robot_id=2), said))
    assert out.talks == ()
    assert silent.neighbors.counters[HearOutcome.TALK] == 1


def test_a_robot_without_eyes_says_nothing() -> None:
    assert Agent(Identity(1, RobotKind.UAV, 1.0), AgentConfig(), Cbba(), DEMO_KEY).tick(0, Inbox()).talks == ()
