"""What a log holds, how the mission went, and whether the recording can be trusted: one pass in bounded memory."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from dataclasses import dataclass, field
from typing import Any

import msgspec
import numpy as np

from gatar_edge import channels as ch
from gatar_edge import foxglove
from gatar_edge.review.reader import Entry, LogReader, Tally, decoder, json_object
from gatar_edge.types import NS_PER_S, Cell, CellState

GAP_PERIODS = 5  # a robot silent for this many of its own periods has a gap
MAX_SAMPLES = 200_000  # latencies kept for percentiles: every one up to here, then every second, and so on


class AssignmentBrief(msgspec.Struct):
    """What `info` needs of an assignment."""

    kind: int
    cell: Cell
    reason: str


class DecisionBrief(msgspec.Struct):
    """What `info` needs of a decision; other fields are skipped without being built."""

    robot_id: int
    t_ns: int
    cell: Cell
    assignment: AssignmentBrief
    allocator: str
    fallback: str
    retask: bool
    latency_ns: int


class BriefRecord(msgspec.Struct):
    """A decision record, in brief."""

    decision: DecisionBrief


class RadioBrief(msgspec.Struct):
    """What `info` needs of one datagram."""

    t_ns: int
    way: str
    outcome: str = ""
    author: int = -1
    sent_ms: int = -1
    size: int = 0
    hops: int = -1


class RadioBriefs(msgspec.Struct):
    """The datagrams of one robot."""

    robot_id: int
    items: list[RadioBrief]
    ignored: dict[str, int] = {}
    relayed: int = 0
    relayed_bytes: int = 0


@dataclass(slots=True)
class Samples:
    """Values for percentiles in bounded memory: when full, every second one is dropped and fewer are taken."""

    values: list[int] = field(default_factory=list)
    every: int = 1
    seen: int = 0

    def add(self, value: int) -> None:
        """Take in one value."""
        self.seen += 1
        if self.seen % self.every:
            return
        self.values.append(value)
        if len(self.values) >= MAX_SAMPLES:
            self.values = self.values[::2]
            self.every *= 2

    def percentile(self, percent: float) -> float:
        """The nearest-rank percentile; 0 for none."""
        if not self.values:
            return 0.0
        rank = max(0, math.ceil(percent / 100 * len(self.values)) - 1)
        return float(sorted(self.values)[rank])


@dataclass(slots=True)
class RobotFigures:
    """One robot's counts."""

    decisions: int = 0
    retasks: int = 0
    fallbacks: int = 0
    distance: int = 0  # cells between the decisions' places
    heard: Counter[str] = field(default_factory=Counter)
    messages: int = 0
    message_bytes: int = 0
    first_ns: int = -1
    last_ns: int = -1
    longest_gap_ns: int = 0
    cell: Cell | None = None


@dataclass(slots=True)
class Figures:
    """All counts of one log."""

    run_info: dict[str, Any] = field(default_factory=dict)
    result: dict[str, Any] | None = None
    first_ns: int = -1
    last_ns: int = 0
    messages: Counter[str] = field(default_factory=Counter)
    bytes: Counter[str] = field(default_factory=Counter)
    robots: defaultdict[int, RobotFigures] = field(default_factory=lambda: defaultdict(RobotFigures))
    latency: Samples = field(default_factory=Samples)
    delay_ms: Samples = field(default_factory=Samples)
    reasons: Counter[str] = field(default_factory=Counter)
    targets: int | None = None
    visits: list[ch.VisitRecord] = field(default_factory=list)
    known: set[Cell] = field(default_factory=set)  # targets by the robots' beliefs, where the log has no truth
    known_localized: dict[Cell, tuple[int, int]] = field(default_factory=dict)  # of those: since when, by whose belief
    faults: Counter[str] = field(default_factory=Counter)
    warnings: list[str] = field(default_factory=list)
    clock_steps_back: int = 0
    not_in_order: int = 0


_brief = decoder(BriefRecord)
_radio = decoder(RadioBriefs)
_visit = decoder(ch.VisitRecord)
_fault = decoder(ch.FaultRecord)
_health = decoder(ch.HealthRecord)
MAX_WARNINGS = 50


