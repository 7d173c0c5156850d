"""A guest on a vehicle's link: finds its autopilot, asks, and goes. For tools; the daemon has its driver. Sans-IO.

Rule 1: no heartbeat is sent. ArduPilot's failsafe begins to watch a companion with its first heartbeat, and would act
  when the guest goes. Rule 2: the guest is a component of the vehicle that is not the companion's, so that neither is
  taken for the other. Rule 3: on a link of several vehicles it chooses none by itself.
"""

from __future__ import annotations

from dataclasses import dataclass

from gatar_edge.bridge import dialect, wire
from gatar_edge.bridge.codec import Codec
from gatar_edge.bridge.profiles import Profile, Unsupported, choose
from gatar_edge.bridge.wire import Address, Heartbeat, Message, Received
from gatar_edge.types import NS_PER_S

COMPID = 192  # MAV_COMP_ID_ONBOARD_COMPUTER2
STRANGER_SYSID = 254  # while the vehicle's is not known; 255 would pass for the human's ground station
LISTEN_NS = 2 * NS_PER_S  # for other vehicles on the link, before the only one is chosen
KNOCK_NS = NS_PER_S
MAX_HEARD = 64


@dataclass(slots=True)
class Heard:
    """Who sends heartbeats, and since when."""

    heartbeat: Heartbeat
    first_ns: int
    last_ns: int
    count: int = 1


class Visit:
    """`receive` what came, send what `poll` gives; `vehicle` and `profile` are there once it is found."""

    def __init__(self, sysid: int | None, now_ns: int) -> None:
        """`sysid`: of the vehicle; None: of the only one that is heard."""
        self.sysid = sysid
        self.heard: dict[Address, Heard] = {}
        self.vehicle: Address | None = None
        self.profile: Profile | None = None
        self.unsupported = ""
        self.bytes_heard = 0
        self._codec = Codec(sysid or STRANGER_SYSID, COMPID)
        self._knocked_ns = now_ns - KNOCK_NS
        self._first_ns: int | None = None

    @property
    def me(self) -> Address:
        """Under which address the guest speaks."""
        return self._codec.address

    @property
    def autopilots(self) -> tuple[int, ...]:
        """The system ids of all autopilots that are heard, whether there is a profile for them or not."""
        return tuple(sorted({a[0] for a, heard in self.heard.items() if _is_autopilot(heard.heartbeat)}))

    def undecided(self, now_ns: int) -> bool:
        """Whether there are several vehicles and none was told to be the one: no waiting helps."""
        listened = self._first_ns is not None and now_ns - self._first_ns >= LISTEN_NS
        return listened and self.sysid is None and self.vehicle is None and len(self.autopilots) > 1

    def receive(self, data: bytes, now_ns: int) -> list[Received]:
        """Take bytes; the frames of the vehicle among them."""
        self.bytes_heard += len(data)
        frames = self._codec.parse(data)
        for frame in frames:
            if isinstance(frame.message, Heartbeat):
                self._note(frame.source, frame.message, now_ns)
        if self.vehicle is None:
            self._choose(now_ns)
        return [frame for frame in frames if frame.source == self.vehicle]

    def poll(self, now_ns: int) -> list[Message]:
        """Knock until the vehicle is found: some links speak only to those who spoke to them."""
        if self.vehicle is None:
            self._choose(now_ns)
        if self.vehicle is not None or now_ns - self._knocked_ns < KNOCK_NS:
            return []
        self._knocked_ns = now_ns
        return [wire.TimeSync(0, now_ns)]

    def encode(self, messages: list[Message]) -> bytes:
        """Bytes of messages."""
        return b"".join(map(self._codec.encode, messages))

    def _note(self, source: Address, heartbeat: Heartbeat, now_ns: int) -> None:
        if self._first_ns is None:
            self._first_ns = now_ns
        known = self.heard.get(source)
        if known is not None:
            known.heartbeat, known.last_ns = heartbeat, now_ns
            known.count += 1
        elif len(self.heard) < MAX_HEARD:
            self.heard[source] = Heard(heartbeat, now_ns, now_ns)

    def _choose(self, now_ns: int) -> None:
        systems = self.autopilots
        if self.sysid is None and (len(systems) != 1 or self._first_ns is None or now_ns - self._first_ns < LISTEN_NS):
            return
        wanted = self.sysid if self.sysid is not None else systems[0]
        for address, heard in self.heard.items():
            if address[0] != wanted or not _is_autopilot(heard.heartbeat):
                continue
            profile = choose(heard.heartbeat.autopilot, heard.heartbeat.type)
            if isinstance(profile, Unsupported):
                self.unsupported = profile.text
                continue
            self.vehicle, self.profile, self.unsupported = address, profile, ""
            self._codec = Codec(wanted, COMPID)
            return


def _is_autopilot(heartbeat: Heartbeat) -> bool:
    others = (dialect.TYPE_GCS, dialect.TYPE_ONBOARD_CONTROLLER)
    return heartbeat.autopilot != dialect.AUTOPILOT_INVALID and heartbeat.type not in others
