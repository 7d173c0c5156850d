"""Hearing: each cause has its outcome, each message is news once, and no clock but the local one counts."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from gatar_edge import neighbors
from gatar_edge.errors import ConfigError
from gatar_edge.keys import DEMO_KEY
from gatar_edge.message import NeighborMessage, decode, encode
from gatar_edge.neighbors import HearOutcome, NeighborTable
from gatar_edge.types import NS_PER_S, RobotKind, TaskKind

DIGEST = 77
MAX_AGE_NS = 3 * NS_PER_S
MESSAGE = NeighborMessage(
    robot_id=2,
    kind=RobotKind.UAV,
    seq=10,
    t_ms=0,
    cell=(0, 0),
    speed_cells_s=1.0,
    task=TaskKind.HOLD,
    task_cell=(0, 0),
    cost=0.0,
    window_origin=(-7, -7),
    window=np.zeros((15, 15), np.uint8),
    config_digest=DIGEST,
)


def table(robot_id: int = 1, hop_limit: int = 2, max_neighbors: int = 63) -> NeighborTable:
    """Of a robot that does not know where it is: it passes on all that is news."""
    return NeighborTable(
        robot_id,
        DEMO_KEY,
        DIGEST,
        hop_limit=hop_limit,
        max_age_ns=MAX_AGE_NS,
        r_comm=6.0,
        max_neighbors=max_neighbors,
    )


def sent(**changes: Any) -> bytes:
    return encode(replace(MESSAGE, **changes), DEMO_KEY)


def fresh_ids(heard_by: NeighborTable, now_ns: int, own_cell: tuple[int, int] = (0, 0)) -> list[int]:
    return [neighbor.robot_id for neighbor in heard_by.fresh(now_ns, own_cell)]


def resigned(data: bytes, at: int, value: int) -> bytes:
    """`data` with another byte, signed by a holder of the key who does not keep to the format."""
    body = bytearray(data[:-8])
    body[at] = value
    return bytes(body) + hashlib.blake2b(body, digest_size=8, key=DEMO_KEY, person=b"gatar-v1").digest()


@pytest.mark.parametrize(
    ("data", "outcome"),
    [
        (sent(), HearOutcome.ACCEPTED),
        (sent(robot_id=1), HearOutcome.OWN),
        (sent(robot_id=1, hops=1), HearOutcome.OWN),
        (sent(config_digest=DIGEST + 1), HearOutcome.FOREIGN_CONFIG),
        (sent(hops=2), HearOutcome.TOO_FAR),
        (encode(MESSAGE, bytes(32)), HearOutcome.FORGED),
        (b"\x09" + sent()[1:], HearOutcome.VERSION),
        (sent()[:50], HearOutcome.MALFORMED),
        (b"", HearOutcome.MALFORMED),
        (resigned(sent(), at=1, value=0xFF), HearOutcome.MALFORMED),
    ],
)
def test_each_cause_has_its_outcome_and_is_counted(data: bytes, outcome: HearOutcome) -> None:
    hearing = table()
    assert hearing.hear(data, 0).outcome is outcome
    assert {cause: count for cause, count in hearing.counters.items() if count} == {outcome: 1}


@pytest.mark.parametrize("kind", [bytearray, memoryview, lambda data: memoryview(bytearray(data))])
def test_a_datagram_in_a_buffer_is_heard_like_bytes(kind: Callable[[bytes], bytearray | memoryview]) -> None:
    hearing = table()
    assert hearing.hear(kind(sent()), 0) == table().hear(sent(), 0)
    assert hearing.hear(kind(sent()[:50]), 0).outcome is HearOutcome.MALFORMED
    assert hearing.hear(kind(b""), 0).outcome is HearOutcome.MALFORMED


def test_an_accepted_message_is_handed_on_as_it_was_sent() -> None:
    assert table().hear(sent(), 0).message == MESSAGE


def test_only_rising_sequences_are_news() -> None:
    hearing = table()
    outcomes = [hearing.hear(sent(seq=seq), 0).outcome for seq in (10, 10, 9, 12, 11)]
    assert outcomes == [
        HearOutcome.ACCEPTED,
        HearOutcome.DUPLICATE,
        HearOutcome.OLDER,
        HearOutcome.ACCEPTED,
        HearOutcome.OLDER,
    ]


def test_what_is_not_news_brings_neither_message_nor_relay() -> None:
    hearing = table()
    hearing.hear(sent(), 0)
    for data in (sent(), sent(hops=1), sent(seq=9), sent(robot_id=1), b"noise"):
        heard = hearing.hear(data, 1)
        assert (heard.message, heard.relay) == (None, None)


def test_with_two_hops_a_message_reaches_the_neighbours_neighbour_and_stops_there() -> None:
    first, second, third = table(robot_id=3), table(robot_id=4), table(robot_id=5)
    relay = first.hear(sent(), 0).relay
    assert relay is not None
    assert decode(relay, DEMO_KEY) == replace(MESSAGE, hops=1)
    heard = second.hear(relay, 0)
    assert (heard.outcome, heard.relay) == (HearOutcome.ACCEPTED, None)
    assert third.hear(sent(hops=2), 0).outcome is HearOutcome.TOO_FAR


@pytest.mark.parametrize(
    ("far_cell", "relayed"),
    [((3, 0), False), ((8, 0), True), ((11, 0), False), ((-1, -1), True)],
    ids=["nobody lacks it that reaches us", "in our range alone", "out of range of both", "anywhere"],
)
def test_a_robot_that_may_lack_a_message_is_told(far_cell: tuple[int, int], relayed: bool) -> None:
    hearing = table()
    for robot_id in range(10, 20):
        hearing.hear(sent(robot_id=robot_id, cell=(1, 0)), 0, (4, 0))
    hearing.hear(sent(robot_id=3, cell=far_cell), 0, (4, 0))
    heard = [hearing.hear(sent(seq=seq), 0, (4, 0)).relay is not None for seq in range(10, 40)]
    assert all(heard) if relayed else sum(heard) < 15


@pytest.mark.parametrize(("hop_limit", "hops_relayed"), [(0, []), (1, []), (2, [0]), (4, [0, 1, 2])])
def test_a_relay_is_made_only_for_those_who_may_accept_it(hop_limit: int, hops_relayed: list[int]) -> None:
    relayed = [hops for hops in range(6) if table(hop_limit=hop_limit).hear(sent(hops=hops), 0).relay is not None]
    assert relayed == hops_relayed


def test_a_hop_limit_beyond_the_format_breaks_nothing() -> None:
    hearing = table(hop_limit=1000)
    assert hearing.hear(sent(hops=255), 0).outcome is HearOutcome.TOO_FAR
    assert hearing.hear(sent(hops=254), 0).relay is None


def test_a_direct_copy_that_a_relay_overtook_is_relayed_once_but_makes_nobody_younger() -> None:
    hearing = table()
    hearing.hear(sent(hops=1), 0)
    direct = hearing.hear(sent(hops=0), NS_PER_S)
    assert direct.outcome is HearOutcome.NEARER
    assert direct.message == MESSAGE
    assert direct.relay == sent(hops=1)
    (neighbor,) = hearing.fresh(NS_PER_S, (0, 0))
    assert (neighbor.hops, neighbor.age_ns(NS_PER_S)) == (0, NS_PER_S)
    assert hearing.hear(sent(hops=0), NS_PER_S).outcome is HearOutcome.DUPLICATE


def test_a_neighbour_leaves_when_it_was_not_heard_for_longer_than_the_limit() -> None:
    hearing = table()
    hearing.hear(sent(), NS_PER_S)
    assert fresh_ids(hearing, NS_PER_S + MAX_AGE_NS) == [2]
    assert fresh_ids(hearing, NS_PER_S + MAX_AGE_NS + 1) == []


def test_one_that_speaks_again_stays_when_others_leave() -> None:
    hearing = table()
    hearing.hear(sent(robot_id=2), 0)
    hearing.hear(sent(robot_id=3), 0)
    hearing.hear(sent(robot_id=2, seq=11), MAX_AGE_NS)
    assert fresh_ids(hearing, MAX_AGE_NS + 1) == [2]


def test_a_recording_does_not_bring_a_silent_robot_back() -> None:
    hearing = table()
    hearing.hear(sent(), 0)
    much_later_ns = 3600 * NS_PER_S
    for data in (sent(), sent(seq=9), sent(hops=1)):
        assert hearing.hear(data, much_later_ns).message is None
    assert fresh_ids(hearing, much_later_ns) == []
    assert hearing.hear(sent(seq=11), much_later_ns).outcome is HearOutcome.ACCEPTED


@pytest.mark.parametrize("skew_ms", [0, 5_000, 10_000_000])
def test_a_neighbours_clock_changes_nothing(skew_ms: int) -> None:
    hearing = table()
    for tick in range(3):  # the second message even steps the clock back
        hearing.hear(sent(seq=10 + tick, t_ms=skew_ms * (2 - tick)), tick * NS_PER_S)
    (neighbor,) = hearing.fresh(4 * NS_PER_S, (0, 0))
    assert (neighbor.message.seq, neighbor.age_ns(4 * NS_PER_S)) == (12, 2 * NS_PER_S)


def test_neighbours_are_sorted_by_id_whatever_the_order_of_reception() -> None:
    hearing = table()
    for robot_id in (9, 3, 7, 65535, 0):
        hearing.hear(sent(robot_id=robot_id), 0)
    assert fresh_ids(hearing, 0) == [0, 3, 7, 9, 65535]


def test_of_too_many_neighbours_the_nearest_are_used_and_of_equals_the_lower_ids() -> None:
    hearing = table(max_neighbors=3)
    for robot_id, cell in ((5, (10, 10)), (6, (13, 14)), (7, (9, 10)), (8, (11, 10)), (9, (-500, 0)), (10, (10, 11))):
        hearing.hear(sent(robot_id=robot_id, cell=cell), 0)
    assert fresh_ids(hearing, 0, own_cell=(10, 10)) == [5, 7, 8]
    assert fresh_ids(hearing, 0, own_cell=(-499, 0)) == [5, 7, 9]


def test_sixty_four_robots_make_a_team_of_sixty_three_neighbours() -> None:
    hearing = table()
    for robot_id in range(2, 66):
        hearing.hear(sent(robot_id=robot_id, cell=(robot_id, 0)), 0)
    assert fresh_ids(hearing, 0) == list(range(2, 65))


def test_memory_is_bounded_and_the_longest_silent_author_is_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(neighbors, "MAX_AUTHORS", 3)
    hearing = table()
    for now_ns, robot_id in enumerate((2, 3, 4)):
        hearing.hear(sent(robot_id=robot_id), now_ns)
    hearing.hear(sent(robot_id=2, seq=11), 3)  # so that 3 is the longest silent
    hearing.hear(sent(robot_id=5), 4)
    assert fresh_ids(hearing, 4) == [2, 4, 5]
    assert hearing.hear(sent(robot_id=2, seq=11), 5).outcome is HearOutcome.DUPLICATE
    assert hearing.hear(sent(robot_id=3), 5).outcome is HearOutcome.ACCEPTED


def test_a_signed_but_senseless_message_does_not_use_up_its_sequence() -> None:
    hearing = table()
    assert hearing.hear(resigned(sent(seq=20), at=1, value=0xFF), 0).outcome is HearOutcome.MALFORMED
    assert hearing.hear(sent(seq=11), 0).outcome is HearOutcome.ACCEPTED


def test_a_flood_of_copies_never_unpacks_a_window(monkeypatch: pytest.MonkeyPatch) -> None:
    hearing = table()
    hearing.hear(sent(), 0)

    def fail(data: bytes) -> NeighborMessage:
        raise AssertionError("a copy was unpacked")

    monkeypatch.setattr(neighbors, "unpack", fail)
    for data in (sent(), sent(hops=1), sent(seq=9), encode(MESSAGE, bytes(32))):
        assert hearing.hear(data, 0).message is None


@pytest.mark.parametrize("length", [0, 31, 33])
def test_a_table_without_a_whole_key_is_refused(length: int) -> None:
    with pytest.raises(ConfigError, match=f"has {length} bytes, must be 32"):
        NeighborTable(1, bytes(length), DIGEST, hop_limit=2, max_age_ns=MAX_AGE_NS, r_comm=6.0)


def test_old_news_by_a_shorter_way_from_a_robot_long_silent_is_taken() -> None:
    hearing = table()
    hearing.hear(sent(hops=1), 0, (4, 0))
    later_ns = 2 * MAX_AGE_NS
    hearing.hear(sent(robot_id=3), later_ns, (4, 0))
    assert hearing.hear(sent(hops=0), later_ns, (4, 0)).outcome is HearOutcome.NEARER
