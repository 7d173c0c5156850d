"""What a robot tells its neighbours: one signed datagram of 127 bytes, encoder beside decoder.

    offset  bytes  field, big-endian
    0       1      version
    1       1      bits 0-1 robot kind, bits 2-3 task kind, bits 4-7 zero
    2       1      hops: 0 from the author, one more for each relay
    3       2      robot_id
    5       4      seq
    9       6      t_ms, the author's clock; informational, no receiver relies on it
    15      4      cell (x, y), signed
    19      1      speed, 1/16 cell/s
    20      4      task cell (x, y), signed
    24      2      cost, 1/16 cell, saturating
    26      4      window origin (x, y), signed: the cell of window[0, 0]
    30      4      configuration digest
    34      85     window: bit planes 0, 1, 2 of the 225 cell codes in [x, y] order, low bit first, then 5 zero bits
    119     8      keyed BLAKE2b of all before it

Rule 1: each message has exactly one encoding, so a relay that changes `hops` and signs again changes nothing else.
Rule 2: nothing is believed, and no array made, before the signature has been verified.
"""

from __future__ import annotations

import hashlib
import hmac
import struct
from functools import lru_cache
from typing import NamedTuple

import msgspec
import numpy as np

from gatar_edge.errors import ConfigError, MessageCause, MessageError
from gatar_edge.types import NS_PER_S, ByteGrid, Cell, CellState, RobotKind, TaskKind

VERSION = 1
WINDOW_CELLS = 15
MAC_BYTES = 8
MESSAGE_BYTES = 127  # a MAVLink TUNNEL carries 128
MAX_COST = 0xFFFF / 16  # cells; a longer way is sent as this
MAX_SPEED_CELLS_S = 0xFF / 16

_HEAD = struct.Struct(">BBBHIHIhhBhhHhhI")  # t_ms travels as its high 16 and low 32 bits
_ROUTE = struct.Struct(">BHI")  # hops, robot_id, seq at offset 2
_DIGEST = struct.Struct(">I")
_ROUTE_AT, _SEQ_AT, _DIGEST_AT, _SIGNED_BYTES = 2, 5, 30, MESSAGE_BYTES - MAC_BYTES
_PLANE_BITS = WINDOW_CELLS * WINDOW_CELLS
_PLANE_MASK = (1 << _PLANE_BITS) - 1
_WEIGHTS = np.array([1, 2, 4], np.uint8)  # of the three planes
_CODES = bytes(CellState)
_PERSON = b"gatar-v1"  # a signature made for another purpose with the same key is none here
_KINDS = tuple(RobotKind)
_TASKS = tuple(TaskKind)

SEQ_EPOCH_UNIX_S = 1_767_225_600  # 2026-01-01T00:00:00Z
MAX_MESSAGES_PER_S = 10  # numbers that one second of the clock is worth; 32 bits then last until August 2039
_MAX_SEQ = 0xFFFF_FFFF


class NeighborMessage(msgspec.Struct, frozen=True, eq=False):
    """What one robot says of itself and of the window of cells around it.

    `window` is uint8 [15, 15] of `CellState` codes, read-only when decoded; its [0, 0] is the cell `window_origin`.
    `speed_cells_s` and `cost` travel in sixteenths: see `wire_speed` and `wire_cost`.
    """

    robot_id: int
    kind: RobotKind
    seq: int
    t_ms: int
    cell: Cell
    speed_cells_s: float
    task: TaskKind
    task_cell: Cell
    cost: float
    window_origin: Cell
    window: ByteGrid
    config_digest: int
    hops: int = 0

    def __eq__(self, other: object) -> bool:
        """Equal in all fields; written out because arrays have no truth value."""
        if not isinstance(other, NeighborMessage):
            return NotImplemented
        names = (name for name in self.__struct_fields__ if name != "window")
        return all(getattr(self, name) == getattr(other, name) for name in names) and np.array_equal(
            self.window, other.window
        )

    __hash__ = None  # type: ignore[assignment]  # holds an array


class Envelope(NamedTuple):
    """The part of a verified message that decides whether the rest is worth unpacking."""

    robot_id: int
    seq: int
    hops: int
    config_digest: int


