"""One found autopilot: all state machines that talk to it, composed. Speaks `wire` messages; knows no bytes."""

from __future__ import annotations

import math
import random

from gatar_edge.bridge import wire
from gatar_edge.bridge.commands import CommandClient
from gatar_edge.bridge.dialect import Command
from gatar_edge.bridge.guided import Guided
from gatar_edge.bridge.launch import Event, Launch, Phase
from gatar_edge.bridge.memory import mission_points, remembered_items
from gatar_edge.bridge.mission_transfer import MissionClient
from gatar_edge.bridge.modes import ModeKeeper
from gatar_edge.bridge.order import Order
from gatar_edge.bridge.profiles.base import HoldBy, Profile
from gatar_edge.bridge.rates import RateWatch
from gatar_edge.bridge.retask import Retask
from gatar_edge.bridge.settings import DriverConfig
from gatar_edge.bridge.status import DriverEvent, EventKind, Status
from gatar_edge.bridge.telemetry import Telemetry
from gatar_edge.bridge.wire import Address, Message
from gatar_edge.driver_memory import DriverMemory
from gatar_edge.types import NS_PER_S, Cell, Goto, Hold, Mission, RobotKind, VehicleState

SILENT_NS = 3 * NS_PER_S  # nothing at all
HEARTBEAT_LOST_NS = 6 * NS_PER_S  # three lost ones in a row are no rarity on a bad link
CURRENT_PATIENCE_NS = 2 * NS_PER_S  # for a vehicle to tell of its mission after a restart of ours
WORST_LOGGED_SEVERITY = 4  # MAV_SEVERITY_WARNING
# these answer one by one and are matched by what they say; all others tell a state, of which only the newest counts
TRANSFERS = frozenset((wire.MissionRequest, wire.MissionAck, wire.MissionCount, wire.MissionItemAt))
# what no state machine waits for: only the counts, `ready` and the report of the vehicle's state read them
BYSTANDERS = frozenset((wire.SysStatus, wire.SystemTime, wire.GpsRaw, wire.ExtendedSysState))


