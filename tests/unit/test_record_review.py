"""Explaining, merging and exporting logs, and the command line over them."""

from __future__ import annotations

import csv
import json
import os
from pathlib import Path
from typing import Any

import msgspec
import pytest
from builders import observation
from click.testing import CliRunner, Result
from missions import record_mission
from pymavlink import mavutil
from pymavlink.dialects.v20 import common as mavlink

from gatar_edge import channels as ch
from gatar_edge.agent import Agent, Identity
from gatar_edge.allocators.greedy import Greedy
from gatar_edge.allocators.routing import RoutingWithMemory
from gatar_edge.commands.log import command
from gatar_edge.config import AgentConfig
from gatar_edge.errors import GatarError, LogError
from gatar_edge.keys import DEMO_KEY
from gatar_edge.persist import snapshot
from gatar_edge.policy import DEFAULT_MODEL
from gatar_edge.record import Recorder
from gatar_edge.review.difference import comparable, differences
from gatar_edge.review.explain import explain, words
from gatar_edge.review.export import export_csv, export_tlog
from gatar_edge.review.info import read_figures
from gatar_edge.review.merge import merge
from gatar_edge.review.moment import explain_at
from gatar_edge.review.reader import LogReader, json_object
from gatar_edge.review.replay import Replay
from gatar_edge.review.story import mission_start_ns, read_story
from gatar_edge.runinfo import describe_run
from gatar_edge.tasks import to_command
from gatar_edge.types import (
    NS_PER_S,
    Assignment,
    Candidate,
    Decision,
    GridSpec,
    Reason,
    RobotKind,
    RobotState,
    TaskKind,
)

MS = 1_000_000


