"""Collects what `doctor` judges: asks one vehicle for messages and parameters, and counts what comes. Sans-IO.

Nothing here arms, moves or sets anything: what is sent are requests for messages, parameters and the vehicle's clock.
The message intervals are those that the driver asks for too, so a running daemon is not disturbed.
"""

from __future__ import annotations

import random
from collections.abc import Mapping
from dataclasses import dataclass

from gatar_edge.bridge import wire
from gatar_edge.bridge.companion_loss import loss_parameters
from gatar_edge.bridge.dialect import Command, MessageId
from gatar_edge.bridge.own_fence import fence_parameters
from gatar_edge.bridge.parameters import ParameterReader
from gatar_edge.bridge.profiles import Profile
from gatar_edge.bridge.rates import WANTED_HZ
from gatar_edge.bridge.settings import DriverConfig
from gatar_edge.bridge.telemetry import Telemetry
from gatar_edge.bridge.visit import Heard, Visit
from gatar_edge.bridge.wire import Address, CommandLong, Message, Received
from gatar_edge.types import NS_PER_S

ASK_NS = NS_PER_S
TRIES = 8
ONCE = (
    MessageId.AUTOPILOT_VERSION,
    MessageId.HOME_POSITION,
    MessageId.GPS_GLOBAL_ORIGIN,
    MessageId.GPS_RAW_INT,
    MessageId.SYSTEM_TIME,
)
SETTLE_NS = 1_500_000_000  # the intervals are asked for twice, then this long after the first time counting begins
COUNT_NS = 6 * NS_PER_S
SYNC_NS = NS_PER_S // 2
SYNCS = 16
NONCE_BITS = 16


@dataclass(frozen=True, slots=True)
class Facts:
    """All that was collected until `now_ns`; what was not heard is None or absent."""

    now_ns: int
    plan: DriverConfig | None  # what the daemon would do, where its configuration is given
    shared_link: bool  # others can reach it too: a network rather than a cable
    heard: Mapping[Address, Heard]
    vehicle: Address | None
    profile: Profile | None
    unsupported: str
    seen: Telemetry
    gps: wire.GpsRaw | None
    version: wire.AutopilotVersion | None
    parameters: Mapping[str, float]
    parameters_asked: int
    rates_hz: Mapping[int, float]  # measured
    counted_s: float  # for how long
    round_trips_ns: tuple[int, ...]
    clock_skew_s: float | None  # the vehicle's time of day less ours
    signed: int  # frames of the vehicle
    unsigned: int

    @property
    def answered(self) -> bool:
        """Whether the vehicle has answered anything that was asked."""
        return bool(self.version or self.parameters or self.round_trips_ns)