def encode(message: NeighborMessage, key: bytes) -> bytes:
    """The 127 bytes of `message`, signed with the team's key.

    Raises MessageError, naming field, value and limits, where a field does not fit.
    """
    if not (0 <= message.kind < len(_KINDS) and 0 <= message.task < len(_TASKS)):
        raise MessageError(f"kind {message.kind} or task {message.task} is unknown to message version {VERSION}")
    speed = _sixteenths("speed_cells_s", message.speed_cells_s, 0xFF)
    cost = _sixteenths("cost", message.cost, 0xFFFF)
    planes = _pack_window(message.window)
    try:
        head = _HEAD.pack(
            VERSION,
            message.kind | message.task << 2,
            message.hops,
            message.robot_id,
            message.seq,
            message.t_ms >> 32,
            message.t_ms & 0xFFFF_FFFF,
            *message.cell,
            speed,
            *message.task_cell,
            cost,
            *message.window_origin,
            message.config_digest,
        )
    except (struct.error, TypeError) as error:
        raise MessageError(_describe_misfit(message)) from error
    return _sign(head + planes, key)


def decode(data: bytes, key: bytes) -> NeighborMessage:
    """The message in `data`; raises MessageError, and nothing else, for any bytes that are not one."""
    open_envelope(data, key)
    return unpack(data)


@lru_cache(maxsize=512)  # refusals are not remembered; in a simulator every robot in range reads the same message
def open_envelope(data: bytes, key: bytes) -> Envelope:
    """Verify version, length and signature, and read who sent what; costs no array. Raises MessageError."""
    if not data:
        raise MessageError("an empty datagram is not a message")
    if data[0] != VERSION:
        raise MessageError(f"message version is {data[0]}, this robot reads {VERSION}", MessageCause.VERSION)
    if len(data) != MESSAGE_BYTES:
        raise MessageError(f"message has {len(data)} bytes, version {VERSION} has {MESSAGE_BYTES}")
    if not hmac.compare_digest(_mac(data[:_SIGNED_BYTES], key), data[_SIGNED_BYTES:]):
        raise MessageError("message is signed with another key, or was changed on the way", MessageCause.FORGED)
    hops, robot_id, seq = _ROUTE.unpack_from(data, _ROUTE_AT)
    return Envelope(robot_id, seq, hops, _DIGEST.unpack_from(data, _DIGEST_AT)[0])


@lru_cache(maxsize=512)  # a message is read by the table and the recorder, in a simulator by every robot in range
def unpack(data: bytes) -> NeighborMessage:
    """The message in `data`, which `open_envelope` has verified. Raises MessageError for values nobody may send."""
    _, flags, hops, robot_id, seq, t_high, t_low, x, y, speed, task_x, task_y, cost, origin_x, origin_y, digest = (
        _HEAD.unpack_from(data)
    )
    kind, task = flags & 3, flags >> 2
    if kind >= len(_KINDS):
        raise MessageError(f"robot kind is {kind}, known are 0..{len(_KINDS) - 1}")
    if task >= len(_TASKS):
        raise MessageError(f"task kind with reserved bits is {task}, known are 0..{len(_TASKS) - 1}")
    return NeighborMessage(
        robot_id=robot_id,
        kind=_KINDS[kind],
        seq=seq,
        t_ms=t_high << 32 | t_low,
        cell=(x, y),
        speed_cells_s=speed / 16,
        task=_TASKS[task],
        task_cell=(task_x, task_y),
        cost=cost / 16,
        window_origin=(origin_x, origin_y),
        window=_unpack_window(data[_HEAD.size : _SIGNED_BYTES]),
        config_digest=digest,
        hops=hops,
    )


def sender_of(data: bytes) -> int | None:
    """Who claims to have written `data`; None where it has not a message's length. Verifies nothing."""
    return int(_ROUTE.unpack_from(data, _ROUTE_AT)[1]) if len(data) == MESSAGE_BYTES else None


@lru_cache(maxsize=512)  # see `open_envelope`: all that relay a message send the same bytes
def with_hops(data: bytes, hops: int, key: bytes) -> bytes:
    """The verified message `data` as a relay sends it on: another hop count, signed again."""
    return _sign(data[:_ROUTE_AT] + bytes((hops,)) + data[_ROUTE_AT + 1 : _SIGNED_BYTES], key)


def numbered(data: bytes, seq: int, key: bytes) -> bytes:
    """The message `data` as its author would send it another time: the same news under another sequence number."""
    return _sign(data[:_SEQ_AT] + seq.to_bytes(4, "big") + data[_SEQ_AT + 4 : _SIGNED_BYTES], key)


def wire_cost(cost: float) -> float:
    """`cost` in cells as the neighbours will read it: claims are compared in these numbers, own ones included."""
    return _sixteenths("cost", cost, 0xFFFF) / 16


