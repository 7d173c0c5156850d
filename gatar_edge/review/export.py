"""A log as tables for a spreadsheet, and its MAVLink as telemetry logs for ground stations."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from gatar_edge import channels as ch
from gatar_edge.errors import LogError
from gatar_edge.review.company import absent_of
from gatar_edge.review.reader import Entry, LogReader, json_object
from gatar_edge.types import NS_PER_S, RobotKind, TaskKind

Row = tuple[Any, ...]


def export_csv(log: LogReader, folder: Path) -> dict[str, int]:
    """Write one table a kind of record into `folder`; the rows written, by file. Raises LogError."""
    counts: dict[str, int] = {}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with ExitStack() as stack:
            writers: dict[str, Any] = {}
            for name, (_, heads, _) in TABLES.items():
                file = stack.enter_context((folder / f"{name}.csv").open("w", newline="", encoding="utf-8"))
                writers[name] = csv.writer(file)
                writers[name].writerow(heads)
                counts[f"{name}.csv"] = 0
            for entry in log.messages(lambda channel, _: any(channel is table[0] for table in TABLES.values())):
                for name, (channel, _, rows) in TABLES.items():
                    if entry.channel is channel:
                        for row in rows(entry, json_object(entry.data)):
                            writers[name].writerow(row)
                            counts[f"{name}.csv"] += 1
    except OSError as error:
        raise LogError(f"{folder} cannot be written: {error.strerror}") from error
    return counts


def export_tlog(log: LogReader, folder: Path) -> dict[str, int]:
    """Write one .tlog a robot into `folder`, as ground stations read them; the frames written, by file.

    A tlog is frames, each after the microseconds since 1970 as a big-endian 64-bit number. Raises LogError.
    """
    counts: dict[str, int] = {}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with ExitStack() as stack:
            files: dict[int, Any] = {}
            for entry in log.messages(lambda channel, _: channel.encoding is ch.Encoding.MAVLINK):
                name = f"robot_{entry.robot_id}.tlog"
                if entry.robot_id not in files:
                    files[entry.robot_id] = stack.enter_context((folder / name).open("wb"))
                    counts[name] = 0
                files[entry.robot_id].write((entry.log_ns // 1000).to_bytes(8, "big") + entry.data)
                counts[name] += 1
    except OSError as error:
        raise LogError(f"{folder} cannot be written: {error.strerror}") from error
    return counts


def _decisions(entry: Entry, record: dict[str, Any]) -> Iterator[Row]:
    d = record["decision"]
    a = d["assignment"]
    xy = a["xy"] or ("", "")
    way = max(0, len(a["path"]) - 1)
    yield (
        _seconds(entry), d["robot_id"], d["tick"], *d["cell"], TaskKind(a["kind"]).name, *a["cell"], a["reason"], way,
        *xy, d["allocator"], d["fallback"], int(d["retask"]), max(0, len(d["robots"]) - 1),
        len(d.get("absent", ())), len(d["candidates"]),
        d["latency_ns"] / 1e6, record["wanted"]["type"], record["sent"]["type"],
    )  # fmt: skip


def _remembered(entry: Entry, record: dict[str, Any]) -> Iterator[Row]:
    d = record["decision"]
    for robot in absent_of(d):
        yield (
            _seconds(entry), d["robot_id"], d["tick"], robot["robot_id"], RobotKind(robot["kind"]).name, *robot["cell"],
            robot["age_s"], TaskKind(robot["task"]).name, *robot["task_cell"], *(robot["given"] or ("", "")),
        )  # fmt: skip


def _radio(entry: Entry, record: dict[str, Any]) -> Iterator[Row]:
    for item in record["items"]:
        names = ("way", "outcome", "author", "seq", "hops", "sent_ms", "size")
        yield (item["t_ns"] / NS_PER_S, entry.robot_id, *(item.get(name, "") for name in names))


def _vehicles(entry: Entry, record: dict[str, Any]) -> Iterator[Row]:
    state = record["state"]
    yield (_seconds(entry), entry.robot_id, *(_blank(state[name]) for name in _VEHICLE))


def _positions(entry: Entry, record: dict[str, Any]) -> Iterator[Row]:
    for robot in record["robots"]:
        yield (_seconds(entry), robot["robot_id"], robot["x"], robot["y"])


def _visits(entry: Entry, record: dict[str, Any]) -> Iterator[Row]:
    yield (_seconds(entry), record["robot_id"], *record["cell"], record["step"])


def _robots(entry: Entry, record: dict[str, Any]) -> Iterator[Row]:
    for robot in record.get("robots", ()):
        yield (_seconds(entry), robot["robot_id"], RobotKind(robot["kind"]).name, robot["speed_cells_s"])


def _seconds(entry: Entry) -> float:
    return entry.log_ns / NS_PER_S


def _blank(value: Any) -> Any:
    return "" if value is None else value


_VEHICLE = (
    "connected", "armed", "ready", "mode", "phase", "lat_deg", "lon_deg", "alt_rel_m", "speed_m_s", "heading_deg",
    "battery_percent",
)  # fmt: skip
_DECISION = (
    "t_s", "robot", "tick", "x", "y", "task", "task_x", "task_y", "reason", "way_cells", "out_x", "out_y", "allocator",
    "fallback", "retask", "robots_heard", "robots_remembered", "targets_known", "latency_ms", "wanted", "sent",
)  # fmt: skip
_REMEMBERED = (
    "t_s", "robot", "tick", "other", "kind", "x", "y", "silent_s", "task", "task_x", "task_y", "kept_x", "kept_y",
)  # fmt: skip
TABLES: dict[str, tuple[ch.Channel, tuple[str, ...], Callable[[Entry, dict[str, Any]], Iterator[Row]]]] = {
    "decisions": (ch.DECISION, _DECISION, _decisions),
    "remembered": (ch.DECISION, _REMEMBERED, _remembered),
    "radio": (ch.RADIO, ("t_s", "robot", "way", "outcome", "author", "seq", "hops", "sent_ms", "bytes"), _radio),
    "vehicles": (ch.VEHICLE, ("t_s", "robot", *_VEHICLE), _vehicles),
    "positions": (ch.TRUTH_ROBOTS, ("t_s", "robot", "x", "y"), _positions),
    "visits": (ch.TRUTH_VISITS, ("t_s", "robot", "x", "y", "step"), _visits),
    "robots": (ch.RUN_INFO, ("t_s", "robot", "kind", "speed_cells_s"), _robots),
}
