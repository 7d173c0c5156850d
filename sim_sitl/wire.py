"""The only place where a simulated autopilot touches MAVLink bytes: everything else works on names and fields."""

from __future__ import annotations

import os
import struct
from typing import Any, NamedTuple

os.environ.setdefault("MAVLINK20", "1")  # read by pymavlink when it is imported

from pymavlink.dialects.v20 import ardupilotmega as mavlink

__all__ = ["Message", "Send", "Wire", "mavlink"]

Message = Any  # a decoded MAVLink message: pymavlink has no types

_FRAME_MAX_BYTES = 280
_PER_CALL_MAX_BYTES = 1 << 16


class Send(NamedTuple):
    """One message to send: its MAVLink name and its fields."""

    name: str
    fields: dict[str, Any]


def _message_class(name: str) -> Any:
    return getattr(mavlink, f"MAVLink_{name.lower()}_message")


class Wire:
    """Bytes to messages and back for one vehicle. Never raises for what it is fed."""

    def __init__(self, sysid: int, compid: int = 1) -> None:
        self._codec = mavlink.MAVLink(None, srcSystem=sysid, srcComponent=compid)
        self._codec.robust_parsing = True
        self._classes: dict[str, Any] = {}
        self.rejected = 0  # frames that were no messages

    def parse(self, data: bytes) -> list[Message]:
        """All whole messages in `data` and what was left from before; broken ones are counted and dropped."""
        messages: list[Message] = []
        chunk: bytes = data[:_PER_CALL_MAX_BYTES]
        for _ in range(len(chunk) + _FRAME_MAX_BYTES):  # each turn takes at least one byte out of the buffer
            try:
                message = self._codec.parse_char(chunk)
            except (mavlink.MAVError, struct.error, ValueError, TypeError, LookupError):
                self.rejected += 1
                chunk = b""
                continue
            chunk = b""
            if message is None:
                break
            if message.get_msgId() < 0:  # pymavlink's BAD_DATA and UNKNOWN
                self.rejected += 1
            else:
                messages.append(message)
        return messages

    def pack(self, send: Send) -> bytes:
        """One message as a MAVLink 2 frame."""
        cls = self._classes.get(send.name)
        if cls is None:
            cls = self._classes[send.name] = _message_class(send.name)
        return bytes(cls(**send.fields).pack(self._codec))
