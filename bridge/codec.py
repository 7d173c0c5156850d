"""MAVLink 2 bytes to `wire` messages and back: with `link`, the only file that knows pymavlink.

Rule 1: `parse` never raises, whatever the bytes. Rule 2: what is returned by `encode` is a complete MAVLink 2 frame.
Rule 3: MISSION_ITEM and MISSION_REQUEST, deprecated because their coordinates are floats, are never sent.
"""

from __future__ import annotations

import io
import os
import struct
from collections import namedtuple
from collections.abc import Callable
from operator import attrgetter
from typing import Any, NamedTuple, cast

from gatar_edge.bridge import wire
from gatar_edge.bridge.framing import frame_length
from gatar_edge.bridge.signing import SIGNATURE_BYTES, Signing
from gatar_edge.bridge.wire import Message, Received

os.environ["MAVLINK20"] = "1"  # read by pymavlink when it is imported
from pymavlink.dialects.v20 import ardupilotmega as mavlink

# One datagram or one read of a serial port is far smaller; more than this in one go is not ours.
MAX_PARSE_BYTES = 65536

_V2_MAGIC = 0xFD
_V2_HEADER, _V1_HEADER = 10, 6
_V2_SIGNED = 0x01
_HEADER = struct.Struct("<BBBBBBBHB")  # of MAVLink 2


class Codec:
    """One stream's encoder (own identity and sequence number) and parser. Not shared between streams."""

    def __init__(self, sysid: int, compid: int, signing: Signing | None = None) -> None:
        self.address: wire.Address = (sysid, compid)
        self.signing = signing
        self._mav = mavlink.MAVLink(io.BytesIO(), srcSystem=sysid, srcComponent=compid)
        self._mav.robust_parsing = True
        self.bad_bytes = 0  # received and not part of any valid frame

    def encode(self, message: Message) -> bytes:
        """The frame of a message that a companion sends; `KeyError` for one that it never does."""
        built = _BUILDERS[type(message)](message)
        layout = _LAYOUTS.get(built.id)
        frame = bytes(built.pack(self._mav)) if layout is None else _plainly_packed(built, layout, self._mav)
        if self.signing is not None:
            frame = self.signing.sign(_with_flags(frame, frame[2] | _V2_SIGNED, built.crc_extra))
        self._mav.seq = (self._mav.seq + 1) % 256
        return frame

    def parse(self, data: bytes) -> list[Received]:
        """All frames that end in `data`, in order. Damage is counted in `bad_bytes` and skipped."""
        self.bad_bytes += max(0, len(data) - MAX_PARSE_BYTES)
        data = data[:MAX_PARSE_BYTES]
        plain = _plain_frames(data) if self.signing is None and self._mav.buf_len() == 0 else []
        rest = data[sum([len(received.raw) for received in plain]) :]
        frames = self._mav.parse_buffer(rest) or [] if rest else []
        return plain + [r for r in map(self._received, frames) if r is not None]

    def _received(self, frame: Any) -> Received | None:
        raw = bytes(frame.get_msgbuf())
        if frame.get_type() == "BAD_DATA":
            self.bad_bytes += len(raw)
            return None
        if frame.get_type().startswith("UNKNOWN"):  # of another dialect: its checksum cannot be checked
            return None
        read = _READERS.get(frame.get_msgId())
        source = (frame.get_srcSystem(), frame.get_srcComponent())
        if self.signing is not None and not self.signing.accepts(raw, source, frame.get_msgId()):
            return None
        message = read(frame) if read is not None else None
        signed = raw[0] == _V2_MAGIC and bool(raw[2] & _V2_SIGNED)
        return Received(source, frame.get_seq(), frame.get_msgId(), strip_signature(raw), message, signed)


def _with_flags(frame: bytes, flags: int, crc_extra: int) -> bytes:
    """A MAVLink 2 frame without signature under other incompatibility flags, and so another checksum."""
    body = frame[1:2] + bytes([flags]) + frame[3:-2]
    return frame[:1] + body + _checksum(body + bytes([crc_extra])).to_bytes(2, "little")


def _slow_checksum(data: bytes) -> int:
    checksum: int = mavlink.x25crc(data).crc
    return checksum


_checksum: Callable[[bytes], int] = getattr(mavlink, "mcrf4xx", None) or _slow_checksum  # fastcrc, where it is there


