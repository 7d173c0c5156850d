"""The figures of a log as a person or a machine wants them."""

from __future__ import annotations

import math
from typing import Any

from gatar_edge.review.container import Damage
from gatar_edge.review.info import GAP_PERIODS, Figures, RobotFigures
from gatar_edge.types import NS_PER_S, RobotKind


def summarize(figures: Figures, damage: Damage, size_bytes: int) -> dict[str, Any]:
    """What `gatar log info --json` prints: run, duration, robots, result, messages, health."""
    return {
        "finished": damage.finished,
        "size_bytes": size_bytes,
        "duration_s": seconds(figures.last_ns - max(figures.first_ns, 0)),
        "run": run_of(figures.run_info),
        "robots": [_robot(number, figures) for number in sorted(set(figures.robots) | set(_kinds(figures)))],
        "result": result_of(figures),
        "messages": {
            topic: {"count": count, "bytes": figures.bytes[topic]} for topic, count in sorted(figures.messages.items())
        },
        "health": _health(figures, damage),
    }


def run_of(info: dict[str, Any]) -> dict[str, Any]:
    """Who flew what, without the details of the configuration."""
    kinds = [robot.get("kind") for robot in info.get("robots", ())]
    team = f"{kinds.count(0)}A{kinds.count(1)}G"
    wanted = ("team", "seed", "allocator", "model", "model_sha256", "step_s", "scenario", "versions")
    return {"team": team, **{key: info[key] for key in wanted if key in info}}


def result_of(figures: Figures) -> dict[str, Any]:
    """The mission's figures: counted from the log, or as the simulator printed them where it did."""
    robots = figures.robots.values()
    per_robot = max(1, len(figures.robots))
    counted = {
        **_progress(figures),
        "distance_cells": _distance(figures),
        "retasks": sum(robot.retasks for robot in robots),
        "fallbacks": sum(robot.fallbacks for robot in robots),
        "decisions": sum(robot.decisions for robot in robots),
        "messages_per_robot": round(sum(robot.messages for robot in robots) / per_robot, 1),
        "bytes_per_robot": round(sum(robot.message_bytes for robot in robots) / per_robot, 1),
        "decision_p50_us": round(figures.latency.percentile(50) / 1000, 1),
        "decision_p99_us": round(figures.latency.percentile(99) / 1000, 1),
    }
    return counted | (figures.result or {})


def _progress(figures: Figures) -> dict[str, Any]:
    """Localized targets over time; of a real flight, which has no truth, those that the robots knew of."""
    if figures.targets is None:
        known, localized = len(figures.known), len(figures.known_localized)
        unknown = dict.fromkeys(("localized_by", "steps_90", "steps_100"))
        return {"targets": known, "reachable": known, "localized": localized, "truth": False, **unknown}
    steps = sorted(visit.step for visit in figures.visits)
    reachable = int((figures.result or {}).get("reachable", figures.targets))
    return {
        "targets": figures.targets,
        "reachable": reachable,
        "localized": len(steps),
        "localized_by": {str(limit): sum(step <= limit for step in steps) for limit in (10, 20, 40)},
        "steps_90": _step_of(steps, math.ceil(0.9 * reachable)),
        "steps_100": _step_of(steps, reachable),
    }


def _step_of(steps: list[float], count: int) -> float | None:
    if count == 0:
        return 0.0
    return round(steps[count - 1], 2) if count <= len(steps) else None


def _distance(figures: Figures) -> dict[str, int]:
    kinds = _kinds(figures)
    distance = dict.fromkeys((kind.name for kind in RobotKind), 0)
    for number, robot in figures.robots.items():
        distance[RobotKind(kinds.get(number, 0)).name] += robot.distance
    return distance


def _robot(number: int, figures: Figures) -> dict[str, Any]:
    robot = figures.robots.get(number, RobotFigures())
    heard = sum(robot.heard.values())
    return {
        "robot_id": number,
        "kind": RobotKind(_kinds(figures).get(number, 0)).name,
        "decisions": robot.decisions,
        "retasks": robot.retasks,
        "fallbacks": robot.fallbacks,
        "distance_cells": robot.distance,
        "messages": robot.messages,
        "message_bytes": robot.message_bytes,
        "heard": heard,
        "heard_outcomes": dict(sorted(robot.heard.items())),
        "last_decision_s": seconds(robot.last_ns - max(figures.first_ns, 0)) if robot.last_ns >= 0 else None,
    }


def _health(figures: Figures, damage: Damage) -> dict[str, Any]:
    gaps = {
        str(number): seconds(robot.longest_gap_ns)
        for number, robot in sorted(figures.robots.items())
        if robot.longest_gap_ns > GAP_PERIODS * max(1, _period_ns(robot))
    }
    dropped = sum(count for robot in figures.robots.values() for what, count in robot.heard.items() if what in _BAD)
    return {
        "ok": not (gaps or damage.any or figures.not_in_order or figures.clock_steps_back or figures.warnings),
        "gaps_s": gaps,
        "clock_steps_back": figures.clock_steps_back,
        "not_in_order": figures.not_in_order,
        "delay_p50_ms": figures.delay_ms.percentile(50),
        "delay_p99_ms": figures.delay_ms.percentile(99),
        "datagrams_refused": dropped,
        "reasons": dict(figures.reasons),
        "faults": dict(figures.faults),
        "warnings": figures.warnings,
    }


_BAD = frozenset(("malformed", "version", "forged", "foreign_config", "older"))


def _period_ns(robot: RobotFigures) -> int:
    """Mean time between decisions."""
    return (robot.last_ns - robot.first_ns) // (robot.decisions - 1) if robot.decisions > 1 else 0


def _kinds(figures: Figures) -> dict[int, int]:
    return {robot["robot_id"]: robot["kind"] for robot in figures.run_info.get("robots", ())}


def seconds(duration_ns: int) -> float:
    """Nanoseconds as seconds with three decimals."""
    return round(duration_ns / NS_PER_S, 3)
