"""Where a replayed decision differs from the recorded one, field by field."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from gatar_edge.review.company import Json

MAX_FIELDS = 50  # of one difference


def goal_differences(then: Json, now: Json) -> list[Json]:
    """Whether another rule goes elsewhere; how it scores is its own business."""
    keys = ("kind", "cell")
    return [
        d for key in keys for d in differences(then["assignment"][key], now["assignment"][key], f"assignment.{key}")
    ]


def comparable(then: Json, now: Json) -> Json:
    """What is now, without what an older program did not record."""
    return {key: value for key, value in now.items() if key in then}


def differences(then: Any, now: Any, path: str) -> Iterator[Json]:
    """Every field in which two JSON values differ."""
    if isinstance(then, dict) and isinstance(now, dict):
        for key in sorted(then.keys() | now.keys()):
            yield from differences(then.get(key), now.get(key), f"{path}.{key}" if path else key)
    elif isinstance(then, list) and isinstance(now, list) and len(then) == len(now):
        for index, (a, b) in enumerate(zip(then, now, strict=True)):
            yield from differences(a, b, f"{path}[{index}]")
    elif then != now:
        yield {"field": path, "recorded": then, "replayed": now}


def described(robot_id: int, then: Json, now: Json, fields: list[Json]) -> Json:
    """A decision that came out differently."""
    return {
        "robot_id": robot_id,
        "tick": then["tick"],
        "t_ns": then["t_ns"],
        "what": "decision",
        "recorded": then["assignment"],
        "replayed": now["assignment"],
        "fields": fields[:MAX_FIELDS],
    }


def difference(robot_id: int, t_ns: int, what: str, recorded: Any, replayed: Any) -> Json:
    """Anything else that came out differently."""
    return {"robot_id": robot_id, "t_ns": t_ns, "what": what, "recorded": recorded, "replayed": replayed, "fields": []}
