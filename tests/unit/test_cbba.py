"""The auction: bundles, what is told of them, and what loss and silence do to it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from builders import belief_of, robot, view_of
from hypothesis import given
from hypothesis import strategies as st

from gatar_edge.allocators.base import NO_TARGET, Negotiator
from gatar_edge.allocators.cbba import BUNDLE, MAX_AGE_MS, MAX_PAYLOAD_BYTES, Cbba, decoded
from gatar_edge.talk import MAX_PAYLOAD_BYTES as TALK_PAYLOAD_BYTES
from gatar_edge.types import NS_PER_S, ByteGrid, Cell, CellState, RobotKind, RobotState
from gatar_edge.view import View, build_view

ROW = belief_of("T......T")


def team_of(count: int, seed: int, targets: int = 10) -> tuple[ByteGrid, list[RobotState]]:
    rng = np.random.default_rng(seed)
    belief = np.full((15, 15), CellState.FREE, dtype=np.uint8)
    cells = rng.permutation(225)
    belief.flat[cells[:20]] = CellState.OBSTACLE
    belief.flat[cells[20 : 20 + targets]] = CellState.TARGET
    places = [(int(c) // 15, int(c) % 15) for c in cells[40 : 40 + count]]
    return belief, [robot(i + 1, place, RobotKind(i % 2)) for i, place in enumerate(places)]


def seen_by(index: int, belief: ByteGrid, team: Sequence[RobotState], now_ns: int = 0) -> View:
    others = [other for other in team if other is not team[index]]
    return build_view(now_ns, team[index], others, belief, 6.0, 2, 64)


def negotiate(auction: list[Cbba], views: list[View], links: Sequence[tuple[int, int]], rounds: int) -> None:
    for _ in range(rounds):
        said = [one.bid(view) for one, view in zip(auction, views, strict=True)]
        for sender, receiver in links:
            for payload in said[sender]:
                auction[receiver].heard(payload, views[receiver].now_ns)


def own_choices(auction: list[Cbba], views: list[View]) -> list[int]:
    return [int(one.allocate(view).choices[0]) for one, view in zip(auction, views, strict=True)]


def chain(count: int) -> list[tuple[int, int]]:
    return [(i, j) for i in range(count) for j in range(count) if abs(i - j) == 1]


def test_robots_in_a_chain_agree_on_different_targets_after_some_rounds() -> None:
    for seed in range(8):
        belief, team = team_of(5, seed)
        views = [seen_by(index, belief, team) for index in range(5)]
        auction = [Cbba() for _ in team]
        negotiate(auction, views, chain(5), rounds=12)
        chosen = [choice for choice in own_choices(auction, views) if choice != NO_TARGET]
        assert len(chosen) == len(set(chosen)) >= 4


def test_agreement_stands_still_once_it_is_reached() -> None:
    belief, team = team_of(5, 3)
    views = [seen_by(index, belief, team) for index in range(5)]
    auction = [Cbba() for _ in team]
    negotiate(auction, views, chain(5), rounds=12)
    agreed = [one.allocate(view).choices.tolist() for one, view in zip(auction, views, strict=True)]
    negotiate(auction, views, chain(5), rounds=3)
    assert [one.allocate(view).choices.tolist() for one, view in zip(auction, views, strict=True)] == agreed


def test_without_a_radio_everybody_bids_for_the_best_alone() -> None:
    near, far = robot(1, (1, 0)), robot(2, (2, 0))
    views = [view_of(ROW, near, [far]), view_of(ROW, far, [near])]
    assert own_choices([Cbba(), Cbba()], views) == [0, 0]


def test_the_higher_bid_wins_and_the_loser_takes_the_next_target() -> None:
    near, far = robot(2, (1, 0)), robot(1, (2, 0))
    views = [view_of(ROW, near, [far]), view_of(ROW, far, [near])]
    auction = [Cbba(), Cbba()]
    negotiate(auction, views, [(0, 1), (1, 0)], rounds=1)
    assert own_choices(auction, views) == [0, 1]


def test_of_equal_bids_the_smaller_id_wins() -> None:
    one, two = robot(1, (1, 0)), robot(2, (1, 0))
    views = [view_of(ROW, two, [one]), view_of(ROW, one, [two])]
    auction = [Cbba(), Cbba()]
    negotiate(auction, views, [(0, 1), (1, 0)], rounds=1)
    assert own_choices(auction, views) == [1, 0]


def test_others_are_believed_to_go_where_their_bundles_begin() -> None:
    near, far = robot(1, (1, 0)), robot(2, (6, 0))
    auction = [Cbba(), Cbba()]
    views = [view_of(ROW, near, [far]), view_of(ROW, far, [near])]
    negotiate(auction, views, [(0, 1), (1, 0)], rounds=2)
    assert auction[0].allocate(views[0]).choices.tolist() == [0, 1]


def test_bundle_of_a_robot_that_fell_silent_is_forgotten() -> None:
    belief, team = ROW, [robot(1, (1, 0)), robot(2, (2, 0))]
    winner, loser = Cbba(), Cbba()
    for payload in winner.bid(seen_by(0, belief, team)):
        loser.heard(payload, 0)
    in_time, too_late = MAX_AGE_MS * 1_000_000, MAX_AGE_MS * 1_000_000 + 1
    assert loser.allocate(seen_by(1, belief, team, in_time)).choices[0] == 1
    assert loser.allocate(seen_by(1, belief, team, too_late)).choices[0] == 0


def test_bundles_that_are_passed_on_do_not_get_younger() -> None:
    belief, team = ROW, [robot(1, (1, 0)), robot(2, (2, 0)), robot(3, (3, 0))]
    first, second, third = Cbba(), Cbba(), Cbba()
    for payload in first.bid(seen_by(0, belief, team)):
        second.heard(payload, 0)
    for payload in second.bid(seen_by(1, belief, team, 2 * NS_PER_S)):
        third.heard(payload, 2 * NS_PER_S)
    third.allocate(seen_by(2, belief, team, 4 * NS_PER_S))
    assert {bundle.robot_id for bundle in decoded(third.bid(seen_by(2, belief, team, 4 * NS_PER_S))[0], 0)} == {2, 3}


def test_overtaken_payload_changes_nothing() -> None:
    team = [robot(1, (1, 0)), robot(2, (2, 0))]
    winner, loser = Cbba(), Cbba()
    old = winner.bid(seen_by(0, ROW, team, 0))
    new = winner.bid(seen_by(0, belief_of("x......T"), team, NS_PER_S))  # it bids for the other target now
    for payload in (*new, *old):
        loser.heard(payload, NS_PER_S)
    assert loser.allocate(seen_by(1, ROW, team, NS_PER_S)).choices[0] == 0


def test_payloads_fit_the_datagram_however_many_robots_are_known() -> None:
    belief, team = team_of(12, 1, targets=16)
    views = [seen_by(index, belief, team) for index in range(12)]
    auction = [Cbba() for _ in team]
    negotiate(auction, views, chain(12), rounds=12)
    payloads = auction[0].bid(views[0])
    assert max(len(payload) for payload in payloads) <= MAX_PAYLOAD_BYTES == TALK_PAYLOAD_BYTES
    bundles = [bundle for payload in payloads for bundle in decoded(payload, 0)]
    assert len(bundles) == 12
    assert all(len(bundle.stops) <= BUNDLE for bundle in bundles)


@given(st.binary(max_size=300))
def test_any_bytes_are_heard_without_harm(payload: bytes) -> None:
    listener = Cbba()
    listener.heard(payload, NS_PER_S)
    cell: Cell = (2, 0)
    assert listener.allocate(view_of(ROW, robot(1, cell))).choices[0] in (NO_TARGET, 0, 1)


def test_the_auction_is_a_negotiator_and_greedy_is_none() -> None:
    from gatar_edge.allocators.greedy import Greedy

    assert isinstance(Cbba(), Negotiator)
    assert not isinstance(Greedy(), Negotiator)
