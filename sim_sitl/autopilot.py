"""One simulated vehicle with its autopilot: MAVLink bytes in, MAVLink bytes out, driven by the time handed in."""

from __future__ import annotations

import math
from collections.abc import Callable

from gatar_edge.sim_sitl.ardupilot import ArduPilot
from gatar_edge.sim_sitl.autopilot_config import AutopilotConfig, Truth
from gatar_edge.sim_sitl.core import Core
from gatar_edge.sim_sitl.failsafe import GroundStationWatch
from gatar_edge.sim_sitl.mission_items import Item
from gatar_edge.sim_sitl.modes import Mode
from gatar_edge.sim_sitl.orders import Order, Result, acknowledge, order_from
from gatar_edge.sim_sitl.parameter_server import ParameterServer
from gatar_edge.sim_sitl.px4 import Px4
from gatar_edge.sim_sitl.stack import Stack
from gatar_edge.sim_sitl.telemetry import Telemetry
from gatar_edge.sim_sitl.vehicle import Blocked, Body
from gatar_edge.sim_sitl.wire import Message, Wire
from gatar_edge.types import NS_PER_S

__all__ = ["AutopilotConfig", "SimAutopilot", "Truth"]

_STEP_NS = 100_000_000
_HOME_SHARE = 0.45  # of the time until the EKF is ready, home is set: 19 of 42 s, as measured
_MAV_TYPE = {"copter": 2, "rover": 10}
_COMPONENTS = (0, 1)  # that a message may be addressed to
# What REQUEST_DATA_STREAM calls by one number; 0 is all.
_DATA_STREAMS = {0: (1, 24, 30, 33, 42, 74, 245), 2: (1, 24, 42), 6: (32, 33), 10: (30,), 11: (74,)}


def make_stack(config: AutopilotConfig) -> Stack:
    """The dialect of a vehicle."""
    return ArduPilot(config.vehicle == "copter") if config.stack == "ardupilot" else Px4()


