"""A mission log in files of bounded length, of which the oldest are deleted: a robot's disk must not fill up.

A file ends after a time as well because its index grows in memory until it is closed. The oldest is the one written
last the longest ago; a limit by age is not offered, because a robot without a battery for its clock starts in 1970.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from gatar_edge import channels as ch
from gatar_edge.errors import LogError
from gatar_edge.foxglove import Level
from gatar_edge.persist import SavedState
from gatar_edge.record import Recorder
from gatar_edge.types import ByteGrid, Decision, GridSpec, Observation, VehicleCommand, VehicleState


@dataclass(frozen=True, slots=True)
class Ring:
    """How long files get, and how much stays. A limit of 0 is none."""

    file_ns: int
    file_bytes: int = 0
    total_bytes: int = 0  # of all files of one robot, the one that is being written at its full length
    files: int = 0  # with the one that is being written


def make_room(folder: Path, stem: str, ring: Ring) -> list[str]:
    """Delete the oldest logs named `stem`-TIME in `folder` until another file fits in; their names.

    Files with other names, such as merged or recovered ones, are somebody's work and stay, as does what the system
    refuses to delete.
    """
    named = re.compile(re.escape(stem) + r"-\d{8}T\d{6}Z(-\d+)?\.mcap")
    found = []
    for path in folder.glob(f"{stem}-*.mcap"):
        try:
            about = path.stat()
        except OSError:
            continue
        if named.fullmatch(path.name):
            found.append((about.st_mtime_ns, path.name, about.st_size))
    found.sort()
    total, count, deleted = sum(size for *_, size in found), len(found), []
    for _, name, size in found:
        too_large = ring.total_bytes and total + ring.file_bytes > ring.total_bytes
        if not too_large and not (ring.files and count >= ring.files):
            break
        try:
            (folder / name).unlink()
        except OSError:
            continue
        deleted.append(name)
        total, count = total - size, count - 1
    return deleted


class RotatingLog:
    """A `daemon.Log` that goes on in a new file when `ring` says so; `gatar log merge` puts the files together.

    `open_file(now_ns)` makes the next `Recorder`; where it raises LogError the log ends, and the robot goes on.
    `carry`, once set, tells what the robot knows when a new file begins.
    """

    carry: Callable[[], ch.AgentStateRecord] | None = None

    def __init__(self, open_file: Callable[[int], Recorder], ring: Ring, now_ns: int) -> None:
        self._open_file = open_file
        self._ring = ring
        self._recorder = open_file(now_ns)
        self._due_ns = now_ns + ring.file_ns

    @property
    def stopped(self) -> str:
        """Why nothing is recorded any more, or empty."""
        return self._recorder.stopped

    def observation(self, observation: Observation) -> None:
        """See `Recorder.observation`."""
        self._recorder.observation(observation)

    def heard(self, robot_id: int, datagram: bytes, outcome_name: str, now_ns: int) -> None:
        """See `Recorder.heard`."""
        self._recorder.heard(robot_id, datagram, outcome_name, now_ns)

    def sent(self, robot_id: int, datagram: bytes, now_ns: int) -> None:
        """See `Recorder.sent`."""
        self._recorder.sent(robot_id, datagram, now_ns)

    def decision(self, decision: Decision, wanted: VehicleCommand, sent: VehicleCommand, now_ns: int) -> None:
        """See `Recorder.decision`."""
        self._recorder.decision(decision, wanted, sent, now_ns)

    def vehicle(self, robot_id: int, state: VehicleState, now_ns: int) -> None:
        """See `Recorder.vehicle`."""
        self._recorder.vehicle(robot_id, state, now_ns)

    def mavlink(self, robot_id: int, direction: Literal["rx", "tx"], frame: bytes, now_ns: int) -> None:
        """See `Recorder.mavlink`."""
        self._recorder.mavlink(robot_id, direction, frame, now_ns)

    def belief(self, robot_id: int, belief: ByteGrid, grid: GridSpec, now_ns: int) -> None:
        """See `Recorder.belief`."""
        self._recorder.belief(robot_id, belief, grid, now_ns)

    def text(self, level: Level, robot_id: int, text: str, now_ns: int) -> None:
        """See `Recorder.text`."""
        self._recorder.text(level, robot_id, text, now_ns)

    def takes_over(self, state: SavedState, now_ns: int) -> None:
        """See `Recorder.takes_over`."""
        self._recorder.takes_over(state, now_ns)

    def poll(self, now_ns: int) -> None:
        """Write what is due; begin the next file when this one is old or large enough."""
        self._recorder.poll(now_ns)
        full = self._ring.file_bytes and self._recorder.size_bytes >= self._ring.file_bytes
        if self._recorder.stopped or not (full or now_ns >= self._due_ns):
            return
        self._due_ns = now_ns + self._ring.file_ns
        self._recorder.close()
        try:
            self._recorder = self._open_file(now_ns)
        except LogError as error:
            self._recorder.stopped = str(error)
            return
        if self.carry is not None:
            self._recorder.goes_on(self.carry(), now_ns)

    def close(self) -> None:
        """Complete the file."""
        self._recorder.close()