class Survey:
    """`receive` and `poll` until `done` or out of time; then `facts`."""

    def __init__(
        self, sysid: int | None, now_ns: int, *, plan: DriverConfig | None = None, shared_link: bool, seed: int
    ) -> None:
        """`seed` makes the nonces: answers to other askers' TIMESYNC must not look like ours."""
        self.visit = Visit(sysid, now_ns)
        self.seen = Telemetry()
        self._plan, self._shared_link = plan, shared_link
        self._random = random.Random(seed)
        self._found_ns = 0
        self._reader: ParameterReader | None = None
        self._asked: dict[int, int] = {}  # message id -> how often
        self._asked_ns = self._synced_ns = now_ns - ASK_NS
        self._counts = dict.fromkeys(WANTED_HZ, 0)
        self._syncs: dict[int, int] = {}  # ts1 -> when it was sent
        self._sync_count = 0
        self._round_trips: list[int] = []
        self._once: dict[int, Message] = {}
        self._skew_s: float | None = None
        self._signed = self._unsigned = 0
        self._names = 0

    def receive(self, data: bytes, now_ns: int) -> None:
        """Take bytes from the link."""
        for frame in self.visit.receive(data, now_ns):
            self._take(frame, now_ns)

    def poll(self, now_ns: int) -> bytes:
        """All bytes to send now."""
        out = self.visit.poll(now_ns)
        vehicle, profile = self.visit.vehicle, self.visit.profile
        if vehicle is not None and profile is not None:
            if self._reader is None:
                self._found_ns = now_ns
                ends = (*(profile.mission_end or ())[:1], *filter(None, (profile.guided_radius,)))
                names = dict.fromkeys((*loss_parameters(profile), *fence_parameters(profile), *ends))
                self._names = len(names)
                self._reader = ParameterReader(vehicle, names, profile.bytewise_parameters)
            out += [*self._ask(vehicle, now_ns), *self._reader.poll(now_ns), *self._sync(now_ns)]
        return self.visit.encode(out)

    def done(self, now_ns: int) -> bool:
        """Whether waiting longer would tell nothing more."""
        return (
            self._reader is not None
            and self._reader.done
            and now_ns - self._found_ns >= SETTLE_NS + COUNT_NS
            and not self._open()
        )

    def facts(self, now_ns: int) -> Facts:
        """What is known now."""
        visit, counted_s = self.visit, max(0.0, (now_ns - self._found_ns - SETTLE_NS) / NS_PER_S)
        counting = self._reader is not None and counted_s > 0
        gps, version = self._once.get(MessageId.GPS_RAW_INT), self._once.get(MessageId.AUTOPILOT_VERSION)
        return Facts(
            now_ns=now_ns,
            plan=self._plan,
            shared_link=self._shared_link,
            heard=visit.heard,
            vehicle=visit.vehicle,
            profile=visit.profile,
            unsupported=visit.unsupported,
            seen=self.seen,
            gps=gps if isinstance(gps, wire.GpsRaw) else None,
            version=version if isinstance(version, wire.AutopilotVersion) else None,
            parameters=self._reader.values if self._reader is not None else {},
            parameters_asked=self._names,
            rates_hz={i: n / counted_s for i, n in self._counts.items()} if counting else {},
            counted_s=counted_s if counting else 0.0,
            round_trips_ns=tuple(self._round_trips),
            clock_skew_s=self._skew_s,
            signed=self._signed,
            unsigned=self._unsigned,
        )

    def _open(self) -> list[int]:
        """Messages asked for once that neither came nor were given up."""
        return [i for i in ONCE if i not in self._once and self._asked.get(i, 0) < TRIES]

    def _ask(self, vehicle: Address, now_ns: int) -> list[Message]:
        if now_ns - self._asked_ns < ASK_NS:
            return []
        self._asked_ns = now_ns
        out: list[Message] = []
        for message_id in self._open():
            self._asked[message_id] = self._asked.get(message_id, 0) + 1
            out.append(_long(vehicle, Command.REQUEST_MESSAGE, message_id, 0.0))
        if now_ns - self._found_ns < SETTLE_NS:
            out += [_long(vehicle, Command.SET_MESSAGE_INTERVAL, i, 1e6 / hz) for i, hz in WANTED_HZ.items()]
        return out

    def _sync(self, now_ns: int) -> list[Message]:
        if now_ns - self._synced_ns < SYNC_NS or self._sync_count >= SYNCS:
            return []
        self._synced_ns = now_ns
        self._sync_count += 1
        ts1 = now_ns >> NONCE_BITS << NONCE_BITS | self._random.getrandbits(NONCE_BITS)
        self._syncs[ts1] = now_ns
        return [wire.TimeSync(0, ts1)]

    def _take(self, frame: Received, now_ns: int) -> None:
        self._signed += frame.signed
        self._unsigned += not frame.signed
        if frame.message_id in self._counts and self._reader is not None and now_ns - self._found_ns >= SETTLE_NS:
            self._counts[frame.message_id] += 1
        message = frame.message
        if message is None:
            return
        self.seen.update(message, now_ns)
        if frame.message_id in ONCE:
            self._once[frame.message_id] = message
        if isinstance(message, wire.ParamValue) and self._reader is not None:
            self._reader.receive(message)
        elif isinstance(message, wire.TimeSync) and message.tc1 > 0 and message.ts1 in self._syncs:
            self._round_trips.append(now_ns - self._syncs.pop(message.ts1))
        elif isinstance(message, wire.SystemTime) and message.unix_us > 0:
            self._skew_s = message.unix_us / 1e6 - now_ns / NS_PER_S


def _long(to: Address, command: int, p1: float, p2: float) -> CommandLong:
    return CommandLong(to, command, (p1, p2, 0.0, 0.0, 0.0, 0.0, 0.0))
