"""What an allocator tells the allocators in range, beside the neighbour message: small signed datagrams, never relayed.

offset  bytes  field, big-endian
0       1      0xC1: no version of a neighbour message
1       2      robot_id
3       4      seq
7       4      configuration digest
11      n      payload, 1 to `MAX_PAYLOAD_BYTES`, the allocator's own affair
11 + n  8      keyed BLAKE2b of all before it
"""

from __future__ import annotations

import hashlib
import hmac
import struct

from gatar_edge.neighbors import MAX_AUTHORS, HearOutcome

TALK = 0xC1
MAC_BYTES = 8
_HEAD = struct.Struct(">BHII")
MAX_DATAGRAM_BYTES = 128
MAX_PAYLOAD_BYTES = MAX_DATAGRAM_BYTES - _HEAD.size - MAC_BYTES
_PERSON = b"gatar-t1"  # a signature made for another purpose with the same key is none here


class Talk:
    """Signs what is to be said, and lets in what robots of the same team and configuration say, each datagram once."""

    def __init__(self, robot_id: int, key: bytes, config_digest: int, first_seq: int) -> None:
        self._robot_id = robot_id
        self._key = key
        self._config_digest = config_digest
        self._seq = first_seq
        self._latest: dict[int, int] = {}  # sequence by author, the longest silent first

    def seal(self, payload: bytes) -> bytes:
        """The datagram that carries `payload`."""
        if not 1 <= len(payload) <= MAX_PAYLOAD_BYTES:
            raise ValueError(f"payload has {len(payload)} bytes, must be 1 to {MAX_PAYLOAD_BYTES}")
        signed = _HEAD.pack(TALK, self._robot_id, self._seq, self._config_digest) + payload
        self._seq += 1
        return signed + self._mac(signed)

    def open(self, data: bytes) -> tuple[HearOutcome, bytes]:
        """What became of a datagram, and its payload where that is TALK. Never raises for what was sent."""
        if not _HEAD.size + MAC_BYTES < len(data) <= MAX_DATAGRAM_BYTES or data[0] != TALK:
            return HearOutcome.MALFORMED, b""
        if not hmac.compare_digest(self._mac(data[:-MAC_BYTES]), data[-MAC_BYTES:]):
            return HearOutcome.FORGED, b""
        _, robot_id, seq, digest = _HEAD.unpack_from(data)
        if robot_id == self._robot_id:
            return HearOutcome.OWN, b""
        if digest != self._config_digest:
            return HearOutcome.FOREIGN_CONFIG, b""
        if seq <= self._latest.get(robot_id, -1):
            return HearOutcome.OLDER, b""
        self._latest.pop(robot_id, None)
        if len(self._latest) >= MAX_AUTHORS:
            del self._latest[next(iter(self._latest))]
        self._latest[robot_id] = seq
        return HearOutcome.TALK, data[_HEAD.size : -MAC_BYTES]

    def _mac(self, signed: bytes) -> bytes:
        return _mac(signed, self._key)


def signed_anew(data: bytes, key: bytes) -> bytes:
    """The datagram `data` with the signature of another key."""
    return data[:-MAC_BYTES] + _mac(data[:-MAC_BYTES], key)


def author_of(data: bytes) -> tuple[int, int] | None:
    """Who wrote the datagram `data`, and its sequence; None for what is none. Verifies nothing."""
    if not _HEAD.size + MAC_BYTES < len(data) <= MAX_DATAGRAM_BYTES or data[0] != TALK:
        return None
    _, robot_id, seq, _ = _HEAD.unpack_from(data)
    return robot_id, seq


def _mac(signed: bytes, key: bytes) -> bytes:
    return hashlib.blake2b(signed, digest_size=MAC_BYTES, key=key, person=_PERSON).digest()
