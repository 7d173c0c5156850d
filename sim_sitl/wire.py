"""The only place where a simulated autopilot touches MAVLink bytes: everything else works on names and fields."""

from __future__ import annotations

import os
import struct
from collections.abc import Callable
from functools import cache, lru_cache
from operator import itemgetter
from typing import Any, NamedTuple

os.environ.setdefault("MAVLINK20", "1")  # read by pymavlink when it is imported

from pymavlink.dialects.v20 import ardupilotmega as mavlink

__all__ = ["Message", "Send", "Wire", "mavlink"]

Message = Any  # a decoded MAVLink message: pymavlink has no types

_FRAME_MAX_BYTES = 280
_PER_CALL_MAX_BYTES = 1 << 16
_RADIO_STATUS = 109  # is never signed
_TICK_NS = 10_000  # of a signature's timestamp
_HEADER = struct.Struct("<BBBBBBBHB")  # of MAVLink 2
_AHEAD_TICKS = 6_000_000  # one minute


class Send(NamedTuple):
    """One message to send: its MAVLink name and its fields."""

    name: str
    fields: dict[str, Any]


class _Layout(NamedTuple):
    """How one message is packed: `width` is 0 where it holds arrays, which pymavlink alone packs."""

    kind: Any
    number: int
    width: int  # how many fields
    ordered: Callable[[dict[str, Any]], tuple[Any, ...]]  # the fields in the order of the wire
    given: Callable[[tuple[Any, ...]], tuple[Any, ...]]  # from that order to that of the message's arguments
    payload: struct.Struct
    crc_extra: bytes


@cache
def _layout(name: str) -> _Layout:
    kind = getattr(mavlink, f"MAVLink_{name.lower()}_message")
    plain = all(length == 1 for length in kind.lengths) and "s" not in kind.unpacker.format
    width = len(kind.ordered_fieldnames) if plain and len(kind.ordered_fieldnames) > 1 else 0
    ordered, given = itemgetter(*kind.ordered_fieldnames), itemgetter(*kind.orders)
    return _Layout(kind, kind.id, width, ordered, given, kind.unpacker, bytes([kind.crc_extra]))


@lru_cache(maxsize=512)  # the number is what a peer claims
def _layout_of(number: int) -> _Layout | None:
    """The layout of a message without arrays, by its number."""
    kind = mavlink.mavlink_map.get(number)
    layout = _layout(kind.msgname) if kind is not None else None
    return layout if layout is not None and layout.width else None


def _slow_checksum(data: bytes) -> int:
    checksum: int = mavlink.x25crc(data).crc
    return checksum


_checksum: Callable[[bytes], int] = getattr(mavlink, "mcrf4xx", None) or _slow_checksum  # fastcrc, where it is there


def _is_one_frame(data: bytes) -> bool:
    """Whether `data` claims to be one unsigned frame of MAVLink 2."""
    return len(data) >= 12 and data[0] == 0xFD and not data[2] and len(data) == 12 + data[1]


class Wire:
    """Bytes to messages and back for one vehicle. Never raises for what it is fed."""

    def __init__(self, sysid: int, accepts_unsigned: bool = True, compid: int = 1) -> None:
        self._codec = mavlink.MAVLink(None, srcSystem=sysid, srcComponent=compid)
        self._codec.robust_parsing = True
        self._accepts_unsigned = accepts_unsigned
        self._clock_start = self._clock_ns = 0
        self.rejected = 0  # frames that were no messages

    def sign(self, key: bytes, timestamp: int, now_ns: int) -> None:
        """SETUP_SIGNING: sign from now on, with a clock that runs a minute ahead as ArduPilot's does; no key: stop."""
        signing = self._codec.signing
        signing.secret_key = key if any(key) else None
        signing.sign_outgoing = signing.secret_key is not None
        signing.allow_unsigned_callback = self._allows if signing.secret_key is not None else None
        signing.timestamp = self._clock_start = timestamp + _AHEAD_TICKS
        self._clock_ns = now_ns

    def restart(self, now_ns: int) -> None:
        """Power off and on: the key and the last timestamp survive, the streams do not."""
        signing = self._codec.signing
        if signing.secret_key is not None:
            signing.stream_timestamps.clear()
            signing.timestamp = self._clock_start = signing.timestamp + _AHEAD_TICKS
            self._clock_ns = now_ns

    def pass_time(self, now_ns: int) -> None:
        """Let the clock of the signatures run; it never goes back behind a timestamp that was received."""
        signing = self._codec.signing
        if signing.secret_key is not None:
            signing.timestamp = max(signing.timestamp, self._clock_start + (now_ns - self._clock_ns) // _TICK_NS)

    def _allows(self, codec: Any, message_id: int) -> bool:
        return self._accepts_unsigned or message_id == _RADIO_STATUS

    def parse(self, data: bytes) -> list[Message]:
        """All whole messages in `data` and what was left from before; broken ones are counted and dropped."""
        if self._codec.signing.secret_key is None and not self._codec.buf_len() and _is_one_frame(data):
            return self._decode(data)
        messages: list[Message] = []
        chunk: bytes = data[:_PER_CALL_MAX_BYTES]
        for _ in range(len(chunk) + _FRAME_MAX_BYTES):  # each turn takes at least one byte out of the buffer
            streams = dict(self._codec.signing.stream_timestamps)
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
                self._codec.signing.stream_timestamps = streams  # it takes over timestamps before it checks signatures
            else:
                messages.append(message)
        return messages

    def _decode(self, frame: bytes) -> list[Message]:
        """`parse` of the usual datagram, without pymavlink's search for where frames begin and end."""
        plain = _plainly_decoded(frame)
        if plain is not None:
            return [plain]
        try:
            message = self._codec.decode(bytearray(frame))
        except (mavlink.MAVError, struct.error, ValueError, TypeError, LookupError):
            message = None
        if message is None or message.get_msgId() < 0:
            self.rejected += 1
            return []
        return [message]

    def pack(self, send: Send) -> bytes:
        """One message as a MAVLink 2 frame, numbered after the one before."""
        frame = self._frame(send)
        self._codec.seq = (self._codec.seq + 1) % 256  # pymavlink counts only what it sends itself
        return frame

    def _frame(self, send: Send) -> bytes:
        name, fields = send
        layout, codec = _layout(name), self._codec
        if codec.signing.sign_outgoing or len(fields) != layout.width:
            return bytes(layout.kind(**fields).pack(codec))
        # the usual case, as pymavlink would pack it at several times the cost
        payload = layout.payload.pack(*layout.ordered(fields)).rstrip(b"\0") or b"\0"
        number = layout.number
        source = codec.seq, codec.srcSystem, codec.srcComponent
        frame = _HEADER.pack(0xFD, len(payload), 0, 0, *source, number & 0xFFFF, number >> 16) + payload
        return frame + _checksum(frame[1:] + layout.crc_extra).to_bytes(2, "little")


def _plainly_decoded(frame: bytes) -> Message | None:
    """What `_is_one_frame` where it is whole and holds no arrays: what pymavlink would give, at a third of its cost."""
    layout = _layout_of(frame[7] | frame[8] << 8 | frame[9] << 16)
    if layout is None or _checksum(frame[1:-2] + layout.crc_extra) != frame[-2] | frame[-1] << 8:
        return None
    size = layout.payload.size
    values = layout.payload.unpack(frame[10:-2][:size].ljust(size, b"\0"))
    message = layout.kind(*layout.given(values))
    header = message.get_header()
    header.mlen, header.compat_flags, header.seq, header.srcSystem, header.srcComponent = frame[1], *frame[3:7]
    return message
