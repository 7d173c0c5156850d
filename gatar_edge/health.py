"""How the daemon is: counters, a snapshot for people and machines, and what is wrong, if anything is.

The snapshot is a frozen value, made by the loop in a tick that somebody looks at; whoever watches (service manager,
HTTP, terminal) reads that and nothing else.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import msgspec

from gatar_edge.types import NS_PER_S, Cell, Decision, VehicleState

CRITICAL_AFTER = 3  # ticks in a row that the fallback had to decide: MAV_STATE_CRITICAL


class NeighborLine(msgspec.Struct, frozen=True):
    """One neighbour, as seen from here."""

    robot_id: int
    kind: str
    cell: tuple[int, int]
    task: str
    task_cell: tuple[int, int]
    age_s: float
    hops: int


class Snapshot(msgspec.Struct, frozen=True, kw_only=True):
    """The daemon at one tick. Times are seconds; counters count from the start."""

    robot_id: int
    kind: str
    allocator: str
    dry_run: bool
    t_ns: int
    uptime_s: float
    cell: tuple[int, int]
    task: str
    task_cell: tuple[int, int]
    reason: str
    neighbors: list[NeighborLine]
    vehicle_connected: bool
    vehicle_ready: bool
    vehicle_mode: str
    vehicle_phase: str
    battery_percent: int
    perception_age_s: float | None
    perception_rate_hz: float
    decision_ms: float
    fallbacks_in_a_row: int
    radio_problem: str
    log_problem: str
    state_problem: str
    counters: dict[str, int]

    @property
    def problems(self) -> list[str]:
        """What a person should look at; empty when all is well."""
        found = []
        if not self.vehicle_connected:
            found.append("no heartbeat from the autopilot")
        if self.reason == "no_perception":
            age = self.perception_age_s
            found.append("no perception yet" if age is None else f"perception is {age:.1f} s old")
        if self.reason == "no_vehicle" and self.vehicle_connected:
            found.append(f"the vehicle does not obey ({self.vehicle_phase or 'no position'})")
        if self.fallbacks_in_a_row >= CRITICAL_AFTER:
            found.append(f"{self.allocator} failed {self.fallbacks_in_a_row} ticks in a row")
        found += [problem for problem in (self.radio_problem, self.log_problem, self.state_problem) if problem]
        return found

    @property
    def line(self) -> str:
        """One line for `systemctl status`."""
        where = f"at {self.cell[0]},{self.cell[1]}" if self.cell != (-1, -1) else "place unknown"
        what = self.reason if self.task == "HOLD" else f"{self.task.lower()} {self.task_cell[0]},{self.task_cell[1]}"
        mode = self.vehicle_mode or "no autopilot"
        line = f"{self.kind} {self.robot_id} {where}: {what}; {len(self.neighbors)} neighbours; {mode}"
        return line + "".join(f"; {problem}" for problem in self.problems)


@dataclass(slots=True)
class Counters:
    """What the loop counts itself; transports, budget, neighbours and perception count their own."""

    ticks: int = 0
    ticks_skipped: int = 0  # the loop was held up for longer than a tick
    stalls: int = 0  # the loop stood still for so long that what had queued up was thrown away
    fallbacks: int = 0
    late: int = 0  # fallbacks because the allocator missed its deadline
    retasks: int = 0
    held: int = 0  # decisions to stand still for want of perception or vehicle
    commands_changed: int = 0  # by the safety gate
    fallbacks_in_a_row: int = 0
    shunned: int = 0  # targets and frontiers given back because the vehicle could not go there

    def decided(self, decision: Decision) -> None:
        """Count one decision."""
        self.ticks += 1
        self.retasks += decision.retask
        if decision.robots:
            self.fallbacks += bool(decision.fallback)
            self.late += decision.fallback.startswith("DeadlineError")
            self.fallbacks_in_a_row = self.fallbacks_in_a_row + 1 if decision.fallback else 0
        else:
            self.held += 1  # no allocator was asked: says nothing about it

    @property
    def critical(self) -> bool:
        """Whether the companion must call itself critical."""
        return self.fallbacks_in_a_row >= CRITICAL_AFTER


@dataclass(slots=True)
class Shunned:
    """Cells that the vehicle could not reach: left alone for a minute, then tried again."""

    forget_ns: int = 60 * NS_PER_S
    _until_ns: dict[Cell, int] = field(default_factory=dict)

    def failed(self, cell: Cell, now_ns: int) -> None:
        """The vehicle could not go to `cell`."""
        self._until_ns[cell] = now_ns + self.forget_ns

    def cells(self, now_ns: int) -> frozenset[Cell]:
        """What is to be left alone now."""
        self._until_ns = {cell: until_ns for cell, until_ns in self._until_ns.items() if until_ns > now_ns}
        return frozenset(self._until_ns)


def usable(state: VehicleState, now_ns: int, shadow: bool, max_position_age_s: float = 1.0) -> bool:
    """Whether the robot may take part: the autopilot is heard, knows its place, and obeys (asked of none in shadow)."""
    fresh = state.position_t_ns >= 0 and now_ns - state.position_t_ns <= max_position_age_s * NS_PER_S
    return state.connected and fresh and (state.ready or shadow)