def strip_signature(frame: bytes) -> bytes:
    """A frame as it would be unsigned, for logs: any reader can parse it, nobody can replay it."""
    known = mavlink.mavlink_map.get(message_id(frame))
    if len(frame) <= 12 or frame[0] != _V2_MAGIC or not frame[2] & _V2_SIGNED or known is None:
        return frame
    return _with_flags(frame[:-SIGNATURE_BYTES], frame[2] & ~_V2_SIGNED, known.crc_extra)


def message_id(frame: bytes) -> int:
    """The message id of one complete frame of MAVLink 2 or 1."""
    return int.from_bytes(frame[7:10], "little") if frame[0] == _V2_MAGIC else frame[5]


def _item(m: Any) -> wire.MissionItemAt:
    item = wire.MissionItem(m.frame, m.command, (m.param1, m.param2, m.param3, m.param4), m.x, m.y, m.z)
    return wire.MissionItemAt((m.target_system, m.target_component), m.seq, item, m.mission_type)


def _item_frame(m: wire.MissionItemAt) -> Any:
    i = m.item
    return mavlink.MAVLink_mission_item_int_message(
        *m.target, m.seq, i.frame, i.command, 0, 1, *i.params, i.lat_e7, i.lon_e7, i.alt_m, m.mission_type
    )


def _text(m: Any) -> wire.StatusText:
    return wire.StatusText(m.severity, m.text if isinstance(m.text, str) else m.text.decode("ascii", "replace"))


def _parameter(m: Any) -> wire.ParamValue:
    raw = bytes(m.get_msgbuf())
    at = _V2_HEADER if raw[0] == _V2_MAGIC else _V1_HEADER
    # the bytes, not the float: an integer's bits in it may be those of a signalling NaN, which no float survives
    return wire.ParamValue(str(m.param_id), (raw[at : at + min(4, raw[1])] + bytes(4))[:4], m.param_type)


def _position_target(m: Any) -> wire.PositionTarget:
    return wire.PositionTarget(m.lat_int, m.lon_int, m.alt)


# message id -> reader. A reader may not fail on any field value that fits the message.
_READERS: dict[int, Callable[[Any], Message]] = {
    0: lambda m: wire.Heartbeat(m.type, m.autopilot, m.base_mode, m.custom_mode, m.system_status),
    1: lambda m: wire.SysStatus(m.battery_remaining),
    2: lambda m: wire.SystemTime(m.time_unix_usec),
    22: _parameter,
    24: lambda m: wire.GpsRaw(m.fix_type, m.satellites_visible),
    33: lambda m: wire.GlobalPosition(m.lat, m.lon, m.alt, m.relative_alt, m.vx, m.vy, m.hdg),
    40: lambda m: wire.MissionRequest((m.target_system, m.target_component), m.seq, m.mission_type),
    42: lambda m: wire.MissionCurrent(m.seq, m.total, m.mission_state),
    44: lambda m: wire.MissionCount((m.target_system, m.target_component), m.count, m.mission_type),
    47: lambda m: wire.MissionAck((m.target_system, m.target_component), m.type, m.mission_type),
    49: lambda m: wire.GlobalOrigin(m.latitude, m.longitude, m.altitude),
    51: lambda m: wire.MissionRequest((m.target_system, m.target_component), m.seq, m.mission_type),
    73: _item,
    77: lambda m: wire.CommandAck(m.command, m.result, (m.target_system, m.target_component)),
    87: _position_target,
    111: lambda m: wire.TimeSync(m.tc1, m.ts1),
    148: lambda m: wire.AutopilotVersion(m.capabilities, m.flight_sw_version),
    242: lambda m: wire.HomePosition(m.latitude, m.longitude, m.altitude),
    245: lambda m: wire.ExtendedSysState(m.landed_state),
    253: _text,
}

