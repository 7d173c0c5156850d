"""Keeping count of a mission: when each target was localized, and what that cost."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import msgspec
import numpy as np

from gatar_edge.sim_sitl.world import World, reachable_cells, reachable_targets
from gatar_edge.types import BoolGrid, Cell, Decision, RobotKind, TaskKind

_encoder = msgspec.json.Encoder(order="deterministic")


@dataclass(frozen=True, slots=True)
class Result:
    """The figures of one mission; steps are the time in which a robot at cruise speed crosses one cell."""

    team: str
    seed: int
    allocator: str
    targets: int
    reachable: int
    localized: int
    localized_at: tuple[float, ...]  # step of each visit, rising
    steps: int  # the mission's length
    distance: dict[str, float]  # cells travelled by all UAVs, all UGVs
    retasks: int
    duplicates: int  # decisions of one step in which two robots went for one target, counted once a pair and step
    unreachable: int  # decisions for a target that the robot could never reach on the true map
    messages: int
    message_bytes: int
    fallbacks: int
    decision_ns: tuple[int, ...]
    digest: str

    def steps_to(self, percent: float) -> float:
        """Steps until `percent` of the reachable targets were localized; inf if that did not happen."""
        needed = math.ceil(self.reachable * percent / 100)
        if needed == 0:
            return 0.0
        return self.localized_at[needed - 1] if needed <= len(self.localized_at) else math.inf

    def localized_by(self, step: float) -> int:
        """Targets localized by `step`."""
        return sum(at <= step for at in self.localized_at)

    @property
    def mean_time(self) -> float:
        """Mean step of localization over the reachable targets; those never localized count the mission's length."""
        missing = self.reachable - len(self.localized_at)
        return (sum(self.localized_at) + missing * self.steps) / self.reachable if self.reachable else 0.0

    def to_json(self) -> dict[str, Any]:
        """The figures for machines; null for what was not reached."""
        robots = len(self.robot_kinds)
        return {
            "team": self.team,
            "seed": self.seed,
            "allocator": self.allocator,
            "targets": self.targets,
            "reachable": self.reachable,
            "localized": self.localized,
            "localized_by": {str(step): self.localized_by(step) for step in (10, 20, 40)},
            "steps": self.steps,
            "steps_50": _finite(self.steps_to(50)),
            "steps_90": _finite(self.steps_to(90)),
            "steps_100": _finite(self.steps_to(100)),
            "mean_time": round(self.mean_time, 3),
            "distance_cells": {kind: round(cells, 1) for kind, cells in self.distance.items()},
            "retasks": self.retasks,
            "duplicates": self.duplicates,
            "unreachable": self.unreachable,
            "messages_per_robot": round(self.messages / robots, 1),
            "bytes_per_robot": round(self.message_bytes / robots, 1),
            "bytes_per_robot_step": round(self.message_bytes / robots / max(1, self.steps), 1),
            "decisions": len(self.decision_ns),
            "decision_p50_us": percentile_us(self.decision_ns, 50),
            "decision_p99_us": percentile_us(self.decision_ns, 99),
            "fallbacks": self.fallbacks,
            "digest": self.digest,
        }

    @property
    def robot_kinds(self) -> str:
        """One letter a robot."""
        aerial, ground = self.team.removesuffix("G").split("A")
        return "A" * int(aerial) + "G" * int(ground)


@dataclass(slots=True)
class Tally:
    """Counts while a mission runs."""

    world: World
    allocator: str
    seen_from: dict[Cell, float] = field(default_factory=dict)
    distance: dict[str, float] = field(default_factory=lambda: {"UAV": 0.0, "UGV": 0.0})
    retasks: int = 0
    duplicates: int = 0
    unreachable: int = 0
    messages: int = 0
    message_bytes: int = 0
    fallbacks: int = 0
    latencies_ns: list[int] = field(default_factory=list)
    _digest: Any = field(default_factory=hashlib.sha256)
    _open: set[Cell] = field(init=False)
    _reached: dict[int, BoolGrid] = field(init=False)  # by robot id
    reachable: int = field(init=False)

    def __post_init__(self) -> None:
        cells = reachable_targets(self.world)
        self._open = {(int(x), int(y)) for x, y in cells}
        self.reachable = len(self._open)
        self._reached = {robot_id: reachable_cells(self.world, robot_id) for robot_id in self.world.team.ids}

    @property
    def left(self) -> int:
        """Reachable targets that nobody has visited."""
        return len(self._open)

    def visit(self, cell: Cell, step: float) -> bool:
        """A robot is in `cell` at `step`; true where that localizes a target."""
        if cell not in self._open:
            return False
        self._open.discard(cell)
        self.seen_from[cell] = step
        return True

    def travel(self, kind: RobotKind, cells: float) -> None:
        """A robot has moved."""
        self.distance[kind.name] += cells

    def sent(self, datagram: bytes) -> None:
        """A message or a relay went on the air."""
        self.messages += 1
        self.message_bytes += len(datagram)

    def decided(self, decision: Decision, latency_ns: int) -> None:
        """Count one robot's decision and add it to the digest (latency is no part of it)."""
        self.latencies_ns.append(latency_ns)
        self.retasks += decision.retask
        self.fallbacks += bool(decision.fallback)
        if decision.assignment.kind is TaskKind.TARGET:
            self.unreachable += not self._reached[decision.robot_id][decision.assignment.cell]
        self._digest.update(_encoder.encode(decision))

    def decided_together(self, decisions: Sequence[Decision]) -> None:
        """Count what only shows across robots at one moment."""
        goals = [d.assignment.cell for d in decisions if d.assignment.kind is TaskKind.TARGET]
        self.duplicates += len(goals) - len(set(goals))

    def result(self, steps: float) -> Result:
        """The figures so far."""
        return Result(
            team=str(self.world.team),
            seed=self.world.seed,
            allocator=self.allocator,
            targets=len(self.world.targets),
            reachable=self.reachable,
            localized=len(self.seen_from),
            localized_at=tuple(sorted(self.seen_from.values())),
            steps=math.ceil(steps),
            distance=dict(self.distance),
            retasks=self.retasks,
            duplicates=self.duplicates,
            unreachable=self.unreachable,
            messages=self.messages,
            message_bytes=self.message_bytes,
            fallbacks=self.fallbacks,
            decision_ns=tuple(self.latencies_ns),
            digest=self._digest.hexdigest(),
        )


def percentile_us(latencies_ns: Sequence[int], percent: float) -> float | None:
    """A percentile of latencies in microseconds; None where no decision was seen, as those of daemons are not."""
    return round(float(np.percentile(latencies_ns, percent)) / 1000, 1) if latencies_ns else None


def _finite(value: float) -> float | None:
    return round(value, 2) if math.isfinite(value) else None
