"""One vehicle's driver: bytes in, bytes out, commands through the gate. Sans-IO; the caller owns sockets and time.

driver = VehicleDriver(config, now_ns)
driver.receive(data, now_ns)            # whatever came from the wire
driver.command(Goto((3, 4)), now_ns)    # what the robot wants; returns what is really pursued
link.send(driver.poll(now_ns))          # the working loop: heartbeat, requests, retries
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace

from gatar_edge.bridge import dialect, wire
from gatar_edge.bridge.codec import Codec, strip_signature
from gatar_edge.bridge.geo import Point, inside_grid, is_rest, wgs84_to_grid_m
from gatar_edge.bridge.heartbeat import Heart
from gatar_edge.bridge.launch import Event as LaunchEvent
from gatar_edge.bridge.launch import Phase
from gatar_edge.bridge.profiles import Unsupported, choose
from gatar_edge.bridge.safety import GOAL_REFUSALS, Known, Refusal, gate
from gatar_edge.bridge.settings import DriverConfig
from gatar_edge.bridge.signing import TICK_NS, Signing
from gatar_edge.bridge.status import DriverEvent, EventKind, FrameRecord, Status
from gatar_edge.bridge.vehicle import Vehicle
from gatar_edge.driver_memory import NOTHING, DriverMemory
from gatar_edge.separation import Place
from gatar_edge.types import NS_PER_S, Cell, Hold, Mission, VehicleCommand, VehicleState

MAX_EVENTS = 1000
MAX_FRAMES = 8192


class VehicleDriver:
    """Drives one vehicle. Nothing that a peer sends makes it raise."""

    def __init__(
        self,
        config: DriverConfig,
        now_ns: int,
        signing: Signing | None = None,
        memory: DriverMemory = NOTHING,
    ) -> None:
        """`signing`: the key of this link, its `timestamp` as `memory` has it; `memory`: of the process before this."""
        self.config = config
        self._codec = Codec(config.sysid, config.compid, signing)
        # signing timestamps go on from where the caller began, at the pace of the injected clock
        self._signing_base = signing.timestamp - now_ns // TICK_NS if signing is not None else 0
        self._limits = config.limits()
        self._neighbors: tuple[Place, ...] = ()
        self._vehicle: Vehicle | None = None
        self._unsupported: str | None = None
        self._launch = config.auto_launch
        self._connected = False
        self._pursued: VehicleCommand = Hold("no command yet")
        self._refused_goal = False
        self._memory = memory  # until it was used
        self._here: tuple[tuple[float, float], Point] | None = None  # (lat, lon) and the same in the grid's metres
        self._applied = False  # it was sent
        self._start_cell: Cell | None = None  # where the pursued mission began
        self._retasked_ns = -1
        self._failed_ns: int | None = None  # since when the pursuit fails
        self._retasks = 0
        self._heart = Heart(config.heartbeat_hz, config.critical_s, now_ns)
        self._stirred = True  # something came since the last poll
        self._due_ns: int | None = None  # when `poll` is needed next if nothing comes; None: not worked out
        self._events: deque[DriverEvent] = deque(maxlen=MAX_EVENTS)
        self._frames: deque[FrameRecord] = deque(maxlen=MAX_FRAMES)

    # --- what the caller does ---

    def receive(self, data: bytes, now_ns: int) -> None:
        """Take bytes from the wire, whole frames or pieces; frames of other vehicles are ignored."""
        for frame in self._codec.parse(data):
            if frame.source[0] != self.config.sysid:
                continue
            if self.config.log_frames and frame.message_id != dialect.MessageId.SETUP_SIGNING:
                self._frames.append(FrameRecord(now_ns, False, frame.raw))
            if self._vehicle is None:
                self._look_at(frame, now_ns)
                self._stirred = True
            if self._vehicle is not None and frame.source == self._vehicle.address:
                self._stirred |= self._vehicle.receive(frame, now_ns) or not self._connected

    def command(self, wanted: VehicleCommand, now_ns: int) -> VehicleCommand:
        """Want this from now on. Returns what passed the gate and is pursued; the same again changes nothing."""
        passed = gate(wanted, self._known(now_ns), self._limits)
        self._refused_goal = isinstance(passed, Hold) and passed.reason in GOAL_REFUSALS
        if passed not in (wanted, self._pursued) and isinstance(passed, Hold):
            self._tell(now_ns, EventKind.GATE, f"{wanted} -> {passed.reason}")
        if self._resumes(passed, now_ns):
            return self._pursued
        if self._unchanged(passed, now_ns):
            if isinstance(passed, Hold):
                self._pursued = passed  # perhaps for another reason
            return self._pursued
        if not isinstance(passed, Hold):
            self._retasks += passed != self._pursued
            self._retasked_ns = now_ns
        self._pursued, self._failed_ns, self._start_cell = passed, None, self.cell()
        self._memory, self._stirred = NOTHING, True
        self._tell(now_ns, EventKind.COMMAND, str(passed))
        self._applied = self._vehicle is not None and self._vehicle.pursue(passed, now_ns)
        return passed

    def poll(self, now_ns: int) -> bytes:
        """All bytes to send now. Call it from the working loop: it is what proves to the vehicle that we live."""
        if now_ns < self.due_ns(now_ns):
            return b""
        if self._codec.signing is not None:
            self._codec.signing.advance(self._signing_base + now_ns // TICK_NS)
        out, vehicle = self._heart.poll(now_ns), self._vehicle
        self._stirred, self._due_ns = False, None
        if vehicle is not None:
            orders = vehicle.poll(now_ns, self._launch)
            self._stirred = bool(orders)
            out += orders
            self._events.extend(vehicle.events)
            vehicle.events.clear()
            if vehicle.launch.phase is Phase.PILOT and not isinstance(self._pursued, Hold):
                self._pursued, self._applied = Hold(Refusal.PILOT.value), False
            self._watch_connection(vehicle.connected(now_ns), now_ns)
        return b"".join([self._encode(message, now_ns) for message in out]) if out else b""

    def due_ns(self, now_ns: int) -> int:
        """When `poll` has something to do next, unless something arrives or is commanded first; 0: at any time."""
        return 0 if self._stirred else self._next_due_ns(now_ns)

    def neighbors(self, positions: tuple[Place, ...]) -> None:
        """Where other robots are, or go to with the right of way: commands keep `min_separation_m` from them."""
        self._neighbors = positions

    def launch(self) -> None:
        """Arm and take off when possible, where `auto_launch` is off."""
        self._launch = self._stirred = True

    def return_home(self, now_ns: int) -> bool:
        """Let the vehicle return by its own mode; true once its heartbeat shows that, or it does not obey us anyway."""
        vehicle = self._vehicle
        if vehicle is None or vehicle.returning or not vehicle.ready(now_ns):
            return True
        home = Hold("returning to launch")
        if self._pursued != home and vehicle.return_home(now_ns):
            self._pursued, self._applied, self._stirred = home, True, True
            self._tell(now_ns, EventKind.COMMAND, home.reason)
        return False

    def enable(self, now_ns: int) -> None:
        """Command again after a pilot had control."""
        self._stirred = True
        if self._vehicle is not None:
            self._vehicle.enable(now_ns)

    def health(self, critical: bool) -> None:
        """Tell that the robot's own loop fails: the heartbeat says CRITICAL, and after `critical_s` falls silent."""
        self._stirred |= critical != self._heart.critical
        self._heart.critical = critical

    def memory(self) -> DriverMemory:
        """What the next process needs to go on, if this one is killed."""
        vehicle, signing = self._vehicle, self._codec.signing
        timestamp = signing.timestamp if signing is not None else 0
        if vehicle is None:
            return replace(self._memory, signing_timestamp=timestamp)
        pilot = vehicle.launch.phase is Phase.PILOT
        if not isinstance(self._pursued, Mission):
            return replace(self._memory, signing_timestamp=timestamp, pilot=pilot)
        on_board = vehicle.transfer.on_board or ""
        return DriverMemory(on_board, tuple(self._pursued.cells), self._start_cell, timestamp, pilot)

    def events(self) -> tuple[DriverEvent, ...]:
        """What happened since the last call."""
        if not self._events:
            return ()
        events = tuple(self._events)
        self._events.clear()
        return events

    def frames(self) -> tuple[FrameRecord, ...]:
        """Raw frames both ways since the last call; SETUP_SIGNING is never among them."""
        if not self._frames:
            return ()
        frames = tuple(self._frames)
        self._frames.clear()
        return frames

    @property
    def status(self) -> Status:
        """How the pursuit of the current command goes."""
        return self._vehicle.status if self._vehicle is not None else Status.IDLE

    @property
    def cannot_go(self) -> bool:
        """Whether the vehicle cannot go where it was last told to: that goal is another robot's."""
        return self._refused_goal or self.status.failed

    def ready(self, now_ns: int) -> bool:
        """Whether the vehicle obeys us: what `state` says of it, at less cost."""
        return self._vehicle is not None and self._vehicle.ready(now_ns)

    def state(self, now_ns: int) -> VehicleState:
        """What is known of the vehicle."""
        vehicle = self._vehicle
        if vehicle is None:
            phase = Phase.UNSUPPORTED if self._unsupported else Phase.SEARCHING
            return VehicleState(now_ns, phase=phase.value, details={"unsupported": self._unsupported or ""})
        counts = {"retasks": self._retasks, "bad_bytes": self._codec.bad_bytes}
        return vehicle.state(now_ns, self.cell(), counts)

    # --- inside ---

    def _look_at(self, frame: wire.Received, now_ns: int) -> None:
        """Find the autopilot: the first heartbeat on a link may be a ground station, a gimbal or another companion."""
        heartbeat = frame.message
        if not isinstance(heartbeat, wire.Heartbeat) or heartbeat.autopilot == dialect.AUTOPILOT_INVALID:
            return
        profile = choose(heartbeat.autopilot, heartbeat.type)
        if isinstance(profile, Unsupported):
            text: str | None = profile.text
        elif profile.kind is not self.config.kind:
            text = f"vehicle {self.config.sysid} is {profile.name}, configured as {self.config.kind.name}"
        elif self.config.targets == "setpoint" and profile.position_frame is None:
            text = f'vehicle {self.config.sysid} is {profile.name}, which needs targets = "reposition"'
        else:
            text = None
            self._vehicle = Vehicle(self.config, profile, frame.source, now_ns, self._memory)
            self._tell(now_ns, EventKind.PHASE, f"found {profile.name} at {frame.source}")
            if self._memory.pilot and heartbeat.armed:  # a restart of ours takes nothing from him
                self._vehicle.launch.fire(LaunchEvent.TAKEN, now_ns)
                self._tell(now_ns, EventKind.PILOT, "somebody else had control before the restart")
        if text is not None and text != self._unsupported:
            self._tell(now_ns, EventKind.UNSUPPORTED, text)
        self._unsupported = text

    def cell(self) -> Cell | None:
        """The cell of the grid in which the vehicle was last: what `state` says of it, at less cost."""
        here, size = self._position_m(), self.config.grid.cell_m
        cell = (math.floor(here[0] / size), math.floor(here[1] / size)) if here is not None else None
        return cell if cell is not None and inside_grid(self.config.grid, cell) else None

    def _position_m(self) -> Point | None:
        """The vehicle's latest position in metres along the grid's axes, worked out once."""
        lat_lon = self._vehicle.seen.lat_lon_deg if self._vehicle is not None else None
        if lat_lon is None:
            return None
        if self._here is None or self._here[0] != lat_lon:
            self._here = lat_lon, wgs84_to_grid_m(self.config.grid, *lat_lon)
        return self._here[1]

    def _known(self, now_ns: int) -> Known:
        vehicle = self._vehicle
        return Known(
            now_ns=now_ns,
            pilot=vehicle is not None and vehicle.launch.phase is Phase.PILOT,
            ready=self.ready(now_ns),
            home=vehicle is not None and vehicle.seen.home is not None,
            origin=vehicle is not None and vehicle.seen.has_origin(now_ns),
            position_m=self._position_m(),
            position_ns=vehicle.seen.position_ns if vehicle is not None else -1,
            pursued=self._pursued,
            retasked_ns=self._retasked_ns,
            neighbors=self._neighbors,
        )

    def _resumes(self, passed: VehicleCommand, now_ns: int) -> bool:
        """Whether the vehicle drives already what is wanted, as a process before this one told it; then watch that."""
        vehicle, before = self._vehicle, self._memory.pursued
        if before is None or vehicle is None or not vehicle.ready(now_ns) or not vehicle.driving:
            return False
        start = self._memory.start
        if passed != before and not self._is_rest(passed, before, start):
            return False
        self._pursued, self._start_cell, self._applied = before, start, True
        self._memory, self._stirred = NOTHING, True
        vehicle.resume(before, now_ns)
        self._tell(now_ns, EventKind.COMMAND, f"going on: {before}")
        return True

    def _unchanged(self, passed: VehicleCommand, now_ns: int) -> bool:
        """Whether nothing new has to be sent for `passed`."""
        if isinstance(passed, Hold):
            # one that could not be sent, because the link was down or the position old, must be sent once it can
            waits = not self._applied and self._vehicle is not None and self._vehicle.ready(now_ns)
            return isinstance(self._pursued, Hold) and not waits
        return not self._due_again(now_ns) and (
            passed == self._pursued or self._is_rest(passed, self._pursued, self._start_cell)
        )

    def _due_again(self, now_ns: int) -> bool:
        """Whether the command has been failing for so long that it is time for another try."""
        if not self.status.failed or self.status is Status.NOT_PROGRESSING:
            self._failed_ns = None
            return False
        if self._failed_ns is None:
            self._failed_ns = now_ns
        return now_ns - self._failed_ns >= self.config.failed_retry_s * NS_PER_S

    def _is_rest(self, passed: VehicleCommand, whole: VehicleCommand, start: Cell | None) -> bool:
        """Whether a mission is what remains of another: paths are planned anew from the robot's own cell."""
        here = self.cell()
        if not isinstance(passed, Mission) or not isinstance(whole, Mission) or start is None or here is None:
            return False
        return is_rest(passed.cells, whole.cells, start, here)

    def _next_due_ns(self, now_ns: int) -> int:
        if self._due_ns is None:
            due_ns = self._heart.due_ns if self._codec.signing is None else 0  # whose clock goes on at each poll
            self._due_ns = due_ns if self._vehicle is None else min(due_ns, self._vehicle.due_ns(now_ns))
        return self._due_ns

    def _watch_connection(self, connected: bool, now_ns: int) -> None:
        if connected != self._connected:
            self._connected = connected
            self._tell(now_ns, EventKind.CONNECTED if connected else EventKind.LOST, "heartbeat of the autopilot")

    def _encode(self, message: wire.Message, now_ns: int) -> bytes:
        frame = self._codec.encode(message)
        if self.config.log_frames:
            self._frames.append(FrameRecord(now_ns, True, strip_signature(frame)))
        return frame

    def _tell(self, now_ns: int, kind: EventKind, text: str) -> None:
        self._events.append(DriverEvent(now_ns, kind, text))