# message type -> builder of the pymavlink message, unsent and unpacked
_BUILDERS: dict[type, Callable[[Any], Any]] = {
    wire.Heartbeat: lambda m: mavlink.MAVLink_heartbeat_message(
        m.type, m.autopilot, m.base_mode, m.custom_mode, m.system_status, 3
    ),
    wire.CommandLong: lambda m: mavlink.MAVLink_command_long_message(*m.to, m.command, 0, *m.params),
    wire.CommandInt: lambda m: mavlink.MAVLink_command_int_message(
        *m.to, m.frame, m.command, 0, 0, *m.params, m.lat_e7, m.lon_e7, m.alt_m
    ),
    wire.SetPositionTarget: lambda m: mavlink.MAVLink_set_position_target_global_int_message(
        0, *m.to, m.frame, m.type_mask, m.lat_e7, m.lon_e7, m.alt_m, 0, 0, 0, 0, 0, 0, 0, 0
    ),
    wire.MissionCount: lambda m: mavlink.MAVLink_mission_count_message(*m.target, m.count, m.mission_type),
    wire.MissionRequest: lambda m: mavlink.MAVLink_mission_request_int_message(*m.target, m.seq, m.mission_type),
    wire.MissionItemAt: _item_frame,
    wire.MissionAck: lambda m: mavlink.MAVLink_mission_ack_message(*m.target, m.result, m.mission_type),
    wire.MissionRequestList: lambda m: mavlink.MAVLink_mission_request_list_message(*m.target, m.mission_type),
    wire.MissionClearAll: lambda m: mavlink.MAVLink_mission_clear_all_message(*m.target, m.mission_type),
    wire.ParamRead: lambda m: mavlink.MAVLink_param_request_read_message(*m.target, m.name.encode("ascii"), -1),
    wire.SetGlobalOrigin: lambda m: mavlink.MAVLink_set_gps_global_origin_message(
        m.sysid, m.lat_e7, m.lon_e7, m.alt_amsl_mm
    ),
    wire.TimeSync: lambda m: mavlink.MAVLink_timesync_message(m.tc1, m.ts1),
    wire.MissionSetCurrent: lambda m: mavlink.MAVLink_mission_set_current_message(*m.target, m.seq),
}


class _Layout(NamedTuple):
    """How one message without arrays lies in its payload, from pymavlink's tables."""

    size: int
    pack: Callable[..., bytes]
    unpack: Callable[[bytes], tuple[Any, ...]]
    values: Callable[[Any], Any]  # of a pymavlink message, in the order of the wire, and its id
    named: Callable[[tuple[Any, ...]], Any]  # the fields as attributes, which readers ask for
    read: Callable[[Any], Message] | None
    crc_extra: bytes


def _layouts() -> dict[int, _Layout]:
    layouts = {}
    for number, kind in mavlink.mavlink_map.items():
        names, unpacker = kind.ordered_fieldnames, kind.unpacker
        if all(length == 1 for length in kind.lengths) and "s" not in unpacker.format:
            fields = cast(Any, namedtuple)("Fields", names)
            layouts[number] = _Layout(
                size=unpacker.size,
                pack=unpacker.pack,
                unpack=unpacker.unpack,
                values=attrgetter(*names, "id"),  # one too many, so that a single field also comes in a tuple
                named=fields._make,
                read=_READERS.get(number),
                crc_extra=bytes([kind.crc_extra]),
            )
    return layouts


_LAYOUTS = _layouts()


def _plainly_packed(built: Any, layout: _Layout, mav: Any) -> bytes:
    """A pymavlink message without arrays as a frame: what its own `pack` would give, at a third of its cost."""
    payload = layout.pack(*layout.values(built)[:-1]).rstrip(b"\0") or b"\0"
    source = mav.seq, mav.srcSystem, mav.srcComponent
    frame = _HEADER.pack(_V2_MAGIC, len(payload), 0, 0, *source, built.id & 0xFFFF, built.id >> 16) + payload
    return frame + _checksum(frame[1:] + layout.crc_extra).to_bytes(2, "little")


def _plain_frames(data: bytes) -> list[Received]:
    """The frames that `data` begins with, up to the first one that `_plain_frame` does not read."""
    found: list[Received] = []
    at = 0
    while at < len(data):
        received = _plain_frame(data[at : at + frame_length(data, at)])
        if received is None:
            break
        found.append(received)
        at += len(received.raw)
    return found


def _plain_frame(data: bytes) -> Received | None:
    """`data` where it is exactly one unsigned MAVLink 2 frame of a message without arrays, as nearly all frames are.

    What pymavlink's parser would give, at a third of its cost; it is left all that is not of this simple kind.
    """
    if len(data) < 12 or data[0] != _V2_MAGIC or data[2] or len(data) != 12 + data[1]:
        return None
    number = data[7] | data[8] << 8 | data[9] << 16
    layout = _LAYOUTS.get(number)
    if layout is None or _checksum(data[1:-2] + layout.crc_extra) != data[-2] | data[-1] << 8:
        return None
    message = None
    if layout.read is not None:
        payload = data[_V2_HEADER:-2][: layout.size].ljust(layout.size, b"\0")
        message = layout.read(layout.named(layout.unpack(payload)))
    return Received((data[5], data[6]), data[4], number, data, message)
