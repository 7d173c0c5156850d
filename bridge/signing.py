"""MAVLink 2 signing: who may speak to whom, without secrecy. Sans-IO but for reading the key file.

Timestamps count 10 us since 2015-01-01 UTC and rise strictly per stream (link id, system, component). ArduPilot drops
in silence what is unsigned, wrongly signed, replayed or more than a minute behind, and after its set-up runs a minute
ahead: so the caller keeps `timestamp` over restarts, starts with the later of that and its clock, and we follow what we
hear.
Keys are never logged, and SETUP_SIGNING is neither sent nor logged.
"""

from __future__ import annotations

import hashlib
import hmac
import os
import stat
from pathlib import Path

from gatar_edge.bridge.wire import Address
from gatar_edge.errors import ConfigError

EPOCH_2015_S = 1_420_070_400
TICK_NS = 10_000
SIGNATURE_BYTES = 13  # link id, 6 bytes of timestamp, 6 of hash
NEW_STREAM_TICKS = 60 * 100_000  # a stream not heard before may be this far behind
KEY_BYTES = 32
MAX_STREAMS = 256  # more are not of one site
RADIO_STATUS = 109  # made by the radio itself, which has no key

_V2_MAGIC = 0xFD
_SIGNED = 0x01


def timestamp_of(unix_ns: int) -> int:
    """Nanoseconds of the Unix clock as a signing timestamp."""
    return max(0, unix_ns - EPOCH_2015_S * 1_000_000_000) // TICK_NS


def load_key(path: Path) -> bytes:
    """A 32-byte key from a file of 32 bytes or 64 hexadecimal digits that its owner alone may read.

    Raises `ConfigError` for any other file; the message never holds the key.
    """
    try:
        mode = stat.S_IMODE(os.stat(path).st_mode)
        with path.open("rb") as file:
            data = file.read(KEY_BYTES * 2 + 2)
    except OSError as error:
        raise ConfigError(f"signing key {path}: {error.strerror}") from None
    if mode & 0o077:
        raise ConfigError(f"signing key {path} has mode {mode:04o}, others may read it: chmod 600 {path}")
    if len(data) == KEY_BYTES:
        return data
    try:
        key = bytes.fromhex(data.decode("ascii"))
    except ValueError:
        key = b""
    if len(key) != KEY_BYTES:
        raise ConfigError(f"signing key {path} must hold 32 bytes or 64 hexadecimal digits, holds {len(data)} bytes")
    return key


class Signing:
    """One link's key, its timestamp, and the streams heard on it."""

    def __init__(self, key: bytes, link_id: int, timestamp: int) -> None:
        if len(key) != KEY_BYTES:
            raise ConfigError(f"a signing key has {KEY_BYTES} bytes, this one has {len(key)}")
        self.link_id = link_id
        self.timestamp = timestamp  # of the next frame; keep it over restarts
        self.rejected = 0
        self._key = key
        self._streams: dict[tuple[int, Address], int] = {}

    def __repr__(self) -> str:
        """Without the key."""
        return f"Signing(link_id={self.link_id}, timestamp={self.timestamp})"

    def advance(self, timestamp: int) -> None:
        """Time went by; the timestamp never goes back."""
        self.timestamp = max(self.timestamp, timestamp)

    def sign(self, frame: bytes) -> bytes:
        """A frame whose signed flag is set and checksum right, with its signature."""
        head = frame + bytes([self.link_id]) + self.timestamp.to_bytes(6, "little")
        self.timestamp += 1
        return head + self._hash(head)

    def accepts(self, frame: bytes, source: Address, message_id: int) -> bool:
        """Whether a received frame, its signature included, is authentic and new."""
        good = message_id == RADIO_STATUS or self._authentic(frame, source)
        self.rejected += not good
        return good

    def _authentic(self, frame: bytes, source: Address) -> bool:
        if len(frame) < 12 + SIGNATURE_BYTES or frame[0] != _V2_MAGIC or not frame[2] & _SIGNED:
            return False
        # the hash first: a forger must not be able to move a stream's timestamp
        if not hmac.compare_digest(self._hash(frame[:-6]), frame[-6:]):
            return False
        stream, told = (frame[-13], source), int.from_bytes(frame[-12:-6], "little")
        last = self._streams.get(stream)
        fresh = told > last if last is not None else told + NEW_STREAM_TICKS >= self.timestamp
        if not fresh or (last is None and len(self._streams) >= MAX_STREAMS):
            return False
        self._streams[stream] = told
        self.advance(told + 1)
        return True

    def _hash(self, data: bytes) -> bytes:
        return hashlib.sha256(self._key + data).digest()[:6]
