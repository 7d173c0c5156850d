"""What survives `kill -9`: belief, task and message sequence, in one small file that is replaced as a whole.

    magic "GATARST1" | BLAKE2b-128 of the rest | zlib of msgpack of `SavedState`

A file that is missing, damaged, or of another mission never stops a robot: it starts afresh and says why. The message
sequence is taken over whatever the mission, because neighbours remember it.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import threading
import zlib
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import msgspec
import numpy as np

from gatar_edge.agent import Agent
from gatar_edge.config import AgentConfig
from gatar_edge.driver_memory import NOTHING, DriverMemory
from gatar_edge.tasks import Task
from gatar_edge.types import NS_PER_S, ByteGrid, CellState, TaskKind

_MAGIC = b"GATARST1"
_DIGEST_BYTES = 16
MAX_STATE_BYTES = 4_000_000
# Messages that may have been sent after the last save, with room for a disk that stalled: 10/s for two minutes.
SEQ_MARGIN = 1200
# Signed frames that may have left after the last save: ticks of 10 us for 5 s. No more, because a vehicle that was led
# far ahead of the time of day refuses ground stations that come later.
SIGNING_MARGIN = 5 * 100_000


class SavedState(msgspec.Struct, frozen=True, kw_only=True):
    """One moment of a robot's mind. `belief` is the bytes of uint8 [width, height]."""

    robot_id: int
    config_digest: int
    unix_ns: int
    next_seq: int
    width: int
    height: int
    belief: bytes
    task_kind: int
    task_cell: tuple[int, int]
    task_path: list[tuple[int, int]]
    vehicle: DriverMemory = NOTHING
    changes: int = 0  # see `tasks.Task`


class LoadOutcome(StrEnum):
    """What became of the saved state: one per cause."""

    LOADED = "loaded"
    ABSENT = "absent"
    DAMAGED = "damaged"
    OTHER_ROBOT = "other_robot"
    OTHER_MISSION = "other_mission"  # another grid or team configuration: only the sequence is taken over
    TOO_OLD = "too_old"  # only the sequence is taken over


@dataclass(frozen=True, slots=True)
class Restored:
    """What a robot starts with. `state` is None where only the sequence could be taken over; `last_seq` 0 where not."""

    outcome: LoadOutcome
    state: SavedState | None = None
    last_seq: int = 0
    signing_timestamp: int = 0  # likewise, of whatever mission: the vehicle remembers it


def snapshot(agent: Agent, unix_ns: int, vehicle: DriverMemory = NOTHING) -> SavedState:
    """What is to be saved of `agent` and the driver of its vehicle."""
    belief, task = agent.belief, agent.task
    return SavedState(
        robot_id=agent.identity.robot_id,
        config_digest=agent.config.digest(),
        unix_ns=unix_ns,
        next_seq=agent.next_seq,
        width=belief.shape[0],
        height=belief.shape[1],
        belief=belief.tobytes(),
        task_kind=int(task.kind),
        task_cell=(int(task.cell[0]), int(task.cell[1])),
        task_path=[(int(x), int(y)) for x, y in task.path],
        vehicle=vehicle,
        changes=task.changes,
    )


def restore(agent: Agent, state: SavedState) -> None:
    """Give `agent` the belief and the task of `state`, which `load` has checked."""
    belief = np.frombuffer(state.belief, dtype=np.uint8).reshape(state.width, state.height)
    agent.belief = belief  # read-only, as frombuffer makes it
    agent.task = Task(TaskKind(state.task_kind), state.task_cell, tuple(state.task_path), state.changes)


def encode_state(state: SavedState) -> bytes:
    """The file's content."""
    body = zlib.compress(msgspec.msgpack.encode(state), level=1)
    return _MAGIC + _digest(body) + body