def read_figures(log: LogReader) -> Figures:
    """Count through a whole log. Raises LogError where it cannot be read."""
    figures, tally = Figures(), Tally()
    for entry in log.messages(lambda channel, _: channel.topic in _HANDLERS, tally):
        if figures.first_ns < 0:
            figures.first_ns = tally.first_ns
        _HANDLERS[entry.channel.topic](figures, entry)
    figures.first_ns, figures.last_ns, figures.not_in_order = tally.first_ns, tally.last_ns, tally.not_in_order
    for number, count in tally.counts.items():
        topic = log.topic_of(number)
        if topic:
            figures.messages[topic] += count
            figures.bytes[topic] += tally.payload(number)
    return figures


def _on_run_info(figures: Figures, entry: Entry) -> None:
    info = json_object(entry.data)
    if not figures.run_info:
        figures.run_info = info
        return
    robots = figures.run_info.setdefault("robots", [])  # a merged log holds the run infos of several robots
    known = {robot["robot_id"] for robot in robots}
    robots.extend(robot for robot in info.get("robots", ()) if robot["robot_id"] not in known)


def _on_result(figures: Figures, entry: Entry) -> None:
    figures.result = json_object(entry.data)


def _on_decision(figures: Figures, entry: Entry) -> None:
    decision: DecisionBrief = _brief(entry.data).decision
    robot = figures.robots[entry.robot_id]
    if robot.last_ns >= 0:
        robot.longest_gap_ns = max(robot.longest_gap_ns, entry.log_ns - robot.last_ns)
    else:
        robot.first_ns = entry.log_ns
    robot.last_ns = entry.log_ns
    if robot.cell is not None and robot.cell != (-1, -1):
        robot.distance += abs(decision.cell[0] - robot.cell[0]) + abs(decision.cell[1] - robot.cell[1])
    robot.cell = decision.cell
    robot.decisions += 1
    robot.retasks += decision.retask
    robot.fallbacks += bool(decision.fallback)
    figures.latency.add(decision.latency_ns)
    figures.reasons[decision.assignment.reason] += 1


def _on_radio(figures: Figures, entry: Entry) -> None:
    robot = figures.robots[entry.robot_id]
    record: RadioBriefs = _radio(entry.data)
    robot.heard.update(record.ignored)
    robot.messages += record.relayed
    robot.message_bytes += record.relayed_bytes
    for item in record.items:
        if item.way == ch.RadioWay.HEARD.value:
            robot.heard[item.outcome] += 1
            if item.outcome == "accepted":
                figures.delay_ms.add(item.t_ns // 1_000_000 - item.sent_ms)
        else:
            robot.messages += 1
            robot.message_bytes += item.size


def _on_visit(figures: Figures, entry: Entry) -> None:
    figures.visits.append(_visit(entry.data))


def _on_truth(figures: Figures, entry: Entry) -> None:
    if figures.targets is None:
        figures.targets = int((foxglove.read_grid(entry.data).cells == CellState.TARGET).sum())


def _on_belief(figures: Figures, entry: Entry) -> None:
    """Without a simulator's truth, what the robots believe is all that a log can say of targets."""
    if figures.targets is not None:
        return
    states = foxglove.read_grid(entry.data).cells
    for x, y in np.argwhere(states >= CellState.TARGET).tolist():
        figures.known.add((x, y))
        if states[x, y] == CellState.LOCALIZED:
            figures.known_localized.setdefault((x, y), (entry.log_ns, entry.robot_id))


def _on_fault(figures: Figures, entry: Entry) -> None:
    figures.faults[_fault(entry.data).kind] += 1


def _on_health(figures: Figures, entry: Entry) -> None:
    figures.clock_steps_back = _health(entry.data).clock_steps_back


def _on_log(figures: Figures, entry: Entry) -> None:
    line = foxglove.read_log_line(entry.data)
    if line.level >= foxglove.Level.WARNING and len(figures.warnings) < MAX_WARNINGS:
        figures.warnings.append(f"{(entry.log_ns - figures.first_ns) / NS_PER_S:.1f} s {line.name}: {line.text}")


_HANDLERS = {
    ch.RUN_INFO.topic: _on_run_info,
    ch.RESULT.topic: _on_result,
    ch.DECISION.topic: _on_decision,
    ch.RADIO.topic: _on_radio,
    ch.TRUTH_VISITS.topic: _on_visit,
    ch.TRUTH_MAP.topic: _on_truth,
    ch.BELIEF.topic: _on_belief,
    ch.FAULTS.topic: _on_fault,
    ch.HEALTH.topic: _on_health,
    ch.LOG.topic: _on_log,
}
