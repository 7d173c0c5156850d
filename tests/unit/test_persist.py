"""What a restarted robot knows: everything saved, or a fresh start with the reason; never a crash."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gatar_edge.agent import Agent, Identity
from gatar_edge.allocators.greedy import Greedy
from gatar_edge.config import AgentConfig
from gatar_edge.keys import DEMO_KEY
from gatar_edge.persist import (
    LoadOutcome,
    SavedState,
    StateSaver,
    decode_state,
    encode_state,
    load,
    restore,
    snapshot,
    write_atomically,
)
from gatar_edge.tasks import Task
from gatar_edge.types import GridSpec, RobotKind, TaskKind

S = 1_000_000_000
CONFIG = AgentConfig(grid=GridSpec(width=12, height=7))
NOON = 1_800_000_000 * S


def agent() -> Agent:
    return Agent(Identity(3, RobotKind.UGV, 1.0), CONFIG, Greedy(), DEMO_KEY, first_seq=500)


def saved() -> SavedState:
    robot = agent()
    belief = np.zeros((12, 7), np.uint8)
    belief[11, 0] = 3
    robot.belief = belief
    robot.task = Task(TaskKind.TARGET, (11, 0), ((10, 0), (11, 0)), 2)
    return snapshot(robot, NOON)


def loaded(
    path: Path, state: SavedState, *, after_s: float = 5, robot_id: int = 3, config: AgentConfig = CONFIG
) -> LoadOutcome:
    path.write_bytes(encode_state(state))
    return load(path, robot_id, config, NOON + int(after_s * S), max_age_s=600).outcome


def test_a_restarted_robot_has_its_belief_and_task_and_a_higher_sequence(tmp_path: Path) -> None:
    write_atomically(tmp_path / "state.bin", encode_state(saved()))
    restored = load(tmp_path / "state.bin", 3, CONFIG, NOON + 2 * S, max_age_s=600)
    assert restored.outcome is LoadOutcome.LOADED
    assert restored.state is not None
    robot = agent()
    restore(robot, restored.state)
    assert robot.belief.shape == (12, 7)
    assert robot.belief[11, 0] == 3
    assert robot.task == Task(TaskKind.TARGET, (11, 0), ((10, 0), (11, 0)), 2)
    assert restored.last_seq > 500 + 1000


def test_knowledge_of_another_robot_mission_or_day_is_not_used(tmp_path: Path) -> None:
    path = tmp_path / "state.bin"
    assert load(path, 3, CONFIG, NOON, 600).outcome is LoadOutcome.ABSENT
    assert loaded(path, saved(), robot_id=4) is LoadOutcome.OTHER_ROBOT
    assert loaded(path, saved(), config=AgentConfig()) is LoadOutcome.OTHER_MISSION
    assert loaded(path, saved(), after_s=601) is LoadOutcome.TOO_OLD
    assert loaded(path, saved(), after_s=-1) is LoadOutcome.TOO_OLD
    assert load(path, 3, CONFIG, NOON + 601 * S, 600).last_seq > 500


@pytest.mark.parametrize(
    "change",
    [
        {"task_kind": 9},
        {"width": 13},
        {"width": -12, "height": -7},
        {"belief": b"\x09" * 84},
        {"task_path": [(12, 0)]},
        {"next_seq": -1},
        {"changes": -1},
    ],
)
def test_a_state_that_makes_no_sense_counts_as_damaged(tmp_path: Path, change: dict[str, object]) -> None:
    state = msgspec.structs.replace(saved(), **change)
    assert loaded(tmp_path / "s", state) is LoadOutcome.DAMAGED


@given(st.integers(min_value=0), st.integers(0, 7), st.booleans())
def test_a_flipped_bit_or_a_cut_end_is_noticed(place: int, bit: int, cut: bool) -> None:
    data = bytearray(encode_state(saved()))
    place %= len(data)
    if cut:
        del data[place:]
    else:
        data[place] ^= 1 << bit
    assert decode_state(bytes(data)) is None


@given(st.binary(max_size=300))
def test_no_content_of_the_file_raises(data: bytes) -> None:
    decode_state(data)


def test_the_saver_writes_the_newest_state_before_it_closes(tmp_path: Path) -> None:
    saver = StateSaver(tmp_path / "state.bin")
    for seq in range(500, 540):
        saver.save_soon(msgspec.structs.replace(saved(), next_seq=seq))
    saver.close()
    state = decode_state((tmp_path / "state.bin").read_bytes())
    assert state is not None
    assert state.next_seq == 539
    assert [file.name for file in tmp_path.iterdir()] == ["state.bin"]


def test_a_disk_that_takes_nothing_is_counted_and_named(tmp_path: Path) -> None:
    saver = StateSaver(tmp_path / "absent" / "state.bin")
    saver.save_soon(saved())
    saver.close()
    assert (saver.saved, saver.failed) == (0, 1)
    assert "No such file" in saver.last_error
