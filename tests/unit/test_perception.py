"""The perception datagram: what is taken in, what is dropped, and that nothing a sender does stops the robot."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gatar_edge.belief import same_sight
from gatar_edge.perception import (
    MAX_CELLS,
    MAX_OBSERVATION_BYTES,
    ObservationOutcome,
    Perception,
    encode_observation,
    observation_schema,
)
from gatar_edge.types import GridSpec, Observation, RobotKind

S = 1_000_000_000


def perception() -> Perception:
    return Perception(3, RobotKind.UGV, GridSpec(width=20, height=10))


def datagram(**changes: object) -> bytes:
    return json.dumps({"v": 1, "cell": [4, 5], "seen": [[4, 5], [5, 5]], **changes}).encode()


def outcome_of(data: bytes, own_cell: tuple[int, int] | None = None) -> ObservationOutcome:
    judge = perception()
    judge.take(data, 100 * S, own_cell)
    return next(outcome for outcome, count in judge.counters.items() if count)


def test_an_observation_survives_its_encoding_with_its_age_on_another_clock() -> None:
    sent = Observation(
        3,
        RobotKind.UGV,
        (4, 5),
        np.array([[4, 5], [19, 9]], np.int16),
        np.array([[19, 9]], np.int16),
        np.empty((0, 2), np.int16),
        t_ns=7 * S,
    )
    got = perception().take(encode_observation(sent, now_ns=9 * S), 1000 * S, None)
    assert got is not None
    assert (got.robot_id, got.kind, got.cell, got.t_ns) == (3, RobotKind.UGV, (4, 5), 998 * S)
    assert [getattr(got, name).tolist() for name in ("seen", "obstacles", "targets")] == [
        [[4, 5], [19, 9]],
        [[19, 9]],
        [],
    ]
    assert got.targets.shape == (0, 2)


def test_json_needs_only_version_and_seen_where_the_autopilot_knows_the_place() -> None:
    got = perception().take(b' {"v": 1, "seen": [[1, 2]]}', 5 * S, own_cell=(7, 7))
    assert got is not None
    assert got.cell == (7, 7)


@pytest.mark.parametrize(
    ("data", "outcome"),
    [
        (datagram(robot_id=4), ObservationOutcome.NOT_MINE),
        (datagram(cell=[20, 0]), ObservationOutcome.OFF_GRID),
        (datagram(cell=[0, -1]), ObservationOutcome.OFF_GRID),
        (datagram(cell=None), ObservationOutcome.NO_PLACE),
        (datagram(v=2), ObservationOutcome.MALFORMED),
        (datagram(obstacle=[]), ObservationOutcome.MALFORMED),
        (datagram(seen=[[0, 40_000]]), ObservationOutcome.MALFORMED),
        (datagram(seen=[[0.5, 1]]), ObservationOutcome.MALFORMED),
        (datagram(seen=[[1, 2, 3]]), ObservationOutcome.MALFORMED),
        (datagram(age_ms=-1), ObservationOutcome.MALFORMED),
        (msgspec.msgpack.encode({"v": 1, "seen": [[0, 0]] * (MAX_CELLS + 1)}), ObservationOutcome.MALFORMED),
        (b"", ObservationOutcome.MALFORMED),
        (b'{"\xff": 1}', ObservationOutcome.MALFORMED),
        (b"\x81\xa1\xff\x01", ObservationOutcome.MALFORMED),
        (b"{" * 10_000, ObservationOutcome.MALFORMED),
        (b"\x91" * 10_000, ObservationOutcome.MALFORMED),
        (b" " * (MAX_OBSERVATION_BYTES + 1), ObservationOutcome.TOO_LONG),
    ],
)
def test_each_bad_datagram_is_dropped_under_its_own_cause(data: bytes, outcome: ObservationOutcome) -> None:
    assert outcome_of(data) is outcome


@given(st.binary(max_size=200) | st.builds(datagram, seen=st.lists(st.lists(st.integers(), max_size=3), max_size=3)))
def test_no_bytes_whatever_raise(data: bytes) -> None:
    perception().take(data, 0, None)


def test_a_malformed_datagram_leaves_a_text_that_names_the_field() -> None:
    judge = perception()
    judge.take(datagram(seen="all"), 0, None)
    assert "$.seen" in judge.last_error


def test_older_data_does_not_replace_newer() -> None:
    judge = perception()
    assert judge.take(datagram(age_ms=10), 1 * S, None) is not None
    assert judge.take(datagram(age_ms=2000), 2 * S, None) is None
    assert judge.counters[ObservationOutcome.OLDER] == 1
    assert judge.age_ns(2 * S) == S + 10_000_000


def test_what_is_seen_again_is_the_same_arrays_and_anything_else_is_not() -> None:
    judge = perception()
    first, again, other = (
        judge.take(datagram(targets=targets, age_ms=age_ms), now_s * S, None)
        for now_s, age_ms, targets in ((100, 0, [[5, 5]]), (101, 7, [[5, 5]]), (102, 0, []))
    )
    assert first is not None
    assert again is not None
    assert other is not None
    assert again.t_ns == 101 * S - 7_000_000
    assert same_sight(first, again)
    assert not same_sight(first, other)
    assert other.targets.tolist() == []


def test_the_rate_falls_when_observations_stop() -> None:
    judge = perception()
    for tick in range(30):
        judge.take(datagram(), tick * S // 5, None)
    assert judge.rate_hz(29 * S // 5) == pytest.approx(5)
    assert judge.rate_hz(29 * S // 5 + 10 * S) < 2


def test_the_documented_schema_is_the_one_in_use() -> None:
    documented = Path(__file__).parents[2] / "docs" / "observation.schema.json"
    assert documented.read_bytes() == observation_schema()