class SimAutopilot:
    """A vehicle on one link, which several clients may share.

    `blocked(east_m, north_m)`, metres from home, tells a rover where it cannot go. Nothing that is received raises.
    """

    _heartbeat_ns: int

    def __init__(self, config: AutopilotConfig, now_ns: int, blocked: Blocked | None = None) -> None:
        self.config = config
        self._blocked = blocked
        self._wire = Wire(config.sysid, config.accepts_unsigned)
        self._boot(now_ns)

    @property
    def truth(self) -> Truth:
        """Where the vehicle really is and what it does."""
        return self._core.truth

    @property
    def place_m(self) -> tuple[float, float]:
        """Metres east and north of home: what `truth` holds of it, at less cost."""
        body = self._core.body
        return self._core.gps.really(body.east_m, body.north_m)

    @property
    def body(self) -> Body:
        """How it moves as it believes itself; another value only where that changed."""
        return self._core.body

    @property
    def modes(self) -> tuple[Mode, ...]:
        """All modes of its dialect."""
        return tuple(self._stack.modes.values())

    def suffer(self, what: Callable[[Core], None]) -> None:
        """Something happens to it that no message asked for."""
        what(self._core)

    @property
    def mission(self) -> tuple[Item, ...]:
        """What is really stored on board, slot 0 of ArduPilot as it was uploaded."""
        return tuple(self._core.server.items)

    @property
    def rejected_frames(self) -> int:
        """How much of what was received was no message."""
        return self._wire.rejected

    def receive(self, data: bytes, now_ns: int) -> None:
        """Take bytes of any client; the answers wait in take()."""
        self._core.now_ns = max(self._core.now_ns, now_ns)
        self._wire.pass_time(now_ns)
        for message in self._wire.parse(data):
            self._handle(message)
            self._announce_mode()

    def step(self, now_ns: int) -> None:
        """Bring the world and all timers to `now_ns`."""
        core = self._core
        while self._moved_ns < now_ns:
            dt_ns = min(_STEP_NS, now_ns - self._moved_ns) if core.is_armed else now_ns - self._moved_ns
            self._moved_ns += dt_ns
            core.move(self._moved_ns, dt_ns / NS_PER_S)
        core.now_ns = max(core.now_ns, now_ns)
        if not core.ready and not core.gps.lost:
            self._wake()
        core.server.step(now_ns)
        self._watch.step()
        self._stack.step(core)
        self._announce_mode()
        if now_ns >= self._heartbeat_ns:
            self._heartbeat_ns = max(self._heartbeat_ns + NS_PER_S, now_ns + 1)
            self._heartbeat()
        self._telemetry.step(now_ns)
        self._parameters.step()

    def take(self) -> bytes:
        """All that was sent since the last call, as MAVLink 2 frames."""
        return b"".join(self.take_frames())

    def take_frames(self) -> list[bytes]:
        """`take`, frame by frame."""
        sends = self._core.outbox
        if not sends:
            return []
        self._core.outbox = []
        self._wire.pass_time(self._core.now_ns)
        return [self._wire.pack(send) for send in sends]

    def reboot(self, now_ns: int) -> None:
        """Power off and on: parameters and mission stay, everything else starts anew."""
        old = self._core
        old.disarm()  # a copter in the air falls
        self._boot(now_ns)
        self._wire.restart(now_ns)
        core = self._core
        core.params, core.server.items, core.body = old.params, old.server.items, old.body
        for index in range(len(core.params)):
            self._stack.parameter_changed(core, core.params.name_of(index) or "")

    def _boot(self, now_ns: int) -> None:
        self._stack = make_stack(self.config)
        self._core = Core(self.config, self._stack, now_ns, self._blocked)
        self._telemetry = Telemetry(self._core, self._stack.streams)
        self._watch = GroundStationWatch(self._core)
        self._moved_ns = now_ns
        self._heartbeat_ns = now_ns
        self._announced = self._core.mode.number
        self._parameters = ParameterServer(self._core, self._stack)
        self._stack.booted(self._core)
        self._wake()

    def _wake(self) -> None:
        core = self._core
        up_s = (core.now_ns - core.boot_ns) / NS_PER_S
        if not core.home_set and up_s >= _HOME_SHARE * self.config.ekf_ready_s:
            core.set_home(core.home)
            self._stack.home_found(core)
        if up_s >= self.config.ekf_ready_s:
            core.ready = True
            self._stack.became_ready(core)

    # What it hears

    def _handle(self, message: Message) -> None:
        core, name = self._core, message.get_type()
        source = message.get_srcSystem()
        if core.params.get("SYSID_ENFORCE") and source != core.params["SYSID_MYGCS"]:
            return
        if getattr(message, "target_system", 0) not in (0, self.config.sysid):
            return
        if getattr(message, "target_component", 0) not in _COMPONENTS:
            return
        if name == "HEARTBEAT":
            self._watch.heartbeat(source, message.type)
        elif name in ("COMMAND_LONG", "COMMAND_INT"):
            self._obey(order_from(message))
        elif name.startswith("MISSION_"):
            core.server.receive(message, core.now_ns)
        elif name in _HANDLERS:
            _HANDLERS[name](self, message)
        else:
            self._stack.receive(core, message)

    def _obey(self, order: Order) -> None:
        core = self._core
        mark = len(core.outbox)
        stream_command = _STREAM_COMMANDS.get(order.command)
        handler = self._stack.commands.get(order.command)
        if stream_command is not None:
            result = stream_command(self, order)
        elif handler is not None:
            result = handler(core, order)
        else:
            result = Result.UNSUPPORTED
        # The acknowledgement leaves before what the command caused, as on the real ones.
        caused = core.outbox[mark:]
        del core.outbox[mark:]
        acknowledge(core, order, result)
        core.outbox += caused
        if order.command == _REBOOT and result is Result.ACCEPTED:
            self.reboot(core.now_ns)
            self._core.outbox[:0] = core.outbox

    def _set_interval(self, order: Order) -> Result:
        message_id = order.params[0]
        if not math.isfinite(message_id) or not self._telemetry.set_interval(int(message_id), order.params[1]):
            return Result.FAILED
        return Result.ACCEPTED

    def _get_interval(self, order: Order) -> Result:
        message_id = order.params[0]
        if not math.isfinite(message_id) or not self._telemetry.knows(int(message_id)):
            return Result.FAILED
        interval = self._telemetry.interval_us(int(message_id))
        self._core.emit("MESSAGE_INTERVAL", message_id=int(message_id), interval_us=interval)
        return Result.ACCEPTED

    def _request_message(self, order: Order) -> Result:
        message_id = order.params[0]
        if not math.isfinite(message_id) or not self._telemetry.knows(int(message_id)):
            return Result.FAILED
        return Result.ACCEPTED if self._telemetry.send(int(message_id)) else Result.FAILED

    def _request_version(self, order: Order) -> Result:
        return Result.ACCEPTED if self._telemetry.send(148) else Result.FAILED

    def _may_reboot(self, order: Order) -> Result:
        return Result.DENIED if self._core.is_armed or order.params[0] != 1 else Result.ACCEPTED

    def _set_up_signing(self, message: Message) -> None:
        if self.config.stack != "ardupilot":
            return
        if self._core.is_armed:
            self._core.text(4, "ERROR: Won't setup signing when armed")
        else:
            self._wire.sign(bytes(message.secret_key), message.initial_timestamp, self._core.now_ns)

    def _time_sync(self, message: Message) -> None:
        if message.tc1 == 0:
            self._core.emit("TIMESYNC", tc1=self._core.now_ns, ts1=message.ts1)

    def _ping(self, message: Message) -> None:
        if message.target_system == 0 and message.target_component == 0:
            self._core.emit(
                "PING",
                time_usec=message.time_usec, seq=message.seq,
                target_system=message.get_srcSystem(), target_component=message.get_srcComponent(),
            )  # fmt: skip

    def _data_stream(self, message: Message) -> None:
        rate = message.req_message_rate if message.start_stop else 0
        for message_id in _DATA_STREAMS.get(message.req_stream_id, ()):
            self._telemetry.set_interval(message_id, 1e6 / rate if rate > 0 else -1)

    # What it says

    def _heartbeat(self) -> None:
        core = self._core
        core.emit(
            "HEARTBEAT",
            type=_MAV_TYPE[self.config.vehicle], autopilot=self._stack.autopilot_id,
            base_mode=core.mode.base_mode | (128 if core.is_armed else 0), custom_mode=core.mode.number,
            system_status=self._stack.status(core), mavlink_version=3,
        )  # fmt: skip

    def _announce_mode(self) -> None:
        number = self._core.mode.number
        if number != self._announced:
            self._announced = number
            if self._stack.announces_mode:
                self._heartbeat()


_REBOOT = 246
_A = SimAutopilot
_STREAM_COMMANDS: dict[int, Callable[[SimAutopilot, Order], Result]] = {
    _REBOOT: _A._may_reboot,
    510: _A._get_interval,
    511: _A._set_interval,
    512: _A._request_message,
    520: _A._request_version,
}
_HANDLERS: dict[str, Callable[[SimAutopilot, Message], None]] = {
    "PARAM_REQUEST_LIST": lambda autopilot, message: autopilot._parameters.list_all(),
    "PARAM_REQUEST_READ": lambda autopilot, message: autopilot._parameters.read(message),
    "PARAM_SET": lambda autopilot, message: autopilot._parameters.set(message),
    "PING": _A._ping,
    "REQUEST_DATA_STREAM": _A._data_stream,
    "SETUP_SIGNING": _A._set_up_signing,
    "TIMESYNC": _A._time_sync,
}
