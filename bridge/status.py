"""What the bridge tells the rest of the robot: how the pursuit of a command goes, and what happened on the way."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import msgspec


class Status(StrEnum):
    """How the pursuit of the current command goes. The failures are the allocator's to act on: give the target back."""

    IDLE = "idle"  # nothing commanded yet
    STARTING = "starting"  # on its way to the vehicle, not yet confirmed
    PURSUING = "pursuing"  # confirmed by the vehicle, and getting nearer
    ARRIVED = "arrived"
    HOLDING = "holding"
    NOT_PROGRESSING = "not_progressing"  # confirmed, yet not getting nearer
    STALE_TARGET = "stale_target"  # the vehicle goes somewhere else, or does not start
    REFUSED_FENCE = "refused_fence"  # the vehicle's own fence
    REFUSED = "refused"  # for another reason, told in the event
    UPLOAD_FAILED = "upload_failed"

    @property
    def failed(self) -> bool:
        """Whether the command needs another try or another robot."""
        return self in _FAILED


_FAILED = frozenset(
    {Status.NOT_PROGRESSING, Status.STALE_TARGET, Status.REFUSED_FENCE, Status.REFUSED, Status.UPLOAD_FAILED}
)


class EventKind(StrEnum):
    """What a `DriverEvent` tells of."""

    CONNECTED = "connected"
    LOST = "lost"
    UNSUPPORTED = "unsupported"
    PHASE = "phase"
    COMMAND = "command"  # another command is pursued
    GATE = "gate"  # the gate changed a command
    STATUS = "status"  # `Status` changed
    TRANSFER = "transfer"  # a mission transfer ended
    PILOT = "pilot"  # somebody else took over
    REFUSAL = "refusal"  # the vehicle refused a command
    RATES = "rates"  # a message interval was asked for again
    STATUSTEXT = "statustext"


@dataclass(frozen=True, slots=True)
class DriverEvent:
    """One thing that happened, for the log and for people."""

    t_ns: int
    kind: EventKind
    text: str


class FrameRecord(msgspec.Struct, frozen=True):
    """One raw MAVLink frame for the log, without its signature."""

    t_ns: int
    outgoing: bool
    raw: bytes