class Vehicle:
    """One autopilot and what we want of it."""

    def __init__(
        self, config: DriverConfig, profile: Profile, address: Address, now_ns: int, memory: DriverMemory
    ) -> None:
        """`memory`: of the process before this one, which the vehicle may still be obeying."""
        me = (config.sysid, config.compid)
        self.config, self.profile, self.address = config, profile, address
        self.seen = Telemetry()
        self.events: list[DriverEvent] = []
        self.commands = CommandClient(me, address)
        self.modes = ModeKeeper(profile, self.commands)
        self.transfer = MissionClient(profile, me, address, random.Random(config.seed))
        self.launch = Launch(profile, self.commands, self.modes, config.altitude_m)
        arrive_m = config.arrive_m if config.arrive_m is not None else min(2.0, config.grid.cell_m / 4)
        self.guided = Guided(
            profile,
            self.commands,
            self.modes,
            arrive_m=arrive_m,
            near_m=config.grid.cell_m / 2,  # within the cell that was meant
            progress_s=config.progress_s,
            setpoints=config.targets == "setpoint",
        )
        self.retask = Retask(
            profile,
            self.commands,
            self.modes,
            self.transfer,
            arrive_m=arrive_m,
            near_m=config.grid.cell_m,
            progress_s=config.progress_s,
            speed_m_s=config.speed_m_s,
        )
        if config.speed_m_s is not None:
            self.guided.speed(config.speed_m_s)
        self._rates = RateWatch(address, now_ns)
        self._by_mission = config.kind is RobotKind.UGV and config.drive == "mission"
        self._holding = False
        self._heard_ns = self._found_ns = now_ns
        self._remembered = remembered_items(memory, config.grid, profile) if self._by_mission else ()
        self._order = Order()
        self._latest: dict[int, int] = {}  # message id -> the number of its latest frame
        self._told = (self.launch.phase, Status.IDLE)

    @property
    def status(self) -> Status:
        """How the pursuit of the current command goes."""
        if self._holding and self.profile.hold_by is HoldBy.MODE:
            return Status.HOLDING
        return self.retask.status if self._by_mission else self.guided.status

    def connected(self, now_ns: int) -> bool:
        """Whether it is heard, and tells its mode."""
        return now_ns - self._heard_ns <= SILENT_NS and now_ns - self.seen.heartbeat_ns <= HEARTBEAT_LOST_NS

    def ready(self, now_ns: int) -> bool:
        """Whether it obeys us."""
        return (
            self.connected(now_ns)
            and self.launch.phase is Phase.READY
            and self.seen.armed
            and self.launch.airborne(self.seen)
        )

    def state(self, now_ns: int, cell: Cell | None, counts: dict[str, int]) -> VehicleState:
        """What is known of it; the driver knows its `cell` and `counts` what it sent and received."""
        seen, position, result = self.seen, self.seen.position, self.transfer.result
        lat_lon = seen.lat_lon_deg or (math.nan, math.nan)
        return VehicleState(
            t_ns=now_ns,
            connected=self.connected(now_ns),
            armed=seen.armed,
            ready=self.ready(now_ns),
            mode="" if seen.custom_mode is None else self.profile.mode_name(seen.custom_mode),
            lat_deg=lat_lon[0],
            lon_deg=lat_lon[1],
            alt_rel_m=seen.alt_rel_m,
            speed_m_s=math.hypot(position.north_cm_s, position.east_cm_s) / 100 if position else 0.0,
            heading_deg=position.heading_cdeg / 100 if position and position.heading_cdeg != 65535 else 0.0,
            battery_percent=seen.battery_percent,
            position_t_ns=seen.position_ns,
            cell=cell,
            phase=self.launch.phase.value,
            details={
                "profile": self.profile.name,
                "status": self.status.value,
                "transfer": result.name if result is not None else self.transfer.step.name,
                **counts,
            },
        )

    def receive(self, frame: wire.Received, now_ns: int) -> bool:
        """Take one frame of this autopilot; whether `poll` may have something to do for it."""
        self._heard_ns = now_ns
        self._rates.count(frame.message_id)
        message, number = frame.message, self._order.number(frame.seq, now_ns)
        if message is None:
            return False
        if (kind := type(message)) in TRANSFERS:
            self.transfer.receive(frame.source, message, now_ns)
        elif type(message) is wire.CommandAck:
            self.commands.receive(message)
        elif self._overtaken(frame.message_id, number):
            return False
        else:
            self.seen.update(message, now_ns)
            if type(message) is wire.Heartbeat:
                self._watch_mode(message, now_ns)
            elif type(message) is wire.MissionCurrent:
                self.transfer.receive(frame.source, message, now_ns)
            elif type(message) is wire.StatusText and message.severity <= WORST_LOGGED_SEVERITY:
                self._tell(now_ns, EventKind.STATUSTEXT, message.text)
        return self._is_waited_for(kind)

    def _is_waited_for(self, kind: type[Message]) -> bool:
        """Whether a message of this kind may give `poll` something to do before `due_ns`."""
        if kind is wire.GlobalPosition:
            return self.guided.watches or self.retask.watches or self.launch.watches
        if kind is wire.PositionTarget:
            return self.guided.listens
        if kind is wire.MissionCurrent:
            return self.retask.watches or self.launch.watches
        return kind not in BYSTANDERS

    def pursue(self, command: Goto | Mission | Hold, now_ns: int) -> bool:
        """Make the vehicle do this from now on. False: nothing was sent, to one that does not obey us."""
        if not self.ready(now_ns):
            return False
        self._holding = isinstance(command, Hold)
        if isinstance(command, Hold):
            return self._hold(now_ns)
        points = mission_points(self.config.grid, (command.cell,) if isinstance(command, Goto) else command.cells)
        if self._by_mission:
            self.retask.drive(points, now_ns)
        else:
            self.guided.go(points, self._altitude_m(), self._home_amsl_m(), now_ns)
        return True

    def resume(self, mission: Mission, now_ns: int) -> None:
        """Go on with the remembered mission, which the vehicle is `driving`."""
        self._holding, self._remembered = False, ()
        self.retask.resume(mission_points(self.config.grid, mission.cells), now_ns)

    @property
    def driving(self) -> bool:
        """Whether it seems to be driving the mission that is remembered from before a restart."""
        if not self._remembered:
            return False
        seen, count = self.seen, len(self._remembered) - self.profile.first_item_seq
        return (
            seen.armed
            and seen.custom_mode == self.profile.mission_mode
            and seen.current is not None
            and seen.current.may_be(count)
        )

    def return_home(self, now_ns: int) -> bool:
        """Let it return to where it was launched, by its own mode. False: nothing is sent to one that does not obey."""
        if not self.ready(now_ns):
            return False
        self.retask.stop()
        self.guided.stop()
        self.modes.want(self.profile.return_mode)
        return True

    @property
    def returning(self) -> bool:
        """Whether it is in the mode that brings it back."""
        return self.seen.custom_mode == self.profile.return_mode

    def enable(self, now_ns: int) -> None:
        """Command again after the pilot had control."""
        self.modes.release()
        self.launch.fire(Event.ENABLED, now_ns)

    def poll(self, now_ns: int, launch: bool) -> list[Message]:
        """Run everything and hand over what is to be sent now."""
        out, short = self._rates.poll(self.seen.unknown, now_ns)
        if short:
            self._tell(now_ns, EventKind.RATES, f"asked again for message intervals of {short}")
        if launch and not self._waits_for_current(now_ns):
            self.launch.driving = self.driving
            self.launch.poll(self.seen, now_ns)
        targets = self.guided.poll(self.seen, now_ns)
        retask = self.retask.poll(self.seen, now_ns)
        self.modes.poll(now_ns)
        commands = [*targets, *retask, *self.transfer.poll(now_ns), *self.commands.poll(now_ns)]
        self._tell_changes(now_ns)
        # the pilot wins: then we ask for telemetry and for nothing else
        return out if self.launch.phase is Phase.PILOT else out + commands

    def due_ns(self, now_ns: int) -> int:
        """When `poll` has something to do again, unless something arrives or is commanded first."""
        driving_ns = min(self.guided.due_ns, self.retask.due_ns, self.commands.due_ns)
        if driving_ns <= now_ns or self._waits_for_current(now_ns):
            return 0
        silent_ns = min(self._heard_ns + SILENT_NS, self.seen.heartbeat_ns + HEARTBEAT_LOST_NS) + 1
        return min(
            driving_ns,
            self.launch.due_ns,
            self.modes.due_ns,
            self.transfer.due_ns,
            self._rates.due_ns(self.seen.unknown),
            silent_ns if self.connected(now_ns) else driving_ns,
        )

    def _waits_for_current(self, now_ns: int) -> bool:
        """Whether it may be driving the remembered mission, and has not told yet."""
        waits = bool(self._remembered) and self.seen.current is None
        return waits and now_ns - self._found_ns < CURRENT_PATIENCE_NS

    def _overtaken(self, message_id: int, number: int) -> bool:
        """Whether a newer message of the kind came first: an old heartbeat must not look like the pilot's doing."""
        if number < self._latest.get(message_id, number):
            return True
        self._latest[message_id] = number
        return False

    def _hold(self, now_ns: int) -> bool:
        self.retask.stop()
        here = self.seen.lat_lon_deg
        if self.profile.hold_by is HoldBy.MODE:
            self.guided.stop()
            self.modes.want(self.profile.hold_mode)
            return True
        if here is not None and now_ns - self.seen.position_ns <= self.config.position_max_age_s * NS_PER_S:
            self.guided.go((here,), self._altitude_m(), self._home_amsl_m(), now_ns, hold=True)
            return True
        return False  # with an old position a copter goes on to its last target, where it holds by itself

    def _altitude_m(self) -> float:
        return self.config.altitude_m if self.config.kind is RobotKind.UAV else 0.0

    def _home_amsl_m(self) -> float:
        return self.seen.home.alt_amsl_mm / 1e3 if self.seen.home else 0.0

    def _watch_mode(self, heartbeat: wire.Heartbeat, now_ns: int) -> None:
        taken = self.modes.observe(heartbeat.custom_mode, now_ns, self.retask.at_end(self.seen))
        if taken:
            self._give_way(now_ns, f"mode changed to {self.profile.mode_name(heartbeat.custom_mode)} by somebody else")
        elif self.launch.phase is Phase.READY and not heartbeat.armed:
            self._give_way(now_ns, "disarmed by somebody else")

    def _give_way(self, now_ns: int, text: str) -> None:
        self.launch.fire(Event.TAKEN, now_ns)
        self.retask.stop()
        self.guided.stop()
        self.commands.clear()
        self.transfer.abandon()
        self._tell(now_ns, EventKind.PILOT, text)

    def _tell(self, now_ns: int, kind: EventKind, text: str) -> None:
        self.events.append(DriverEvent(now_ns, kind, text))

    def _tell_changes(self, now_ns: int) -> None:
        told_phase, told_status = self._told
        phase, status = self.launch.phase, self.status
        if phase is told_phase and status is told_status:
            return
        self._told = (phase, status)
        if phase is not told_phase:
            self._tell(now_ns, EventKind.PHASE, phase.value)
        if status is not told_status:
            self._tell(now_ns, EventKind.STATUS, status.value + self._why())

    def _why(self) -> str:
        if self.status is Status.UPLOAD_FAILED and self.transfer.result is not None:
            return f": {self.transfer.result.value}"
        result = self.commands.result(Command.DO_REPOSITION)
        return f": {result.name}" if self.status is Status.REFUSED and result is not None else ""
