"""The autopilot as the daemon's loop sees it: the bridge's driver on a link, its frames and events in the log."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, Protocol

from gatar_edge.bridge.driver import VehicleDriver
from gatar_edge.bridge.launch import Phase
from gatar_edge.bridge.status import EventKind, Status
from gatar_edge.driver_memory import DriverMemory
from gatar_edge.journal import Journal
from gatar_edge.separation import Place
from gatar_edge.types import Cell, VehicleCommand, VehicleState

_QUIET = {EventKind.COMMAND, EventKind.STATUS, EventKind.RATES}  # in the log alone, not in the journal
STANDS_M_S = 0.3


class BytesLink(Protocol):
    """A way to the autopilot; see `bridge.link`. Never blocks, never raises once open."""

    def receive(self) -> list[bytes]: ...
    def send(self, data: bytes, sysid: int | None = None) -> bool: ...


class FrameLog(Protocol):
    """See `record.Recorder.mavlink`."""

    def mavlink(self, robot_id: int, direction: Literal["rx", "tx"], frame: bytes, now_ns: int) -> None: ...


class AutopilotPort:
    """Pumps bytes between driver and link. A `ports.Vehicle`."""

    def __init__(
        self,
        driver: VehicleDriver,
        link: BytesLink,
        journal: Journal,
        log: FrameLog | None = None,
        *,
        launch_when_armed: bool,
        tap: Callable[[bytes], None] | None = None,
    ) -> None:
        self.driver = driver
        self._link = link
        self._journal = journal
        self._log = log
        self._launch_when_armed = launch_when_armed
        self._tap = tap

    def receive(self, now_ns: int) -> None:
        """Take in what the autopilot sent."""
        for data in self._link.receive():
            self.driver.receive(data, now_ns)
            if self._tap is not None:
                self._tap(data)

    def command(self, wanted: VehicleCommand, now_ns: int) -> VehicleCommand:
        """Want this from now on; returns what passed the safety gate."""
        return self.driver.command(wanted, now_ns)

    def neighbors(self, positions: tuple[Place, ...]) -> None:
        """Where other robots are that it must keep away from."""
        self.driver.neighbors(positions)

    def failed(self) -> bool:
        """Whether the vehicle cannot go where it was last told to: that goal is another robot's."""
        return self.driver.cannot_go

    def poll(self, now_ns: int) -> None:
        """Send what is due: heartbeat, requests, retries; log what went both ways."""
        if self._launch_when_armed and _given(self.driver.state(now_ns)):
            self._launch_when_armed = False
            self._journal.info("armed by hand: taking over", now_ns)
            self.driver.launch()
        data = self.driver.poll(now_ns)
        if data:
            self._link.send(data, self.driver.config.sysid)
        frames = self.driver.frames()
        if self._log is not None:
            for frame in frames:
                self._log.mavlink(self.driver.config.robot_id, "tx" if frame.outgoing else "rx", frame.raw, frame.t_ns)
        for event in self.driver.events():
            say = self._journal.note if event.kind in _QUIET else self._journal.info
            say(f"vehicle {event.kind.value}: {event.text}", event.t_ns)

    def due_ns(self, now_ns: int) -> int:
        """When `poll` has something to do next, unless something arrives or is commanded first."""
        return self.driver.due_ns(now_ns)

    def state(self, now_ns: int) -> VehicleState:
        """What is known of the vehicle."""
        return self.driver.state(now_ns)

    def cell(self) -> Cell | None:
        """Where the vehicle is, as it tells."""
        return self.driver.cell()

    def memory(self) -> DriverMemory:
        """What the next process needs to go on, if this one is killed."""
        return self.driver.memory()

    def critical(self, critical: bool) -> None:
        """Let the heartbeat say that the robot's own mind fails."""
        self.driver.health(critical)

    def holding(self, now_ns: int) -> bool:
        """Whether the vehicle stands still on our order, or does not obey us anyway."""
        state = self.driver.state(now_ns)
        return not state.ready or (state.speed_m_s < STANDS_M_S and self.driver.status is Status.HOLDING)

    def return_home(self, now_ns: int) -> bool:
        """Let it return to launch; true once it does, or does not obey us anyway."""
        return self.driver.return_home(now_ns)

    def enable(self, now_ns: int) -> None:
        """Command again after the pilot had control."""
        self.driver.enable(now_ns)


def _given(state: VehicleState) -> bool:
    """Whether a person has armed the vehicle for us, and does not fly it."""
    return state.armed and state.phase != Phase.PILOT.value
