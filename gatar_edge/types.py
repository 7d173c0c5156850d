"""The values that travel through gatar-edge: frozen, without behaviour, without clocks.

Cells are (x, y), x east and y north in the grid's own frame; arrays of cells are indexed [x, y].
Time is `t_ns`, nanoseconds of an injected clock. Lengths without a unit in their name are cells.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum, StrEnum
from typing import Any, NewType

import msgspec
import numpy as np
import numpy.typing as npt

Cell = tuple[int, int]
RobotId = NewType("RobotId", int)

BoolGrid = npt.NDArray[np.bool_]
ByteGrid = npt.NDArray[np.uint8]
IntGrid = npt.NDArray[np.int32]
Cells = npt.NDArray[np.int16]  # shape [n, 2]
Floats = npt.NDArray[np.float32]

NS_PER_S = 1_000_000_000


class RobotKind(IntEnum):
    """Aerial robots see over and cross obstacles; ground robots do neither."""

    UAV = 0
    UGV = 1

    @property
    def letter(self) -> str:
        """The paper's letter: A(erial) or G(round)."""
        return "AG"[self]


class CellState(IntEnum):
    """What a robot knows of a cell, in order of precedence when two robots' knowledge is merged."""

    UNKNOWN = 0
    FREE = 1
    OBSTACLE = 2
    TARGET = 3
    LOCALIZED = 4


class TaskKind(IntEnum):
    """What a robot is doing."""

    HOLD = 0
    TARGET = 1
    EXPLORE = 2


class Reason(StrEnum):
    """Why an assignment is what it is: one per cause."""

    ALLOCATED = "allocated"  # the allocator's choice, new at this tick
    KEPT = "kept"  # the task of the tick before still holds
    ABANDONED = "abandoned"  # nothing else to do, and nobody else is on the way to this target
    FRONTIER = "frontier"  # no target for this robot: go and see
    NOTHING_LEFT = "nothing_left"  # no target and nothing reachable left to see
    NO_PERCEPTION = "no_perception"  # own observation missing or too old
    NO_VEHICLE = "no_vehicle"  # the autopilot is lost, without a position, or the pilot has taken over


@dataclass(frozen=True, slots=True)
class GridSpec:
    """The shared grid: integer cells anchored on the Earth.

    The origin is the outer south-west corner of cell (0, 0); `heading_deg` turns the grid's +y axis clockwise from
    north.
    """

    width: int = 15
    height: int = 15
    cell_m: float = 10.0
    origin_lat_deg: float = -35.3632621
    origin_lon_deg: float = 149.1652374
    heading_deg: float = 0.0

    def has(self, cell: Cell) -> bool:
        """Whether `cell` lies on the grid."""
        return 0 <= cell[0] < self.width and 0 <= cell[1] < self.height


class Observation(msgspec.Struct, frozen=True):
    """What one robot saw at `t_ns`: the one place where a user plugs in perception.

    `seen` are all cells in view, `obstacles` and `targets` the subsets that hold one; each int16 [n, 2].
    """

    robot_id: int
    kind: RobotKind
    cell: Cell
    seen: Cells
    obstacles: Cells
    targets: Cells
    t_ns: int


class RobotState(msgspec.Struct, frozen=True):
    """One robot of a decision's graph, as the deciding robot knows it."""

    robot_id: int
    kind: RobotKind
    cell: Cell
    speed_cells_s: float
    task: TaskKind = TaskKind.HOLD
    task_cell: Cell = (-1, -1)
    age_ns: int = 0  # since its state was true; 0 for ego


class Candidate(msgspec.Struct, frozen=True):
    """One target that could have been chosen, as logged with the decision."""

    cell: Cell
    length: int  # cells to travel, -1 where unreachable
    score: float


class Assignment(msgspec.Struct, frozen=True):
    """What one robot decided to do."""

    kind: TaskKind
    cell: Cell  # the target, the frontier cell, or the own cell for HOLD
    reason: Reason
    path: tuple[Cell, ...] = ()  # from the own cell to `cell`, both included, 4-connected
    xy: tuple[float, float] | None = None  # the paper's output: score-weighted mean cell


class Decision(msgspec.Struct, frozen=True):
    """Everything about one tick of one robot that a reviewer may ask for."""

    robot_id: int
    tick: int
    t_ns: int
    cell: Cell
    assignment: Assignment
    allocator: str  # the one that really decided: the fallback's name when it had to step in
    fallback: str  # "" or why the configured allocator was not used
    retask: bool  # a target was given up for another task before it was reached
    robots: tuple[RobotState, ...]  # the graph, ego first, the rest by id
    hops: tuple[int, ...]  # from ego to each robot of the graph
    candidates: tuple[Candidate, ...]
    choices: tuple[int, ...]  # index of the candidate the joint solution gives to each robot, -1 for none
    attention: tuple[float, ...] = ()  # over the robots of the graph, where the allocator has it
    shunned: tuple[Cell, ...] = ()  # cells that the vehicle could not reach lately, taken as unreachable for ego
    steady: bool = False  # the allocator weighs what robots are doing itself: tasks are not kept against its choice
    frontier: Cell | None = None  # where the allocator would have ego look; None where that is left to a rule
    absent: tuple[RobotState, ...] = ()  # robots out of range that were reckoned with, where they are expected
    kept_for_absent: tuple[int, ...] = ()  # like `choices`, of the robots in `absent`
    latency_ns: int = 0  # measured by the caller; not part of the decision's digest


# Commands: what a robot wants its vehicle to do. bridge turns them into MAVLink.


class Goto(msgspec.Struct, frozen=True):
    """Fly straight to the centre of a cell (UAV)."""

    cell: Cell


class Mission(msgspec.Struct, frozen=True):
    """Drive along the centres of cells (UGV): the corners of a 4-connected path, the last one the goal."""

    cells: tuple[Cell, ...]


class Hold(msgspec.Struct, frozen=True):
    """Stay where you are."""

    reason: str


VehicleCommand = Goto | Mission | Hold


class VehicleState(msgspec.Struct, frozen=True):
    """What the bridge knows of its autopilot at `t_ns`."""

    t_ns: int
    connected: bool = False
    armed: bool = False
    ready: bool = False  # armed, airborne if it flies, in a mode that obeys us
    mode: str = ""
    lat_deg: float = float("nan")
    lon_deg: float = float("nan")
    alt_rel_m: float = float("nan")
    speed_m_s: float = 0.0
    heading_deg: float = 0.0
    battery_percent: int = -1
    position_t_ns: int = -1  # when the position was received, -1 never
    cell: Cell | None = None  # None outside the grid or without a position
    phase: str = ""  # the driver's state, by name
    details: Mapping[str, Any] = msgspec.field(default_factory=dict)
