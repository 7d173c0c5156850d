"""A mission as the page plays it: small enough to travel inside the page, whatever the mission's length.

Positions, beliefs and tasks are kept where they change; times are milliseconds since the start. Of the decisions, those
that changed something are kept with their explanation.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gatar_edge import channels as ch
from gatar_edge import foxglove
from gatar_edge.review.company import Json
from gatar_edge.review.explain import explain
from gatar_edge.review.info import Figures, RadioBriefs, read_figures
from gatar_edge.review.page_data import BUCKETS, NS_PER_MS, RobotStory, Story, corners, page_data, rounded
from gatar_edge.review.reader import Entry, LogReader, decoder, json_object
from gatar_edge.review.summary import summarize

MAX_EVENTS = 20_000
MAX_CANDIDATES = 8  # of an explanation on the page; `gatar log explain` shows all
MAX_LINES = 2_000

_positions = decoder(ch.PositionsRecord)
_radio = decoder(RadioBriefs)


def read_story(log: LogReader) -> Json:
    """The data of the page for one log. Raises LogError where it cannot be read."""
    figures = read_figures(log)
    story = Story(mission_start_ns(figures), figures)
    story.has_truth_tracks = figures.messages[ch.TRUTH_ROBOTS.topic] > 0
    decisions = sum(robot.decisions for robot in figures.robots.values())
    story.stride = max(1, decisions // 20_000)
    for entry in log.messages(lambda channel, _: channel.topic in _HANDLERS):
        _HANDLERS[entry.channel.topic](story, entry, max(0, entry.log_ns - story.start_ns) // NS_PER_MS)
    if figures.targets is None:
        story.visits = [
            [max(0, t_ns - story.start_ns) // NS_PER_MS, robot, *cell, None]
            for cell, (t_ns, robot) in sorted(figures.known_localized.items(), key=lambda known: known[1])
        ]
    return page_data(story, summarize(figures, log.damage, log.path.stat().st_size), log.path.name)


def mission_start_ns(figures: Figures) -> int:
    """The first decision: what comes before is launching."""
    first = [robot.first_ns for robot in figures.robots.values() if robot.first_ns >= 0]
    return min(first, default=max(figures.first_ns, 0))


def _on_decision(story: Story, entry: Entry, t: int) -> None:
    record = json_object(entry.data)
    decision: Json = record["decision"]
    robot = story.robots[entry.robot_id]
    previous, robot.previous = robot.previous, decision
    cell, assignment = decision["cell"], decision["assignment"]
    if not story.has_truth_tracks:
        _append_place(robot.track, t, cell[0], cell[1])
    if previous is None or _changed(previous, decision):
        event = _add_event(story, robot, t, record, previous)
        robot.tasks.append([t, assignment["kind"], *assignment["cell"], event])
    if previous is None or previous["assignment"]["path"] != assignment["path"]:
        robot.paths.append([t, *corners(assignment["path"])])
    near = [r["robot_id"] for r, hop in zip(decision["robots"], decision["hops"], strict=False) if hop == 1]
    if not robot.links or robot.links[-1][1:] != near:
        robot.links.append([t, *near])
    absent = [n for r in decision.get("absent", ()) for n in (r["robot_id"], r["kind"], *r["cell"])]
    if absent != (robot.absent[-1][1:] if robot.absent else []):
        robot.absent.append([t, *absent])
    if decision["tick"] % story.stride == 0:
        story.latencies.append([t, decision["latency_ns"] / 1e6])
        ages = [r["age_ns"] / 1e9 for r in decision["robots"][1:]]
        story.ages.append([t, sum(ages) / len(ages) if ages else 0.0, len(ages)])


def _changed(previous: Json, decision: Json) -> bool:
    """Whether a reviewer may ask why: another goal, a retask, or another rule that decided."""
    before, now = previous["assignment"], decision["assignment"]
    return bool(
        before["kind"] != now["kind"]
        or before["cell"] != now["cell"]
        or decision["retask"]
        or previous["allocator"] != decision["allocator"]
        or bool(previous["fallback"]) != bool(decision["fallback"])
    )


def _add_event(story: Story, robot: RobotStory, t: int, record: Json, previous: Json | None) -> int:
    if len(story.events) >= MAX_EVENTS:
        story.events_left_out += 1
        return -1
    explanation = explain(record["decision"], previous, record)
    candidates = explanation["candidates"]
    shown = candidates[:MAX_CANDIDATES] + [c for c in candidates[MAX_CANDIDATES:] if c["chosen"]]
    story.events.append(
        {
            "t": t,
            "id": explanation["robot_id"],
            "tick": explanation["tick"],
            "head": explanation["headline"],
            "why": explanation["why"],
            "kind": explanation["assignment"]["kind"],
            "cell": explanation["assignment"]["cell"],
            "reason": explanation["assignment"]["reason"],
            "by": explanation["allocator"],
            "fallback": explanation["fallback"],
            "retask": explanation["retask"],
            "ms": round(explanation["latency_ns"] / 1e6, 3),
            "heard": [
                [n["robot_id"], n["hops"], round(n["age_s"], 2), n["task"], *n["task_cell"], rounded(n["attention"])]
                for n in explanation["neighbors"]
            ],
            "absent": [
                [r["robot_id"], r["kind"], round(r["age_s"], 1), *r["cell"], r["task"], *r["task_cell"], r["given"]]
                for r in explanation["absent"]
            ],
            "targets": [
                [*c["cell"], c["length"], rounded(c["score"]), c["given_to"], c["claimed_by"], int(c["chosen"])]
                for c in shown
            ],
            "known": len(candidates),
        }
    )
    return len(story.events) - 1


def _on_positions(story: Story, entry: Entry, t: int) -> None:
    for place in _positions(entry.data).robots:
        _append_place(story.robots[place.robot_id].track, t, place.x, place.y)


def _append_place(track: list[float], t: int, x: float, y: float) -> None:
    """Of a robot that stands still, only the first and the last moment are kept."""
    if len(track) >= 6 and track[-2:] == [x, y] and track[-5:-3] == [x, y]:
        track[-3] = t
    else:
        track.extend((t, x, y))


def _on_observation(story: Story, entry: Entry, t: int) -> None:
    """The place at which a mission starts, before anybody has moved."""
    robot = story.robots[entry.robot_id]
    if not robot.track:
        cell = json_object(entry.data)["cell"]
        _append_place(robot.track, t, cell[0], cell[1])


def _on_belief(story: Story, entry: Entry, t: int) -> None:
    robot = story.robots[entry.robot_id]
    states = foxglove.read_grid(entry.data).cells
    before = robot.known if robot.known is not None and robot.known.shape == states.shape else np.zeros_like(states)
    changed = np.flatnonzero(before != states)
    if len(changed):
        robot.belief.append([t, *(changed * 8 + states.reshape(-1)[changed]).tolist()])
        robot.known = states


def _on_truth(story: Story, entry: Entry, t: int) -> None:
    if story.truth is None:
        story.truth = foxglove.read_grid(entry.data).cells


def _on_visit(story: Story, entry: Entry, t: int) -> None:
    visit = json_object(entry.data)
    story.visits.append([t, visit["robot_id"], *visit["cell"], visit["step"]])


def _on_radio(story: Story, entry: Entry, t: int) -> None:
    record: RadioBriefs = _radio(entry.data)
    sent = [item.size for item in record.items if item.way == ch.RadioWay.SENT.value]
    span_ms = (story.figures.last_ns - story.start_ns) // NS_PER_MS
    if not story.radio or t - story.radio[-1][0] > span_ms // (2 * BUCKETS):
        story.radio.append([t, 0, 0])
    story.radio[-1][1] += len(sent) + record.relayed
    story.radio[-1][2] += sum(sent) + record.relayed_bytes


def _on_fault(story: Story, entry: Entry, t: int) -> None:
    fault = json_object(entry.data)
    if len(story.faults) < MAX_LINES:
        story.faults.append([t, fault["kind"], fault["robot_id"]])


def _on_log(story: Story, entry: Entry, t: int) -> None:
    if len(story.lines) < MAX_LINES:
        line = foxglove.read_log_line(entry.data)
        story.lines.append([t, line.level, line.name, line.text])


def _on_vehicle(story: Story, entry: Entry, t: int) -> None:
    state = json_object(entry.data)["state"]
    now = [state["mode"], state["phase"], state["battery_percent"]]
    vehicle = story.robots[entry.robot_id].vehicle
    if not vehicle or vehicle[-1][1:] != now:
        vehicle.append([t, *now])


_HANDLERS: dict[str, Callable[[Story, Entry, int], None]] = {
    ch.DECISION.topic: _on_decision,
    ch.OBSERVATION.topic: _on_observation,
    ch.TRUTH_ROBOTS.topic: _on_positions,
    ch.BELIEF.topic: _on_belief,
    ch.TRUTH_MAP.topic: _on_truth,
    ch.TRUTH_VISITS.topic: _on_visit,
    ch.RADIO.topic: _on_radio,
    ch.FAULTS.topic: _on_fault,
    ch.LOG.topic: _on_log,
    ch.VEHICLE.topic: _on_vehicle,
}
