"""Replay: the same agents on the recorded inputs decide the same; another allocator's choices are counted."""

from __future__ import annotations

import base64
from pathlib import Path

import pytest
from builders import observation
from click.testing import CliRunner
from missions import record_mission

from gatar_edge import channels as ch
from gatar_edge.agent import Agent, Identity
from gatar_edge.allocators.base import Allocation
from gatar_edge.allocators.greedy import Greedy
from gatar_edge.allocators.registry import NAMES, make
from gatar_edge.commands.sim import command as sim
from gatar_edge.config import AgentConfig
from gatar_edge.errors import DeadlineError, LogError
from gatar_edge.keys import DEMO_KEY
from gatar_edge.message import with_hops
from gatar_edge.persist import restore, snapshot
from gatar_edge.policy import DEFAULT_MODEL
from gatar_edge.record import Recorder
from gatar_edge.review.models import allocator_for
from gatar_edge.review.reader import LogReader, json_object
from gatar_edge.review.replay import Replay, Replayed
from gatar_edge.runinfo import describe_run
from gatar_edge.tasks import to_command
from gatar_edge.types import NS_PER_S, GridSpec, RobotKind
from gatar_edge.view import View

GOLDEN = Path(__file__).parent / "golden"
CLASSICAL = tuple(name for name in NAMES if name != "gatar")
# What a model computes may differ in the last bits from one processor to another; what is decided may not.
LAST_BITS = frozenset(("candidates[].score", "attention[]", "assignment.xy[]"))


def replay(path: Path, ignore: frozenset[str] = frozenset()) -> Replayed:
    return Replay(lambda name: make(name)(), ignore=ignore).run(LogReader(path))


def record_golden(name: str) -> Path:
    path = GOLDEN / f"{name}.mcap"
    GOLDEN.mkdir(exist_ok=True)
    record_mission(path, make(name), team="2A2G", targets=10, size=10, seed=11, steps=14)
    return path


@pytest.mark.parametrize("name", NAMES)
def test_golden_logs_replay_to_the_same_decisions(name: str, request: pytest.FixtureRequest) -> None:
    if request.config.getoption("--update-refs"):
        record_golden(name)
    log = LogReader(GOLDEN / f"{name}.mcap")
    factory, _ = allocator_for(log.run_info(), None, None)  # raises where the shipped model has changed: --update-refs
    result = Replay(factory, ignore=LAST_BITS).run(log)
    assert result.decisions > 20
    assert result.same, result.differences[:1]


@pytest.mark.parametrize("name", CLASSICAL)
def test_a_mission_flown_now_replays_bit_for_bit(name: str, tmp_path: Path) -> None:
    mission = record_mission(tmp_path / "a.mcap", make(name))
    result = replay(tmp_path / "a.mcap")
    assert result.to_json()["first_difference"] is None
    assert (result.decisions, result.equal) == (4 * mission.steps, 4 * mission.steps)
    assert result.messages == result.messages_equal >= 4 * mission.steps  # more where allocators talk
    assert result.heard == result.heard_equal > 0


def test_a_mission_with_robots_out_of_range_tells_them_and_replays(tmp_path: Path) -> None:
    record_mission(tmp_path / "a.mcap", make("gatar"), team="3A3G", size=24, targets=16, steps=40)
    decisions = [
        json_object(entry.data)["decision"]
        for entry in LogReader(tmp_path / "a.mcap").messages(lambda channel, _: channel is ch.DECISION)
    ]
    reckoning = [decision for decision in decisions if decision["absent"]]
    assert len(reckoning) > 5
    assert all(len(decision["kept_for_absent"]) == len(decision["absent"]) for decision in reckoning)
    assert any(max(decision["kept_for_absent"]) >= 0 for decision in reckoning)
    assert replay(tmp_path / "a.mcap", LAST_BITS).same


def test_another_allocator_is_asked_at_each_moment_and_its_choices_counted(tmp_path: Path) -> None:
    record_mission(tmp_path / "a.mcap")
    result = Replay(lambda _: make("nearest")(), otherwise=True).run(LogReader(tmp_path / "a.mcap"))
    assert 0 < result.equal < result.decisions
    assert result.differences[0]["what"] == "decision"
    assert result.differences[0]["recorded"]["cell"] != result.differences[0]["replayed"]["cell"]


def test_the_allocator_that_flew_would_not_have_decided_otherwise(tmp_path: Path) -> None:
    record_mission(tmp_path / "a.mcap")
    result = Replay(lambda _: make("greedy")(), otherwise=True).run(LogReader(tmp_path / "a.mcap"))
    assert result.equal == result.decisions


class Contrary(Greedy):
    """Greedy, but at one tick it gives ego nothing."""

    def __init__(self) -> None:
        self.calls = 0

    def allocate(self, view: View) -> Allocation:
        self.calls += 1
        allocation = super().allocate(view)
        if self.calls == 3:
            allocation.choices[0] = -1
        return allocation


