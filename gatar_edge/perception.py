"""The perception datagram: how a camera, a lidar or a simulator tells the daemon what its robot sees.

One datagram is one map in msgpack or JSON (told apart by the first byte), with the fields of `ObservationDatagram`;
docs/observation.schema.json is its JSON Schema. It carries the age of its data instead of a time stamp, so that sender
and daemon need no common clock.

Rule 1: whatever arrives is accepted as a whole or dropped as a whole, and counted by cause; nothing here raises.
Rule 2: each array is bounded before it is made.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from itertools import chain
from typing import Annotated, Literal

import msgspec
import numpy as np
from msgspec import Meta

from gatar_edge.types import Cell, Cells, GridSpec, Observation, RobotKind

MAX_CELLS = 16_384  # of each set; [x, y] in msgpack takes at most 7 bytes, a UDP datagram holds 65507
MAX_OBSERVATION_BYTES = 65_507
MAX_AGE_MS = 600_000.0

_Coordinate = Annotated[int, Meta(ge=-0x8000, le=0x7FFF)]
_Set = Annotated[list[tuple[_Coordinate, _Coordinate]], Meta(max_length=MAX_CELLS)]
_Age = Annotated[float, Meta(ge=0, le=MAX_AGE_MS)]
_Sets = tuple[list[Cell], list[Cell], list[Cell]]  # seen, obstacles, targets
_Arrays = tuple[Cells, Cells, Cells]


class ObservationDatagram(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, omit_defaults=True):
    """What one datagram holds. Cells are [x, y] of the grid, x east and y north; those off the grid are ignored."""

    v: Literal[1]  # version of this format
    seen: _Set  # all cells in view
    obstacles: _Set = msgspec.field(default_factory=list)  # the blocked ones among them
    targets: _Set = msgspec.field(default_factory=list)  # those that hold a target
    cell: tuple[_Coordinate, _Coordinate] | None = None  # where the robot is; absent: the autopilot's position is taken
    age_ms: _Age = 0.0  # how old the data is when it is sent
    robot_id: int | None = None  # whose eyes; absent: the receiver's own


class ObservationOutcome(StrEnum):
    """What became of one datagram: one per cause."""

    ACCEPTED = "accepted"
    TOO_LONG = "too_long"
    MALFORMED = "malformed"  # neither msgpack nor JSON of this format
    NOT_MINE = "not_mine"  # another robot's
    OFF_GRID = "off_grid"  # the robot claims to be outside the grid
    NO_PLACE = "no_place"  # without a cell, and the autopilot does not know one either
    OLDER = "older"  # its data is older than what was accepted before


@dataclass(slots=True)
class Perception:
    """Judges the datagrams of one robot and keeps count; without sockets and without a clock of its own."""

    robot_id: int
    kind: RobotKind
    grid: GridSpec
    counters: dict[ObservationOutcome, int] = field(default_factory=lambda: dict.fromkeys(ObservationOutcome, 0))
    last_error: str = ""  # of the latest malformed datagram, naming the field
    newest_ns: int | None = None  # when the newest accepted data was true
    _accepted_ns: list[int] = field(default_factory=list)
    _told: tuple[_Sets, _Arrays] | None = None  # what was accepted last, as lists and as arrays

    def take(self, data: bytes, now_ns: int, own_cell: Cell | None) -> Observation | None:
        """The observation in `data`, received at `now_ns`, or None; `own_cell` is the autopilot's position."""
        outcome, observation = self._judge(data, now_ns, own_cell)
        self.counters[outcome] += 1
        if observation is not None:
            self.newest_ns = observation.t_ns
            self._accepted_ns = [*self._accepted_ns[-19:], now_ns]
        return observation

    def age_ns(self, now_ns: int) -> int | None:
        """Age of the newest data, None before the first."""
        return None if self.newest_ns is None else now_ns - self.newest_ns

    def rate_hz(self, now_ns: int) -> float:
        """Observations per second over the last twenty; 0 before the second one."""
        if len(self._accepted_ns) < 2:
            return 0.0
        return (len(self._accepted_ns) - 1) * 1e9 / max(1, now_ns - self._accepted_ns[0])

    def _judge(self, data: bytes, now_ns: int, own_cell: Cell | None) -> tuple[ObservationOutcome, Observation | None]:
        if len(data) > MAX_OBSERVATION_BYTES:
            return ObservationOutcome.TOO_LONG, None
        try:
            datagram = decode_datagram(data)
        except (ValueError, RecursionError) as error:  # ValueError: msgspec's own, and keys that are not UTF-8
            self.last_error = str(error)[:200]
            return ObservationOutcome.MALFORMED, None
        cell = datagram.cell if datagram.cell is not None else own_cell
        if cell is None:
            return ObservationOutcome.NO_PLACE, None
        t_ns = now_ns - int(datagram.age_ms * 1e6)
        outcome = self._sort(datagram.robot_id, cell, t_ns)
        if outcome is not ObservationOutcome.ACCEPTED:
            return outcome, None
        seen, obstacles, targets = self._arrays((datagram.seen, datagram.obstacles, datagram.targets))
        return outcome, Observation(self.robot_id, self.kind, cell, seen, obstacles, targets, t_ns)

    def _arrays(self, sets: _Sets) -> _Arrays:
        """The sets as arrays: the same ones where a robot sees the same again, so that nobody looks into them anew."""
        if self._told is None or self._told[0] != sets:
            self._told = sets, (_as_array(sets[0]), _as_array(sets[1]), _as_array(sets[2]))
        return self._told[1]

    def _sort(self, robot_id: int | None, cell: Cell, t_ns: int) -> ObservationOutcome:
        if robot_id not in {None, self.robot_id}:
            return ObservationOutcome.NOT_MINE
        if not self.grid.has(cell):
            return ObservationOutcome.OFF_GRID
        if self.newest_ns is not None and t_ns < self.newest_ns:
            return ObservationOutcome.OLDER
        return ObservationOutcome.ACCEPTED


def encode_observation(observation: Observation, now_ns: int) -> bytes:
    """The msgpack datagram for `observation`, sent at `now_ns` of the clock of `observation.t_ns`."""
    return msgspec.msgpack.encode(
        ObservationDatagram(
            v=1,
            seen=observation.seen.tolist(),
            obstacles=observation.obstacles.tolist(),
            targets=observation.targets.tolist(),
            cell=(int(observation.cell[0]), int(observation.cell[1])),
            age_ms=min(max(0.0, (now_ns - observation.t_ns) / 1e6), MAX_AGE_MS),
            robot_id=observation.robot_id,
        )
    )


def decode_datagram(data: bytes) -> ObservationDatagram:
    """The datagram in `data`, JSON where it begins like a JSON object. Raises ValueError that names the field."""
    # a msgpack map never begins with "{": that byte is the number 123
    if data.lstrip(b" \t\r\n")[:1] == b"{":
        return _JSON.decode(data)
    return _MSGPACK.decode(data)


def observation_schema() -> bytes:
    """The JSON Schema of the datagram, indented, as in docs/observation.schema.json."""
    return msgspec.json.format(msgspec.json.encode(msgspec.json.schema(ObservationDatagram)), indent=2) + b"\n"


def _as_array(cells: list[tuple[int, int]]) -> Cells:
    array = np.fromiter(chain.from_iterable(cells), np.int16, 2 * len(cells)).reshape(-1, 2)
    array.flags.writeable = False
    return array


_JSON = msgspec.json.Decoder(ObservationDatagram)
_MSGPACK = msgspec.msgpack.Decoder(ObservationDatagram)