def wire_speed(speed_cells_s: float) -> float:
    """`speed_cells_s` as the neighbours will read it."""
    return _sixteenths("speed_cells_s", speed_cells_s, 0xFF) / 16


def first_seq(now_unix_ns: int, last_used: int = 0) -> int:
    """The first sequence number of a sender that starts now: above all that it used before, without stored state.

    It is the number of tenths of seconds since 2026, so a sender must not average more than `MAX_MESSAGES_PER_S`
    and its clock must not go back while it is down. Where the last number was stored, `last_used` heals both.

    Raises ConfigError before 2026 (unset clock) and when 32 bits are used up: on 2039-08-12.
    """
    by_clock = (now_unix_ns - SEQ_EPOCH_UNIX_S * NS_PER_S) * MAX_MESSAGES_PER_S // NS_PER_S
    seq = max(by_clock, last_used + 1)
    if by_clock < 0 and not last_used:
        raise ConfigError(
            f"the clock says {now_unix_ns // NS_PER_S} s since 1970, which is before 2026: set it (NTP or GPS) before "
            "the robot joins its team, because message sequences start from it"
        )
    if seq > _MAX_SEQ:
        raise ConfigError(f"message sequence {seq} exceeds {_MAX_SEQ}: correct the clock, or give the team a new key")
    return seq


def _mac(signed: bytes, key: bytes) -> bytes:
    return hashlib.blake2b(signed, digest_size=MAC_BYTES, key=key, person=_PERSON).digest()


def _sign(signed: bytes, key: bytes) -> bytes:
    return signed + _mac(signed, key)


def _sixteenths(name: str, value: float, limit: int) -> int:
    if not value >= 0:  # also catches NaN
        raise MessageError(f"{name} is {value}, must be a number >= 0")
    return limit if value * 16 >= limit else round(value * 16)


def _pack_window(window: ByteGrid) -> bytes:
    if window.shape != (WINDOW_CELLS, WINDOW_CELLS) or window.dtype != np.uint8:
        raise MessageError(f"window is {window.dtype} {window.shape}, must be uint8 ({WINDOW_CELLS}, {WINDOW_CELLS})")
    return _planes(window.tobytes())


@lru_cache(maxsize=128)  # a robot that has seen nothing new says the same again
def _planes(codes: bytes) -> bytes:
    if codes.translate(None, _CODES):  # what is left over
        raise MessageError(f"window holds cell code {max(codes)}, known are 0..{CellState.LOCALIZED.value}")
    window = np.frombuffer(codes, np.uint8)
    return np.packbits(window & _WEIGHTS[:, np.newaxis], bitorder="little").tobytes()


@lru_cache(maxsize=512)  # robots that know the same say the same; who gets the same array need not look into it again
def _unpack_window(planes: bytes) -> ByteGrid:
    bits = int.from_bytes(planes, "little")
    low, middle, high = bits & _PLANE_MASK, bits >> _PLANE_BITS & _PLANE_MASK, bits >> 2 * _PLANE_BITS
    if high > _PLANE_MASK:
        raise MessageError("the bits behind the window are not zero")
    if high & (low | middle):
        raise MessageError(f"window holds a cell code of 5..7, known are 0..{CellState.LOCALIZED.value}")
    rows = np.unpackbits(np.frombuffer(planes, np.uint8), count=3 * _PLANE_BITS, bitorder="little")
    window: ByteGrid = (_WEIGHTS @ rows.reshape(3, _PLANE_BITS)).reshape(WINDOW_CELLS, WINDOW_CELLS)
    window.setflags(write=False)
    return window


def _describe_misfit(message: NeighborMessage) -> str:
    """Which field does not fit its place on the wire: looked for only when one did not."""
    places = [
        ("hops", (message.hops,), 0, 0xFF),
        ("robot_id", (message.robot_id,), 0, 0xFFFF),
        ("seq", (message.seq,), 0, _MAX_SEQ),
        ("t_ms", (message.t_ms,), 0, 0xFFFF_FFFF_FFFF),
        ("cell", message.cell, -0x8000, 0x7FFF),
        ("task_cell", message.task_cell, -0x8000, 0x7FFF),
        ("window_origin", message.window_origin, -0x8000, 0x7FFF),
        ("config_digest", (message.config_digest,), 0, 0xFFFF_FFFF),
    ]
    for name, values, low, high in places:
        if any(not isinstance(value, int | np.integer) or not low <= value <= high for value in values):
            return f"{name} is {getattr(message, name)}, must be of whole numbers {low}..{high}"
    return "a cell of the message does not have two coordinates"