def test_the_first_difference_is_shown_field_by_field(tmp_path: Path) -> None:
    record_mission(tmp_path / "a.mcap")
    result = Replay(lambda _: Contrary()).run(LogReader(tmp_path / "a.mcap"))
    first = result.to_json()["first_difference"]
    assert first["tick"] == 3
    assert "choices[0]" in {field["field"] for field in first["fields"]}
    assert not result.same


class Late(Greedy):
    """Greedy that misses its deadline at every second tick."""

    def __init__(self) -> None:
        self.calls = 0

    def allocate(self, view: View) -> Allocation:
        self.calls += 1
        if self.calls % 2:
            raise DeadlineError("the allocator took more than 50 ms")
        return super().allocate(view)


def test_missed_deadlines_are_repeated(tmp_path: Path) -> None:
    record_mission(tmp_path / "a.mcap", Late)
    assert Replay(lambda _: Greedy()).run(LogReader(tmp_path / "a.mcap")).same


def test_a_robot_that_restarted_replays_from_the_state_it_took_over(tmp_path: Path) -> None:
    config = AgentConfig(grid=GridSpec(width=8, height=8))
    robot = Identity(1, RobotKind.UAV, 1.0)
    earlier = Agent(robot, config, Greedy(), DEMO_KEY)
    earlier.observe(observation((1, 1), seen=[(1, 2)], targets=[(6, 6)]))
    earlier.decide(0)
    state = snapshot(earlier, 0)
    agent = Agent(robot, config, Greedy(), DEMO_KEY, first_seq=100)
    restore(agent, state)
    recorder = Recorder(tmp_path / "a.mcap", describe_run(config, [robot], "greedy", first_seqs={1: 100}), 0)
    recorder.takes_over(state, 0)
    seen = observation((2, 1), t_ns=NS_PER_S)
    agent.observe(seen)
    recorder.observation(seen)
    decision = agent.decide(NS_PER_S)
    command = to_command(robot.kind, decision.assignment)
    recorder.decision(decision, command, command, NS_PER_S)
    agent.beacon(NS_PER_S)  # held back by the byte budget: never sent
    recorder.sent(1, agent.beacon(NS_PER_S), NS_PER_S)
    recorder.close()
    assert decision.assignment.cell == (6, 6)
    assert replay(tmp_path / "a.mcap").same


def test_the_key_proves_the_signatures_and_a_wrong_one_shows(tmp_path: Path) -> None:
    record_mission(tmp_path / "a.mcap")
    right = Replay(lambda name: make(name)(), key=DEMO_KEY).run(LogReader(tmp_path / "a.mcap"))
    wrong = Replay(lambda name: make(name)(), key=bytes(32)).run(LogReader(tmp_path / "a.mcap"))
    assert right.same
    assert wrong.heard_equal == 0


def test_the_log_holds_no_key_but_messages_that_can_be_signed_again(tmp_path: Path) -> None:
    record_mission(tmp_path / "a.mcap")
    for entry in LogReader(tmp_path / "a.mcap").messages():
        assert DEMO_KEY not in entry.data
        if entry.channel is ch.RADIO:
            for item in json_object(entry.data)["items"]:
                data = base64.b64decode(item["data"])
                assert with_hops(data, item.get("hops", -1), DEMO_KEY) == data


def test_the_model_that_flew_is_known_by_its_digest(tmp_path: Path) -> None:
    log = LogReader(GOLDEN / "gatar.mcap")
    info = log.run_info()
    assert len(info["model_sha256"]) == 64
    with pytest.raises(LogError, match="give that file with --model"):
        allocator_for({**info, "model_sha256": "0" * 64}, None, None)
    assert allocator_for(info, None, DEFAULT_MODEL)[1] is False
    assert allocator_for({**info, "model_sha256": "0" * 64}, None, DEFAULT_MODEL)[1] is True
    assert allocator_for(info, "greedy", None)[1] is True


def test_a_log_without_run_info_cannot_be_replayed(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "a.mcap", {"robots": []}, 0)
    recorder.close()
    with pytest.raises(LogError, match="does not say what flew"):
        replay(tmp_path / "a.mcap")


def test_a_mission_with_a_clock_that_jumps_decides_the_same_again(tmp_path: Path) -> None:
    faults = tmp_path / "faults.toml"
    skew = '[[event]]\nat_s = 1\nrobot = 2\ndo = "clock_skew"\noffset_s = 0.4\nfor_s = 9\n'
    faults.write_text(f"[radio]\nloss = 0.2\n{skew}")
    path = tmp_path / "skewed.mcap"
    options = ["--team", "1A1G", "--targets", "6", "--size", "9", "--allocator", "greedy", "--json"]
    flown = CliRunner().invoke(sim, [*options, "--faults", str(faults), "--log", str(path)])
    assert flown.exit_code == 0, flown.output
    replayed = Replay(lambda name: make(name)()).run(LogReader(path))
    assert replayed.differences == []
    assert replayed.same
    assert replayed.heard > 10
