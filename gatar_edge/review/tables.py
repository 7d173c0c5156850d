"""The summary of a log on a terminal."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

Json = dict[str, Any]


def print_summary(path: Path, summary: Json) -> None:
    """Print what `summarize` gives."""
    console = Console(highlight=False)
    run, result = summary["run"], summary["result"]
    end = "" if summary["finished"] else ", not ended properly"
    console.print(f"[bold]{path.name}[/bold]: {summary['duration_s']:.1f} s, {summary['size_bytes'] / 1e6:.2f} MB{end}")
    facts = [run["team"], f"allocator {run.get('allocator', '?')}"]
    facts += [f"{key} {run[key]}" for key in ("seed", "model") if run.get(key) not in (None, "")]
    console.print(", ".join(facts))
    console.print(_result(result))
    console.print(_robots(summary["robots"]))
    console.print(_messages(summary["messages"]))
    for line in health_lines(summary["health"]):
        console.print(line)


def health_lines(health: Json) -> list[str]:
    """What is to be said of the recording itself."""
    lines = [f"delay on the air: p50 {health['delay_p50_ms']:.0f} ms, p99 {health['delay_p99_ms']:.0f} ms"]
    lines += [f"robot {robot}: a gap of {gap:.1f} s between decisions" for robot, gap in health["gaps_s"].items()]
    for key, text in (
        ("datagrams_refused", "datagrams refused"),
        ("clock_steps_back", "times the clock went back"),
        ("not_in_order", "messages not in the order of time"),
    ):
        if health[key]:
            lines.append(f"{health[key]} {text}")
    lines += [f"fault {kind}: {count}" for kind, count in health["faults"].items()]
    lines += [f"warning: {text}" for text in health["warnings"]]
    return [*lines, "recording: sound" if health["ok"] else "recording: see above"]


def _result(result: Json) -> Table:
    table = _table("result", "")
    by = result.get("localized_by") or {}
    known = "" if result.get("truth", True) else " that the robots knew of"
    rows = {
        "targets localized": f"{result['localized']} of {result['reachable']}" + known,
        **{f"  by step {step}": _text(count) for step, count in by.items()},
        "steps to 90 % / 100 %": f"{_text(result.get('steps_90'))} / {_text(result.get('steps_100'))}",
        "distance, cells": ", ".join(f"{kind} {_text(cells)}" for kind, cells in result["distance_cells"].items()),
        "tasks given up": _text(result["retasks"]),
        "fallbacks": _text(result["fallbacks"]),
        "messages, bytes per robot": f"{_text(result['messages_per_robot'])}, {_text(result['bytes_per_robot'])}",
        "decision p50, p99": f"{result['decision_p50_us'] / 1000:.2f} ms, {result['decision_p99_us'] / 1000:.2f} ms",
    }
    for name, value in rows.items():
        table.add_row(name, value)
    return table


def _robots(robots: list[Json]) -> Table:
    table = _table("robot", "decisions", "given up", "cells", "sent", "bytes", "heard", "new")
    for robot in robots:
        accepted = robot["heard_outcomes"].get("accepted", 0)
        values = ("decisions", "retasks", "distance_cells", "messages", "message_bytes", "heard")
        table.add_row(f"{robot['kind']} {robot['robot_id']}", *(_text(robot[key]) for key in values), _text(accepted))
    return table


def _messages(messages: Json) -> Table:
    table = _table("topic", "messages", "kB")
    for topic, counts in messages.items():
        table.add_row(topic, _text(counts["count"]), f"{counts['bytes'] / 1000:.1f}")
    return table


def _table(*heads: str) -> Table:
    table = Table(box=None, pad_edge=False, header_style="dim")
    for index, head in enumerate(heads):
        table.add_column(head, justify="right" if index else "left")
    return table


def _text(value: Any) -> str:
    return "-" if value is None else f"{value:g}" if isinstance(value, float) else str(value)


def print_comparison(result: Json) -> None:
    """Print what `what_if` gives."""
    before, after = result["as_it_was"], result["changed"]
    table = _table(f"from {result['from_s']:g} s on", "as it was", "changed")
    rows: list[tuple[str, Any, Any]] = [
        ("robots", len(before["robots"]), len(after["robots"])),
        *((key.replace("_", " "), before[key], after[key]) for key in ("open_targets", "reachable", "localized")),
    ]
    rows += [(f"  by step {n}", before["localized_by"][n], after["localized_by"][n]) for n in before["localized_by"]]
    rows.append(("steps to 100 %", before["steps_100"], after["steps_100"]))
    rows += [(f"distance {k}, cells", before["distance_cells"][k], after["distance_cells"][k]) for k in ("UAV", "UGV")]
    rows.append(("tasks given up", before["retasks"], after["retasks"]))
    for name, one, other in rows:
        table.add_row(name, _text(one), _text(other))
    Console(highlight=False).print(table)


def replay_lines(result: Json, other: str) -> list[str]:
    """What came of a replay, in words."""
    if other:
        counts = (
            f"{other} would have gone elsewhere in {result['decisions'] - result['equal']} of {result['decisions']}"
        )
        return [f"{counts} decisions", *(_otherwise(d) for d in result["differences"] if d["what"] == "decision")]
    lines = [
        f"{result['robots']} robots, decisions: {result['decisions']}, equal: {result['equal']}",
        f"messages: {result['messages']}, equal: {result['messages_equal']}",
    ]
    first = result["first_difference"]
    if first is None:
        return [*lines, "bit for bit the same"]
    lines.append(f"first difference: robot {first['robot_id']} at t_ns {first['t_ns']}, {first['what']}")
    if not first["fields"]:
        lines.append(f"  recorded {first['recorded']}, replayed {first['replayed']}")
    return lines + [f"  {d['field']}: recorded {d['recorded']}, replayed {d['replayed']}" for d in first["fields"]]


def _otherwise(difference: Json) -> str:
    then, now = difference["recorded"], difference["replayed"]
    return (
        f"robot {difference['robot_id']}, tick {difference['tick']}: {_goal(now)} instead of {_goal(then)}"
        f" (t_ns {difference['t_ns']})"
    )


def _goal(assignment: Json) -> str:
    return f"{('hold', 'target', 'explore')[assignment['kind']]} {tuple(assignment['cell'])}"
