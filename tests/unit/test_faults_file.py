"""Faults as a file: what is declared happens, and nothing else is accepted."""

from __future__ import annotations

from pathlib import Path

import pytest

from gatar_edge.errors import ConfigError
from gatar_edge.sim_sitl.faults import Burst, Faults, LinkFaults
from gatar_edge.sim_sitl.faults_file import load_faults, parse_faults
from gatar_edge.sim_sitl.incident_types import Battery, PilotMode
from gatar_edge.sim_sitl.lanes import Lane

S, MS = 1_000_000_000, 1_000_000
EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "faults.toml"


def carried(count: int = 2000, **faults: object) -> list[tuple[int, bytes]]:
    """(arrival, datagram) of datagrams sent one a millisecond."""
    lane = Lane(LinkFaults(**faults), "key")  # type: ignore[arg-type]
    lane.begin(0)
    return [arrival for n in range(count) for arrival in lane.carry(n * MS, n.to_bytes(4, "big"))]


def test_an_empty_file_is_no_fault_at_all() -> None:
    assert parse_faults(b"") == Faults()
    assert parse_faults(b"[radio]\n").radio.none


def test_the_example_declares_what_it_says() -> None:
    faults = load_faults(EXAMPLE)
    assert faults.radio.burst == Burst(0.01, 0.2, 0.9)
    assert (faults.radio.delay_min_ns, faults.radio.delay_max_ns) == (20 * MS, 100 * MS)
    assert faults.between[1, 2].blackouts_ns == ((10 * S, 15 * S), (30 * S, 31_500 * MS))
    assert faults.link_of(3) == (faults.to_vehicle, LinkFaults(loss=0.4))
    assert faults.link_of(1) == (faults.to_vehicle, faults.to_companion)
    assert Battery(robot=2, at_s=12, percent=15) in faults.incidents


def test_a_killed_robot_is_one_with_a_time() -> None:
    assert parse_faults(b'[[event]]\ndo = "kill_robot"\nrobot = 2\nat_s = 1.5').kill_ns == {2: 1_500 * MS}


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (b"[radio]\nlss = 0.1", "unknown field `lss` - at `$.radio`"),
        (b"[radio]\nloss = 2", "<= 1.0 - at `$.radio.loss`"),
        (b"[radio]\nburst = {enter = 1}", "missing required field `leave` - at `$.radio.burst`"),
        (b"[to_vehicle]\nblackouts_s = [[5, 3]]", "a blackout lasts from"),
        (b"[to_vehicle]\nbandwidth_bytes_s = 3", "bandwidth is 3 bytes a second"),
        (b"[[event]]\nat_s = 1\nrobot = 1\ndo = 'explode'", "Invalid value 'explode' - at `$.event[0].do`"),
        (b"[[event]]\nat_s = 1\nrobot = 1\ndo = 'battery'", "missing required field `percent` - at `$.event[0]`"),
        (b"[[telemetry]]\nrobot = 1\ndirection = 'up'", "Invalid enum value 'up' - at `$.telemetry[0].direction`"),
        (b"[[between]]\nsender = 1\nreceiver = 2\n" * 2, "[[between]] has 1 to 2 twice"),
        (b"[[telemetry]]\nrobot = 1\ndirection = 'to_vehicle'\n" * 2, "[[telemetry]] has robot 1, to_vehicle twice"),
        (b"[[event]]\nat_s = 1\nrobot = 1\ndo = 'kill_robot'\n" * 2, "kill_robot has robot 1 twice"),
        (b"radio = 5", "Expected `object`"),
        (b"[radio", "Expected ']'"),
        (b"\xff\xfe", "faults:"),
        (b"x" * 1_000_001, "the limit is 1000000"),
    ],
)
def test_a_file_that_declares_nothing_known_is_refused_by_name(text: bytes, says: str) -> None:
    with pytest.raises(ConfigError) as refused:
        parse_faults(text)
    assert says in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_file_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be read"):
        load_faults(tmp_path / "none.toml")


def test_a_robot_that_the_team_has_not_is_refused() -> None:
    faults = Faults(incidents=(PilotMode(robot=7, at_s=1, mode="HOLD"),))
    with pytest.raises(ConfigError, match="robot 7, the team has 1 to 3"):
        faults.check((1, 2, 3))


def test_bursts_lose_as_much_as_declared_and_in_runs() -> None:
    arrived = {int.from_bytes(datagram, "big") for _, datagram in carried(5000, burst=Burst(0.02, 0.2))}
    lost = [n for n in range(5000) if n not in arrived]
    assert len(lost) == pytest.approx(5000 * 0.02 / 0.22, rel=0.25)
    starts = [n for n in lost if n - 1 in arrived]
    assert len(lost) / len(starts) == pytest.approx(5, rel=0.3)


def test_a_corrupted_datagram_differs_in_one_byte() -> None:
    for n, (_, datagram) in enumerate(carried(200, corrupt=1.0)):
        assert sum(a != b for a, b in zip(datagram, n.to_bytes(4, "big"), strict=True)) == 1


def test_nothing_gets_through_during_a_blackout() -> None:
    sent_ns = [due_ns for due_ns, _ in carried(100, blackouts_ns=((10 * MS, 20 * MS),))]
    assert sent_ns == [n * MS for n in range(100) if not 10 <= n < 20]


def test_a_blackout_waits_for_the_mission_to_begin() -> None:
    lane = Lane(LinkFaults(blackouts_ns=((0, 5 * MS),)), "key")
    assert lane.carry(0, b"x")
    lane.begin(100 * MS)
    assert not lane.carry(101 * MS, b"x")
    assert lane.carry(105 * MS, b"x")


def test_a_narrow_link_delays_and_then_loses() -> None:
    arrivals = carried(2000, bandwidth_bytes_s=1000)  # offered: 4000
    assert arrivals[0][0] == 4 * MS
    assert len(arrivals) == pytest.approx(750, abs=20)  # two seconds, and one in the queue
    assert max(due_ns - int.from_bytes(datagram, "big") * MS for due_ns, datagram in arrivals) <= 1 * S


def test_a_replayed_datagram_comes_again_later() -> None:
    arrivals = carried(10, replay=1.0, replay_after_ns=3 * S)
    assert len(arrivals) == 20
    assert (3 * S, bytes(4)) in arrivals


def test_rarer_faults_do_not_shift_the_common_ones() -> None:
    plain = [datagram for _, datagram in carried(500, loss=0.3)]
    also = [datagram for _, datagram in carried(500, loss=0.3, burst=Burst(0.0, 1.0), replay=1e-9)]
    assert plain == also
