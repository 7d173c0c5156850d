"""The byte budget: never exceeded in any second, own messages first, relays in turn."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gatar_edge.errors import ConfigError
from gatar_edge.transports.budget import BudgetCounters, ByteBudget
from gatar_edge.types import NS_PER_S

OWN = b"o" * 127
TICK_NS = NS_PER_S // 5


def relays(count: int) -> list[bytes]:
    return [bytes((author,)) * 127 for author in range(count)]


def test_within_the_budget_all_is_sent_own_messages_first() -> None:
    budget = ByteBudget(10_000)
    assert budget.admit([OWN], relays(3), 0) == [OWN, *relays(3)]
    assert budget.counters == BudgetCounters(own_sent=1, relays_sent=3, bytes_sent=4 * 127)


@settings(derandomize=True, deadline=None, database=None)
@given(
    st.integers(512, 5000),
    st.lists(st.tuples(st.integers(0, NS_PER_S // 2), st.integers(0, 40), st.integers(0, 40)), max_size=60),
)
def test_no_second_wherever_it_begins_sees_more_than_the_budget(
    bytes_per_s: int, ticks: list[tuple[int, int, int]]
) -> None:
    budget = ByteBudget(bytes_per_s)
    now_ns, sent = 0, []
    for passed_ns, own, relayed in ticks:
        now_ns += passed_ns
        sent.append((now_ns, sum(map(len, budget.admit([OWN] * own, relays(relayed), now_ns)))))
    for start_ns, _ in sent:
        assert sum(size for t_ns, size in sent if start_ns <= t_ns <= start_ns + NS_PER_S) <= bytes_per_s
    assert budget.counters.bytes_sent == sum(size for _, size in sent)


def test_under_constant_pressure_each_second_is_used_but_not_overdrawn() -> None:
    budget = ByteBudget(10_000)
    sizes = [sum(map(len, budget.admit([OWN], relays(40), tick * TICK_NS))) for tick in range(50)]
    seconds = [sum(sizes[start : start + 6]) for start in range(1, 45)]  # both ends included
    assert 7_500 < min(seconds) <= max(seconds) <= 10_000


def test_own_messages_never_wait_for_relays() -> None:
    budget = ByteBudget(1024)
    for tick in range(100):
        assert budget.admit([OWN], relays(11), tick * TICK_NS)[:1] == [OWN]
    assert budget.counters.own_dropped == 0
    assert budget.counters.relays_dropped > budget.counters.relays_sent > 0


def test_relays_leave_room_for_an_own_message_at_any_moment() -> None:
    budget = ByteBudget(2000)
    assert len(budget.admit([], relays(11), 0)) == 2
    assert budget.admit([OWN], [], 0) == [OWN]


def test_relays_that_do_not_all_fit_take_turns() -> None:
    budget = ByteBudget(1500)
    authors = [data[0] for tick in range(100) for data in budget.admit([OWN], relays(11), tick * TICK_NS)[1:]]
    counts = [authors.count(author) for author in range(11)]
    assert min(counts) > 0
    assert max(counts) - min(counts) <= 1


def test_own_messages_beyond_the_budget_are_dropped_and_counted() -> None:
    budget = ByteBudget(512)
    assert budget.admit([OWN] * 5, [], 0) == [OWN] * 3
    assert (budget.counters.own_sent, budget.counters.own_dropped) == (3, 2)


def test_after_a_silence_no_more_than_the_burst_leaves_at_once() -> None:
    budget = ByteBudget(10_000, burst_bytes=512)
    budget.admit([], [], 0)
    assert len(budget.admit([OWN] * 9, [], 1000 * NS_PER_S)) == 4


def test_a_clock_that_stands_or_goes_back_fills_nothing() -> None:
    budget = ByteBudget(512)
    budget.admit([OWN] * 3, [], NS_PER_S)
    assert budget.admit([OWN], [], NS_PER_S) == []
    assert budget.admit([OWN], [], 0) == []
    assert budget.admit([OWN], [], NS_PER_S + TICK_NS) == []  # 3 + 25 of 127 bytes
    assert budget.admit([OWN], [], NS_PER_S + 5 * TICK_NS) == [OWN]


def test_a_clock_that_goes_back_takes_nothing_away() -> None:
    budget = ByteBudget(512)
    budget.admit([], [], 1000 * NS_PER_S)
    assert budget.admit([OWN] * 3, [], 0) == [OWN] * 3


def test_a_message_to_several_peers_costs_its_bytes_for_each() -> None:
    budget = ByteBudget(10_000, burst_bytes=1536, sends=4)
    assert budget.admit([OWN] * 9, [], 0) == [OWN] * 3
    assert budget.counters.bytes_sent == 3 * 4 * 127


@pytest.mark.parametrize(
    ("bytes_per_s", "burst", "sends"), [(511, None, 1), (0, None, 1), (2000, 383, 1), (2047, None, 4)]
)
def test_a_budget_too_small_for_a_message_and_a_relay_is_refused(
    bytes_per_s: int, burst: int | None, sends: int
) -> None:
    with pytest.raises(ConfigError, match=f"a budget of {bytes_per_s} bytes/s .* is too small"):
        ByteBudget(bytes_per_s, burst, sends)
