"""What the daemon's loop touches: radio, eyes, vehicle, log, saved state and clock, as it sees them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from gatar_edge.driver_memory import DriverMemory
from gatar_edge.health import Snapshot
from gatar_edge.journal import TextLog
from gatar_edge.persist import SavedState
from gatar_edge.separation import Place
from gatar_edge.transports.base import Transport
from gatar_edge.types import ByteGrid, Cell, Decision, GridSpec, Observation, VehicleCommand, VehicleState


class Source(Protocol):
    """Where observations come from; never blocks, never raises."""

    def receive(self) -> list[bytes]: ...


class Vehicle(Protocol):
    """The autopilot behind its bridge; see `vehicle_port.AutopilotPort`."""

    def receive(self, now_ns: int) -> None: ...
    def command(self, wanted: VehicleCommand, now_ns: int) -> VehicleCommand: ...
    def poll(self, now_ns: int) -> None: ...
    def due_ns(self, now_ns: int) -> int: ...
    def state(self, now_ns: int) -> VehicleState: ...
    def cell(self) -> Cell | None: ...
    def critical(self, critical: bool) -> None: ...
    def holding(self, now_ns: int) -> bool: ...
    def failed(self) -> bool: ...
    def neighbors(self, positions: tuple[Place, ...]) -> None: ...
    def return_home(self, now_ns: int) -> bool: ...
    def memory(self) -> DriverMemory: ...


class Log(TextLog, Protocol):
    """The part of `record.Recorder` that the loop feeds."""

    @property
    def stopped(self) -> str: ...
    def observation(self, observation: Observation) -> None: ...
    def heard(self, robot_id: int, datagram: bytes, outcome_name: str, now_ns: int) -> None: ...
    def sent(self, robot_id: int, datagram: bytes, now_ns: int) -> None: ...
    def decision(self, decision: Decision, wanted: VehicleCommand, sent: VehicleCommand, now_ns: int) -> None: ...
    def vehicle(self, robot_id: int, state: VehicleState, now_ns: int) -> None: ...
    def belief(self, robot_id: int, belief: ByteGrid, grid: GridSpec, now_ns: int) -> None: ...
    def poll(self, now_ns: int) -> None: ...


class Saver(Protocol):
    """Keeps states; see `persist.StateSaver`."""

    failed: int
    last_error: str

    def save_soon(self, state: SavedState) -> None: ...


class Watcher(Protocol):
    """Is told of each tick at its time `t_ns`; `snapshot` makes the daemon's, for who looks at it."""

    def __call__(self, t_ns: int, snapshot: Callable[[], Snapshot], /) -> None: ...


@dataclass(frozen=True, slots=True)
class Ports:
    """Everything that the daemon touches."""

    radio: Transport
    perception: Source
    vehicle: Vehicle
    clock_ns: Callable[[], int]
    log: Log | None = None
    saver: Saver | None = None
    published: Watcher = lambda t_ns, snapshot: None
    radio_problem: Callable[[], str] = lambda: ""