@pytest.fixture(scope="module")
def mission(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("log") / "mission.mcap"
    record_mission(path)
    return path


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(command, [str(argument) for argument in arguments])


def changed_decision(path: Path) -> tuple[dict[str, object], dict[str, object]]:
    """A decision in which a robot went elsewhere than before, and the one before it."""
    before: dict[int, dict[str, object]] = {}
    for entry in LogReader(path).messages(lambda channel, _: channel is ch.DECISION):
        decision = json_object(entry.data)["decision"]
        previous = before.get(entry.robot_id)
        if previous is not None and previous["assignment"]["cell"] != decision["assignment"]["cell"]:  # type: ignore[index]
            return decision, previous
        before[entry.robot_id] = decision
    raise AssertionError("nobody ever changed its mind")


def test_an_explanation_names_the_goal_the_neighbours_and_the_candidates(mission: Path) -> None:
    decision, previous = changed_decision(mission)
    explanation = explain(decision, previous)
    text = "\n".join(words(explanation))
    assert explanation["headline"] in text
    for neighbor in explanation["neighbors"]:
        assert neighbor["name"] in text
    assert text.count("cells, score") + text.count("cell, score") == len(decision["candidates"])  # type: ignore[arg-type]


def test_the_explained_decision_is_the_latest_before_the_moment(mission: Path) -> None:
    explanation = explain_at(LogReader(mission), 2, 5.7)
    assert (explanation["t_s"], explanation["tick"], explanation["robot_id"]) == (5.0, 6, 2)


def test_a_kept_task_is_explained_with_the_moment_it_was_taken(mission: Path) -> None:
    kept = next(
        json_object(entry.data)["decision"]
        for entry in LogReader(mission).messages(lambda channel, _: channel is ch.DECISION)
        if json_object(entry.data)["decision"]["assignment"]["reason"] == "kept"
    )
    explanation = explain_at(LogReader(mission), kept["robot_id"], kept["t_ns"] / NS_PER_S)
    assert explanation["since"]["t_s"] < explanation["t_s"]
    assert explanation["since"]["assignment"]["cell"] == kept["assignment"]["cell"]


ROBOT = RobotState(1, RobotKind.UAV, (4, 4), 1.0, TaskKind.TARGET, (7, 4))
CANDIDATES = (Candidate((5, 4), 1, 0.2), Candidate((7, 4), 3, 0.5))


def decided_on(assignment: Assignment, choice: int, **fields: Any) -> list[str]:
    """How a decision by an allocator that weighs by itself what robots are doing is explained, as the log tells it."""
    decision = Decision(
        1, 9, 0, (4, 4), assignment, "gatar", "", False, (ROBOT,), (0,), CANDIDATES, (choice,), steady=True, **fields
    )
    return words(explain(json_object(msgspec.json.encode(decision)), None))


def test_robots_out_of_range_are_told_with_their_place_their_silence_and_what_is_kept_for_them() -> None:
    gone = RobotState(7, RobotKind.UGV, (14, 2), 1.0, TaskKind.TARGET, (5, 4), 6_500_000_000)
    lines = decided_on(
        Assignment(TaskKind.TARGET, (7, 4), Reason.ALLOCATED, ((4, 4), (5, 4), (6, 4), (7, 4))),
        1,
        absent=(gone,),
        kept_for_absent=(0,),
    )
    at = lines.index("It reckoned with 1 robot out of range:")
    assert lines[at + 1].startswith("  UGV 7, silent for 6.5 s, expected at (14, 2)")
    assert lines[at + 1].endswith("the joint solution gives it (5, 4)")
    assert "  Not the nearest, (5, 4) at 1 cell: the joint solution gives it to robot 7." in lines


@pytest.mark.parametrize(
    ("choice", "said"), [(1, "chose the same target again"), (0, "though the allocator now chose")]
)
def test_a_target_kept_is_one_chosen_again_where_the_allocator_is_steady(choice: int, said: str) -> None:
    text = "\n".join(decided_on(Assignment(TaskKind.TARGET, (7, 4), Reason.KEPT, ((4, 4), (7, 4))), choice))
    assert said in text
    assert "not reconsidered" not in text


def test_of_two_targets_as_near_the_chosen_one_is_not_called_farther() -> None:
    task = Assignment(TaskKind.TARGET, (4, 7), Reason.ALLOCATED, ((4, 4), (4, 7)))
    candidates = (Candidate((1, 4), 3, 0.2), Candidate((4, 7), 3, 0.5))
    decision = Decision(1, 9, 0, (4, 4), task, "gatar", "", False, (ROBOT,), (0,), candidates, (1,))
    text = "\n".join(words(explain(json_object(msgspec.json.encode(decision)), None)))
    assert "No open target that it knows is nearer than this one (3 cells)." in text
    assert "Not the nearest" not in text


def test_the_way_left_is_told_and_the_corners_of_a_mission() -> None:
    path = ((2, 4), (3, 4), (4, 4), (4, 5), (5, 5), (5, 6))
    decision = Decision(
        1,
        9,
        0,
        (4, 4),
        Assignment(TaskKind.TARGET, (5, 6), Reason.KEPT, path),
        "gatar",
        "",
        False,
        (ROBOT,),
        (0,),
        (),
        (),
    )
    wanted = {"type": "mission", "cells": [[4, 4], [4, 5], [5, 5], [5, 6]]}
    record = {"wanted": wanted, "sent": wanted}
    lines = words(explain(json_object(msgspec.json.encode(decision)), None, record))
    assert lines[0].endswith("goes for the target at (5, 6), 3 cells away.")
    assert "The vehicle was told: drive to (5, 6), round 3 corners." in lines


def test_a_place_to_look_is_told_as_the_allocators_or_as_the_rules() -> None:
    going = Assignment(TaskKind.EXPLORE, (9, 9), Reason.FRONTIER, ((4, 4), (9, 9)))
    by_model, by_rule = ("\n".join(decided_on(going, -1, frontier=cell)) for cell in ((9, 9), None))
    assert "allocator chose this place for it to go and look" in by_model
    assert "nearest unknown cell" not in by_model
    assert "nearest unknown cell" in by_rule


def test_a_target_that_nobody_claims_is_told_as_such() -> None:
    lines = decided_on(Assignment(TaskKind.TARGET, (5, 4), Reason.ABANDONED, ((4, 4), (5, 4))), -1)
    assert "  It has nothing else to do, and nobody that it hears is on the way to this target." in lines


def test_a_log_of_an_older_program_is_explained_and_replayed_without_what_it_does_not_tell(mission: Path) -> None:
    new = ("steady", "frontier", "absent", "kept_for_absent")
    decision, previous = changed_decision(mission)
    old = {key: value for key, value in decision.items() if key not in new}
    assert words(explain(old, previous)) == words(explain(decision, previous))
    assert list(differences(old, comparable(old, decision), "")) == []
    assert msgspec.convert(old, Decision).absent == ()


def test_a_robot_that_is_not_there_is_answered_with_those_that_are(mission: Path) -> None:
    with pytest.raises(LogError, match=r"no decision of robot 77.*1, 2, 3, 4"):
        explain_at(LogReader(mission), 77, 3.0)


def record_pair(folder: Path, ahead_ns: int, delay_ns: int) -> list[Path]:
    """Two robots that hear each other, each with a log of its own; the second's clock is ahead."""
    config = AgentConfig(grid=GridSpec(width=8, height=8))
    paths, agents, logs, clocks = [], [], [], (0, ahead_ns)
    for number, kind in ((1, RobotKind.UAV), (2, RobotKind.UGV)):
        robot = Identity(number, kind, 1.0)
        paths.append(folder / f"robot{number}.mcap")
        agents.append(Agent(robot, config, Greedy(), DEMO_KEY))
        logs.append(Recorder(paths[-1], describe_run(config, [robot], "greedy"), clocks[number - 1] + NS_PER_S))
    for second in range(1, 20):
        for here, there in ((0, 1), (1, 0)):
            now = second * NS_PER_S + clocks[here]
            seen = observation((here, second % 8), targets=[(5, 5)], robot_id=here + 1, t_ns=now)
            agents[here].observe(seen)
            logs[here].observation(seen)
            decision = agents[here].decide(now)
            wanted = to_command(agents[here].identity.kind, decision.assignment)
            logs[here].decision(decision, wanted, wanted, now)
            message = agents[here].beacon(now)
            logs[here].sent(here + 1, message, now)
            arrival = second * NS_PER_S + clocks[there] + delay_ns
            logs[there].heard(there + 1, message, agents[there].hear(message, arrival).outcome.value, arrival)
    for log in logs:
        log.close()
    return paths


@pytest.mark.parametrize("ahead_s", [5.25, -0.4])
def test_logs_of_robots_with_different_clocks_land_on_one_time_line(tmp_path: Path, ahead_s: float) -> None:
    paths = record_pair(tmp_path, round((10 + ahead_s) * NS_PER_S) - 10 * NS_PER_S, 30 * MS)
    result = merge(paths, tmp_path / "team.mcap")
    assert result.unplaced == ()
    assert result.offsets_ns["robot1.mcap"] == 0
    assert result.offsets_ns["robot2.mcap"] == pytest.approx(-ahead_s * NS_PER_S, abs=2 * MS)
    log = LogReader(tmp_path / "team.mcap")
    times = [entry.log_ns for entry in log.messages()]
    assert times == sorted(times)
    assert len(times) == result.messages == sum(sum(1 for _ in LogReader(path).messages()) for path in paths)
    assert {attachment.name for attachment in log.attachments()} == {"robot1/run_info.json", "robot2/run_info.json"}
    assert len(log.metadata()) == 2
    replayed = Replay(lambda _: Greedy()).run(log)
    assert replayed.same
    assert replayed.robots == {1, 2}


def test_without_a_simulator_the_log_counts_the_targets_that_robots_knew(tmp_path: Path) -> None:
    config = AgentConfig(grid=GridSpec(width=8, height=8))
    robot = Identity(1, RobotKind.UAV, 1.0)
    agent = Agent(robot, config, Greedy(), DEMO_KEY)
    recorder = Recorder(tmp_path / "a.mcap", describe_run(config, [robot], "greedy"), 0)
    for second, cell in enumerate(((1, 1), (1, 2), (1, 3))):
        seen = observation(cell, targets=[(1, 3), (6, 6)], t_ns=second * NS_PER_S)
        agent.observe(seen)
        recorder.observation(seen)
        decision = agent.decide(second * NS_PER_S)
        command = to_command(robot.kind, decision.assignment)
        recorder.decision(decision, command, command, second * NS_PER_S)
        recorder.belief(1, agent.belief, config.grid, second * NS_PER_S)
    recorder.close()
    story = read_story(LogReader(tmp_path / "a.mcap"))
    assert (story["result"]["localized"], story["result"]["reachable"]) == (1, 2)
    assert story["visits"] == [[2000, 1, 1, 3, None]]
    assert "1 of 2 that the robots knew of" in run("info", tmp_path / "a.mcap").output


def test_merging_takes_two_logs_and_spares_its_sources(tmp_path: Path) -> None:
    one, two = record_pair(tmp_path, 0, MS)
    for sources, output in (([one], tmp_path / "x.mcap"), ([one, two], one), ([one, one], tmp_path / "x.mcap")):
        with pytest.raises(LogError):
            merge(sources, output)


def test_merged_logs_of_the_same_name_are_told_apart(tmp_path: Path) -> None:
    one, two = record_pair(tmp_path, 0, MS)
    (tmp_path / "other").mkdir()
    two = two.rename(tmp_path / "other" / one.name)
    assert list(merge([one, two], tmp_path / "x.mcap").offsets_ns) == [str(one), str(two)]


@pytest.mark.parametrize("arguments", [["report"], ["recover"], ["report", "--compare", "COPY"]])
def test_nothing_is_written_over_a_log_that_is_read(mission: Path, tmp_path: Path, arguments: list[str]) -> None:
    log, copy = tmp_path / "mission.mcap", tmp_path / "copy.mcap"
    for path in (log, copy):
        path.write_bytes(mission.read_bytes())
    given = [str(copy) if argument == "COPY" else argument for argument in arguments]
    result = run(given[0], log, *given[1:], "-o", copy if copy.as_posix() in given else log)
    assert isinstance(result.exception, LogError)
    assert log.read_bytes() == copy.read_bytes() == mission.read_bytes()
    assert sorted(tmp_path.iterdir()) == [copy, log]


@pytest.mark.parametrize("output", ["text/x", "absent/x", "fifo"])
@pytest.mark.parametrize("name", ["report", "recover"])
def test_what_cannot_be_written_is_one_line_and_leaves_nothing(
    mission: Path, tmp_path: Path, name: str, output: str
) -> None:
    (tmp_path / "text").write_text("a file where a folder should be")
    os.mkfifo(tmp_path / "fifo")
    result = run(name, mission, "-o", tmp_path / output)
    assert isinstance(result.exception, LogError)
    assert f"{output} cannot be written" in str(result.exception)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["fifo", "text"]


@pytest.mark.parametrize(
    "arguments",
    [["explain", "--robot", "1", "--t", "X"], ["whatif", "--from", "X"], ["whatif", "--r-comm", "X"]],
)
@pytest.mark.parametrize("number", ["nan", "inf", "1e300"])
def test_a_moment_or_a_range_that_is_no_number_is_wrong_usage(mission: Path, arguments: list[str], number: str) -> None:
    result = run(arguments[0], mission, *[number if argument == "X" else argument for argument in arguments[1:]])
    assert result.exit_code == 2
    assert "Invalid value" in result.output


def test_tables_hold_every_decision_and_message(mission: Path, tmp_path: Path) -> None:
    counts = export_csv(LogReader(mission), tmp_path)
    with (tmp_path / "decisions.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == counts["decisions.csv"] > 20
    assert {row["task"] for row in rows} <= {"TARGET", "EXPLORE", "HOLD"}
    assert counts["radio.csv"] > counts["decisions.csv"]


@pytest.fixture(scope="module")
def remembering(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("log") / "remembering.mcap"
    record_mission(path, RoutingWithMemory, team="2A1G", size=20)
    return path


def absences(path: Path) -> list[tuple[int, int, list[dict[str, Any]]]]:
    """Time in ms, robot and its robots out of range, of each decision that reckoned with some."""
    entries = LogReader(path).messages(lambda channel, _: channel is ch.DECISION)
    told = [(entry.log_ns // MS, entry.robot_id, json_object(entry.data)["decision"]["absent"]) for entry in entries]
    return [row for row in told if row[2]]


def test_tables_tell_the_robots_out_of_range(remembering: Path, tmp_path: Path) -> None:
    told = absences(remembering)
    counts = export_csv(LogReader(remembering), tmp_path)
    with (tmp_path / "decisions.csv").open(newline="") as file:
        assert sum(row["robots_remembered"] != "0" for row in csv.DictReader(file)) == len(told) > 5
    with (tmp_path / "remembered.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == counts["remembered.csv"] == sum(len(absent) for _, _, absent in told)
    first = told[0][2][0]
    assert [int(rows[0][name]) for name in ("other", "x", "y")] == [first["robot_id"], *first["cell"]]
    assert float(rows[0]["silent_s"]) > 0


def test_the_page_knows_at_each_moment_whom_a_robot_remembers(remembering: Path) -> None:
    story = read_story(LogReader(remembering))
    rows = {robot["id"]: robot["absent"] for robot in story["robots"]}
    start_ms = mission_start_ns(read_figures(LogReader(remembering))) // MS
    for t_ms, robot_id, absent in absences(remembering):
        now = [row for row in rows[robot_id] if row[0] <= t_ms - start_ms][-1]
        assert now[1:] == [n for robot in absent for n in (robot["robot_id"], robot["kind"], *robot["cell"])]
    assert any(event["absent"] for event in story["events"])


def test_telemetry_logs_open_in_pymavlink(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "a.mcap", {"robots": []}, 0)
    link = mavlink.MAVLink(None, 9, 1)
    for second in range(5):
        frame = mavlink.MAVLink_system_time_message(second, second).pack(link)
        recorder.mavlink(9, "rx", bytes(frame), second * NS_PER_S)
    recorder.close()
    assert export_tlog(LogReader(tmp_path / "a.mcap"), tmp_path) == {"robot_9.tlog": 5}
    reader = mavutil.mavlink_connection(str(tmp_path / "robot_9.tlog"), dialect="common")
    try:
        found = [message.time_boot_ms for _ in range(5) if (message := reader.recv_match()) is not None]
    finally:
        reader.close()
    assert found == [0, 1, 2, 3, 4]


@pytest.mark.parametrize(
    "arguments",
    [["info"], ["explain", "--robot", "1", "--t", "3"], ["replay"], ["recover", "-o", "OUT"], ["report", "-o", "OUT"]],
)
def test_every_command_takes_a_log_and_refuses_what_is_none(
    mission: Path, tmp_path: Path, arguments: list[str]
) -> None:
    arguments = [str(tmp_path / "out") if argument == "OUT" else argument for argument in arguments]
    assert run(arguments[0], mission, *arguments[1:]).exit_code == 0
    text = tmp_path / "text.mcap"
    text.write_text("nothing of the kind")
    result = run(arguments[0], text, *arguments[1:])
    assert isinstance(result.exception, GatarError)
    assert "no MCAP file" in str(result.exception)


def test_machines_get_json(mission: Path, tmp_path: Path) -> None:
    info = json.loads(run("info", mission, "--json").output)
    assert {"run", "duration_s", "robots", "result", "messages", "health"} <= info.keys()
    replayed = json.loads(run("replay", mission, "--json").output)
    assert replayed["decisions"] == replayed["equal"] > 20
    recovered = json.loads(run("recover", mission, "-o", tmp_path / "r.mcap", "--json").output)
    assert recovered["recovered"] > 100
    assert recovered["lost_s"] == 0
    explained = json.loads(run("explain", mission, "--robot", "1", "--t", "2", "--json").output)
    assert explained["robot_id"] == 1


def test_another_allocator_is_reported_in_words(mission: Path) -> None:
    result = run("replay", mission, "--allocator", "nearest")
    assert result.exit_code == 0
    assert "nearest would have gone elsewhere in" in result.output


def test_a_model_for_another_rule_than_the_network_is_refused(mission: Path) -> None:
    error = run("replay", mission, "--allocator", "greedy", "--model", DEFAULT_MODEL).exception
    assert isinstance(error, GatarError)
    assert "leave one of them out" in str(error)


def test_a_mission_that_is_over_has_nothing_to_go_on_with(mission: Path) -> None:
    error = run("whatif", mission, "--from", "1e6").exception
    assert isinstance(error, LogError)
    assert "no open target" in str(error)


def test_a_difference_gives_exit_code_one(tmp_path: Path) -> None:
    record_mission(tmp_path / "a.mcap")
    config = LogReader(tmp_path / "a.mcap").run_info()
    recorder = Recorder(tmp_path / "b.mcap", {**config, "allocator": "nearest"}, 0)
    for entry in LogReader(tmp_path / "a.mcap").messages(lambda channel, _: channel is not ch.RUN_INFO):
        recorder._write(entry.channel, entry.data, entry.log_ns, entry.robot_id)
    recorder.close()
    result = run("replay", tmp_path / "b.mcap")
    assert result.exit_code == 1
    assert "first difference: robot" in result.output


def test_files_that_a_recorder_rotated_replay_once_they_are_merged(tmp_path: Path) -> None:
    config = AgentConfig(grid=GridSpec(width=8, height=8))
    robot = Identity(1, RobotKind.UAV, 1.0)
    agent = Agent(robot, config, Greedy(), DEMO_KEY)
    info = describe_run(config, [robot], "greedy")
    paths = [tmp_path / "one.mcap", tmp_path / "two.mcap"]
    for part, path in enumerate(paths):
        recorder = Recorder(path, info, part * 5 * NS_PER_S)
        if part:
            recorder.takes_over(snapshot(agent, 0), 5 * NS_PER_S)
        for second in range(part * 5, part * 5 + 5):
            now = second * NS_PER_S
            seen = observation((1, second % 8), targets=[(6, 6)], t_ns=now)
            agent.observe(seen)
            recorder.observation(seen)
            decision = agent.decide(now)
            command = to_command(robot.kind, decision.assignment)
            recorder.decision(decision, command, command, now)
            recorder.sent(1, agent.beacon(now), now)
        recorder.close()
    result = merge(paths, tmp_path / "whole.mcap")
    assert result.unplaced == ()
    replayed = Replay(lambda _: Greedy()).run(LogReader(tmp_path / "whole.mcap"))
    assert replayed.same
    assert replayed.decisions == 10