def decode_state(data: bytes) -> SavedState | None:
    """The state in `data`, None where that is damaged."""
    body = data[len(_MAGIC) + _DIGEST_BYTES :]
    if not data.startswith(_MAGIC) or data[len(_MAGIC) : len(_MAGIC) + _DIGEST_BYTES] != _digest(body):
        return None
    try:
        unpacker = zlib.decompressobj()
        return msgspec.msgpack.decode(unpacker.decompress(body, MAX_STATE_BYTES), type=SavedState)
    except (zlib.error, ValueError):
        return None


def load(path: Path, robot_id: int, config: AgentConfig, unix_ns: int, max_age_s: float) -> Restored:
    """What the file at `path` gives a robot that starts now. Never raises for what the file holds."""
    try:
        with path.open("rb") as file:
            state = decode_state(file.read(MAX_STATE_BYTES))
    except FileNotFoundError:
        return Restored(LoadOutcome.ABSENT)
    except OSError:
        state = None
    if state is None or not _plausible(state):
        return Restored(LoadOutcome.DAMAGED)
    if state.robot_id != robot_id:
        return Restored(LoadOutcome.OTHER_ROBOT)
    same_grid = (state.width, state.height) == (config.grid.width, config.grid.height)
    outcome = LoadOutcome.LOADED
    if state.config_digest != config.digest() or not same_grid:
        outcome = LoadOutcome.OTHER_MISSION
    elif not 0 <= unix_ns - state.unix_ns <= max_age_s * NS_PER_S:
        outcome = LoadOutcome.TOO_OLD
    signing = state.vehicle.signing_timestamp
    return Restored(
        outcome,
        state if outcome is LoadOutcome.LOADED else None,
        state.next_seq - 1 + SEQ_MARGIN,
        signing + SIGNING_MARGIN if signing else 0,
    )


def write_atomically(path: Path, data: bytes) -> None:
    """Replace the file at `path` by `data`: after a power cut there is the old one or the new one. Raises OSError."""
    temporary = path.with_name(path.name + ".new")
    with temporary.open("wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
    temporary.replace(path)
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


class StateSaver:
    """Writes states in a thread of its own, the newest only: a slow disk must not hold up the robot's loop."""

    def __init__(self, path: Path) -> None:
        self.saved = 0
        self.failed = 0
        self.last_error = ""
        self._path = path
        self._waiting: SavedState | None = None
        self._closing = False
        self._wake = threading.Condition()
        self._thread = threading.Thread(target=self._work, name="state", daemon=True)
        self._thread.start()

    def save_soon(self, state: SavedState) -> None:
        """Hand over a state; one that still waits is replaced."""
        with self._wake:
            self._waiting = state
            self._wake.notify()

    def close(self, timeout_s: float = 5.0) -> None:
        """Write what waits and stop."""
        with self._wake:
            self._closing = True
            self._wake.notify()
        self._thread.join(timeout_s)

    def _work(self) -> None:
        while True:
            with self._wake:
                while self._waiting is None and not self._closing:
                    self._wake.wait()
                state, self._waiting = self._waiting, None
            if state is None:
                return
            self._write(state)

    def _write(self, state: SavedState) -> None:
        try:
            write_atomically(self._path, encode_state(state))
        except OSError as error:  # disk full or gone: the robot goes on, and says so
            self.failed += 1
            self.last_error = error.strerror or str(error)
            with contextlib.suppress(OSError):
                self._path.with_name(self._path.name + ".new").unlink(missing_ok=True)
        else:
            self.saved += 1


def _plausible(state: SavedState) -> bool:
    cells: ByteGrid = np.frombuffer(state.belief, dtype=np.uint8)
    return (
        state.task_kind in set(TaskKind)
        and state.next_seq >= 0
        and state.changes >= 0
        and state.width > 0
        and len(cells) == state.width * state.height
        and int(cells.max(initial=0)) <= CellState.LOCALIZED
        and all(0 <= x < state.width and 0 <= y < state.height for x, y in (*state.task_path, *state.vehicle.cells))
        and 0 <= state.vehicle.signing_timestamp < 1 << 47
    )


def _digest(body: bytes) -> bytes:
    return hashlib.blake2b(body, digest_size=_DIGEST_BYTES).digest()
