"""A mission log in files of bounded length: the index of an MCAP file grows in memory until the file is closed."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

from gatar_edge.errors import LogError
from gatar_edge.foxglove import Level
from gatar_edge.persist import SavedState
from gatar_edge.record import Recorder
from gatar_edge.types import ByteGrid, Decision, GridSpec, Observation, VehicleCommand, VehicleState


class RotatingLog:
    """A `daemon.Log` that goes on in a new file after `period_ns`; `gatar log merge` puts the files together.

    `open_file(now_ns)` makes the next `Recorder`; where it raises LogError the log ends, and the robot goes on.
    `carry`, once set, tells what the robot knows when a new file begins.
    """

    carry: Callable[[], SavedState] | None = None

    def __init__(self, open_file: Callable[[int], Recorder], period_ns: int, now_ns: int) -> None:
        self._open_file = open_file
        self._period_ns = period_ns
        self._recorder = open_file(now_ns)
        self._due_ns = now_ns + period_ns

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
        """Write what is due; begin the next file when its time has come."""
        self._recorder.poll(now_ns)
        if now_ns < self._due_ns or self._recorder.stopped:
            return
        self._due_ns = now_ns + self._period_ns
        self._recorder.close()
        try:
            self._recorder = self._open_file(now_ns)
        except LogError as error:
            self._recorder.stopped = str(error)
            return
        if self.carry is not None:
            self.takes_over(self.carry(), now_ns)

    def close(self) -> None:
        """Complete the file."""
        self._recorder.close()
