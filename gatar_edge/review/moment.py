"""Finds the decision of one robot at one moment."""

from __future__ import annotations

from gatar_edge import channels as ch
from gatar_edge.errors import LogError
from gatar_edge.review.company import Json
from gatar_edge.review.explain import explain
from gatar_edge.review.info import read_figures
from gatar_edge.review.reader import Entry, LogReader, json_object
from gatar_edge.review.story import mission_start_ns
from gatar_edge.types import NS_PER_S


def explain_at(log: LogReader, robot_id: int, t_s: float) -> Json:
    """The explanation of what `robot_id` was doing `t_s` after the mission's first decision.

    Where the robot only kept its task then, `since` explains the decision that chose it. Raises LogError where the
    robot or the moment is not in the log.
    """
    figures = read_figures(log)
    start_ns = mission_start_ns(figures)
    last: Entry | None = None
    before: Entry | None = None
    chosen: tuple[Entry, Entry | None] | None = None
    for entry in log.messages(lambda channel, number: channel is ch.DECISION and number == robot_id):
        if entry.log_ns > start_ns + round(t_s * NS_PER_S):
            break
        before, last = last, entry
        if before is None or _goal(before) != _goal(entry):
            chosen = (entry, before)
    if last is None or chosen is None:
        known = ", ".join(map(str, sorted(figures.robots))) or "none"
        raise LogError(
            f"log {log.path} has no decision of robot {robot_id} up to {t_s:g} s; robots with decisions: {known}"
        )
    now = _explained(last, before, start_ns)
    return {**now, "since": None if chosen[0] is last else _explained(*chosen, start_ns)}


def _goal(entry: Entry) -> object:
    assignment = json_object(entry.data)["decision"]["assignment"]
    return (assignment["kind"], assignment["cell"])


def _explained(entry: Entry, before: Entry | None, start_ns: int) -> Json:
    record = json_object(entry.data)
    previous = None if before is None else json_object(before.data)["decision"]
    return {"t_s": round((entry.log_ns - start_ns) / NS_PER_S, 3), **explain(record["decision"], previous, record)}
