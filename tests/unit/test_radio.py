"""The radio between robots and the faulty link to an autopilot."""

from __future__ import annotations

import pytest

from gatar_edge.errors import ConfigError
from gatar_edge.sim_sitl.faults import Faults, LinkFaults
from gatar_edge.sim_sitl.faulty_link import End, FaultyLink, split_frames
from gatar_edge.sim_sitl.radio import Radio
from gatar_edge.sim_sitl.testing import COPTER, Client

POSITIONS = {1: (0.0, 0.0), 2: (3.0, 4.0), 3: (9.0, 0.0)}
MS = 1_000_000


def fates(seed: int, count: int = 300, **faults: float) -> list[tuple[int, bytes]]:
    radio = Radio(100, LinkFaults(**faults), seed)
    for number in range(count):
        radio.send(number, 1, number.to_bytes(4, "big"), {1: (0, 0), 2: (1, 0)})
    return radio.deliver(10**12)


def test_a_perfect_radio_reaches_all_within_range_and_nobody_else() -> None:
    radio = Radio(5.0)
    radio.send(7, 1, b"hello", POSITIONS)
    assert radio.deliver(7) == [(2, b"hello")]
    assert radio.deliver(100) == []
    assert (radio.sent, radio.sent_bytes, radio.delivered) == (1, 5, 1)


def test_a_delayed_datagram_arrives_when_it_is_due_and_not_before() -> None:
    radio = Radio(5.0, LinkFaults(delay_min_ns=50 * MS, delay_max_ns=50 * MS))
    radio.send(0, 1, b"x", POSITIONS)
    assert radio.deliver(50 * MS - 1) == []
    assert radio.deliver(50 * MS) == [(2, b"x")]


def test_the_same_seed_gives_the_same_fates_and_another_seed_does_not() -> None:
    faults = {"loss": 0.3, "duplicate": 0.1, "reorder": 0.5, "delay_max_ns": 400 * MS}
    assert fates(1, **faults) == fates(1, **faults)
    assert fates(1, **faults) != fates(2, **faults)


def test_loss_and_duplicates_come_as_often_as_declared() -> None:
    assert len(fates(0, 2000, loss=0.3)) == pytest.approx(1400, abs=80)
    assert len(fates(0, 2000, duplicate=0.1)) == pytest.approx(2200, abs=60)
    assert fates(0, 100, loss=1.0) == []


def test_without_reordering_nothing_overtakes_and_with_it_something_does() -> None:
    in_order = [datagram for _, datagram in fates(0, delay_max_ns=400 * MS)]
    assert in_order == sorted(in_order)
    shuffled = [datagram for _, datagram in fates(0, delay_max_ns=400 * MS, reorder=1.0)]
    assert shuffled != sorted(shuffled)
    assert sorted(shuffled) == in_order


def test_a_robot_that_disappears_changes_nothing_for_the_others() -> None:
    def heard(positions: dict[int, tuple[float, float]]) -> list[bytes]:
        radio = Radio(100, LinkFaults(loss=0.5), seed=3)
        for number in range(100):
            radio.send(number, 1, bytes([number]), positions)
        return [datagram for receiver, datagram in radio.deliver(1000) if receiver == 2]

    assert heard(POSITIONS) == heard({1: POSITIONS[1], 2: POSITIONS[2]})


@pytest.mark.parametrize("faults", [{"loss": 1.1}, {"reorder": -0.1}, {"delay_min_ns": 5, "delay_max_ns": 4}])
def test_faults_that_cannot_be_are_refused_with_the_value(faults: dict[str, float]) -> None:
    with pytest.raises(ConfigError, match=r"must"):
        LinkFaults(**faults)  # type: ignore[arg-type]


def test_a_radio_of_negative_range_is_refused() -> None:
    with pytest.raises(ConfigError, match="-1"):
        Radio(-1)


def test_a_robot_is_dead_from_its_kill_time_on() -> None:
    faults = Faults(kill_ns={2: 5})
    assert [faults.killed(2, 4), faults.killed(2, 5), faults.killed(1, 99)] == [False, True, False]


def test_a_link_carries_each_frame_of_a_burst_on_its_own() -> None:
    client = Client(COPTER)
    client.vehicle.step(10**9)
    burst = client.vehicle.take()
    frames = split_frames(burst)
    assert len(frames) > 2
    assert b"".join(frames) == burst
    link = FaultyLink(LinkFaults(), LinkFaults(loss=0.5), seed=1)
    link.send(0, End.VEHICLE, burst * 20)
    arrived = link.deliver(0)
    assert {end for end, _ in arrived} == {End.COMPANION}
    assert 0 < len(arrived) < 20 * len(frames)
    assert {frame for _, frame in arrived} <= set(frames)


def test_what_is_no_frame_stays_in_one_piece_and_a_cut_frame_is_not_lengthened() -> None:
    assert split_frames(b"hello") == [b"hello"]
    assert split_frames(b"\xfd\x20\x00abc") == [b"\xfd\x20\x00abc"]
    assert split_frames(b"") == []


def test_the_two_directions_have_their_own_faults() -> None:
    link = FaultyLink(to_vehicle=LinkFaults(loss=1.0), to_companion=LinkFaults(delay_min_ns=5, delay_max_ns=5))
    link.send(0, End.COMPANION, b"up")
    link.send(0, End.VEHICLE, b"down")
    assert link.deliver(4) == []
    assert link.deliver(5) == [(End.COMPANION, b"down")]
