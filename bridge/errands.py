"""Single things to do on board of a vehicle: read its mission, clear it, give its estimator an origin. Sans-IO.

What changes something is refused while the vehicle is armed: cleared in mid-drive, ArduRover drives its old leg on at
full speed, and an origin moves everything that counts from it.
"""

from __future__ import annotations

import random
from abc import ABC, abstractmethod
from enum import Enum

from gatar_edge.bridge import wire
from gatar_edge.bridge.dialect import Command, MessageId
from gatar_edge.bridge.mission_items import Items
from gatar_edge.bridge.mission_states import Result
from gatar_edge.bridge.mission_transfer import MissionClient
from gatar_edge.bridge.profiles import Profile
from gatar_edge.bridge.visit import Visit
from gatar_edge.bridge.wire import Address, CommandLong, GlobalOrigin, Message, Received
from gatar_edge.types import NS_PER_S

ASK_NS = NS_PER_S
TRIES = 8
ORIGIN_TOLERANCE_E7 = 2


class Errand(ABC):
    """`receive` and `poll` until `done`."""

    def __init__(self, sysid: int | None, now_ns: int) -> None:
        self.visit = Visit(sysid, now_ns)
        self._began = False

    def receive(self, data: bytes, now_ns: int) -> None:
        """Take bytes from the link."""
        for frame in self.visit.receive(data, now_ns):
            self._take(frame, now_ns)

    def poll(self, now_ns: int) -> bytes:
        """All bytes to send now."""
        out = self.visit.poll(now_ns)
        vehicle, profile = self.visit.vehicle, self.visit.profile
        if vehicle is not None and profile is not None:
            if not self._began:
                self._began = True
                self._begin(vehicle, profile, now_ns)
            out += self._go_on(vehicle, now_ns)
        return self.visit.encode(out)

    def done(self, now_ns: int) -> bool:
        """Whether it ended, well or not."""
        return self._began and self._ended()

    @property
    def armed(self) -> bool:
        """Whether the vehicle's motors may turn."""
        return self.visit.vehicle is not None and self.visit.heard[self.visit.vehicle].heartbeat.armed

    @abstractmethod
    def _begin(self, vehicle: Address, profile: Profile, now_ns: int) -> None: ...

    @abstractmethod
    def _go_on(self, vehicle: Address, now_ns: int) -> list[Message]: ...

    @abstractmethod
    def _take(self, frame: Received, now_ns: int) -> None: ...

    @abstractmethod
    def _ended(self) -> bool: ...


class MissionErrand(Errand):
    """Downloads the mission, or clears it. Then `result` says how that went, None where it came to nothing."""

    def __init__(self, sysid: int | None, now_ns: int, *, clear: bool = False, seed: int = 0) -> None:
        super().__init__(sysid, now_ns)
        self.refused = False  # it is armed
        self._clear, self._seed = clear, seed
        self._client: MissionClient | None = None

    @property
    def result(self) -> Result | None:
        """How the transfer ended."""
        return self._client.result if self._client is not None else None

    @property
    def items(self) -> Items:
        """What was downloaded."""
        return self._client.downloaded if self._client is not None else ()

    def _begin(self, vehicle: Address, profile: Profile, now_ns: int) -> None:
        self._client = MissionClient(profile, self.visit.me, vehicle, random.Random(self._seed))
        if self._clear:
            self._client.clear(now_ns)
        else:
            self._client.download(now_ns)

    def _go_on(self, vehicle: Address, now_ns: int) -> list[Message]:
        assert self._client is not None
        if self._clear and self.armed and self._client.result is None:
            self.refused = True
            self._client.abandon()
        return self._client.poll(now_ns)

    def _take(self, frame: Received, now_ns: int) -> None:
        if self._client is not None and frame.message is not None:
            self._client.receive(frame.source, frame.message, now_ns)

    def _ended(self) -> bool:
        return self.result is not None


class OriginOutcome(Enum):
    """How SET_GPS_GLOBAL_ORIGIN went."""

    SET = "set"
    KEPT = "it keeps another origin"
    NO_ANSWER = "no answer"
    ARMED = "refused: it is armed"


class OriginErrand(Errand):
    """Gives the estimator of a vehicle without GPS its origin, and waits until the vehicle tells it."""

    def __init__(self, sysid: int | None, now_ns: int, origin: GlobalOrigin) -> None:
        super().__init__(sysid, now_ns)
        self.told: GlobalOrigin | None = None
        self.outcome: OriginOutcome | None = None
        self._wanted = origin
        self._asked_ns, self._tries = now_ns - ASK_NS, 0

    def _begin(self, vehicle: Address, profile: Profile, now_ns: int) -> None:
        self._asked_ns = now_ns - ASK_NS

    def _go_on(self, vehicle: Address, now_ns: int) -> list[Message]:
        if self.outcome is not None or now_ns - self._asked_ns < ASK_NS:
            return []
        if self.armed:
            self.outcome = OriginOutcome.ARMED
            return []
        if self._tries >= TRIES:
            self.outcome = OriginOutcome.NO_ANSWER if self.told is None else OriginOutcome.KEPT
            return []
        self._asked_ns = now_ns
        self._tries += 1
        at = self._wanted
        ask = CommandLong(vehicle, Command.REQUEST_MESSAGE, (MessageId.GPS_GLOBAL_ORIGIN, 0, 0, 0, 0, 0, 0))
        return [wire.SetGlobalOrigin(vehicle[0], at.lat_e7, at.lon_e7, at.alt_amsl_mm), ask]

    def _take(self, frame: Received, now_ns: int) -> None:
        if not isinstance(frame.message, GlobalOrigin) or not self._tries or self.outcome is not None:
            return
        self.told = told = frame.message
        away = max(abs(told.lat_e7 - self._wanted.lat_e7), abs(told.lon_e7 - self._wanted.lon_e7))
        if away <= ORIGIN_TOLERANCE_E7:
            self.outcome = OriginOutcome.SET

    def _ended(self) -> bool:
        return self.outcome is not None
