"""Where MAVLink frames begin and end, by their headers alone: all that a link knows of the bytes that it carries."""

from __future__ import annotations

MAX_DATAGRAM = 1200  # bytes of whole frames in one datagram: below any path's MTU

_V2, _V1 = 0xFD, 0xFE


def frame_length(data: bytes, at: int = 0) -> int:
    """The length that the MAVLink header at `at` announces; the rest of `data` where there is no whole header."""
    rest = len(data) - at
    if rest >= 3 and data[at] == _V2:
        return min(rest, 12 + data[at + 1] + (13 if data[at + 2] & 1 else 0))
    if rest >= 2 and data[at] == _V1:
        return min(rest, 8 + data[at + 1])
    return rest


def sender(data: bytes) -> tuple[int, int] | None:
    """(sysid, compid) in the header that `data` begins with, None where it begins with something else."""
    if len(data) >= 12 and data[0] == _V2:
        return data[5], data[6]
    if len(data) >= 8 and data[0] == _V1:
        return data[3], data[4]
    return None


def datagrams(data: bytes) -> list[bytes]:
    """Frames packed into as few datagrams of at most MAX_DATAGRAM bytes as keep every frame whole."""
    packed: list[bytes] = []
    at = 0
    while at < len(data):
        frame = data[at : at + frame_length(data, at)]
        at += len(frame)
        if packed and len(packed[-1]) + len(frame) <= MAX_DATAGRAM:
            packed[-1] += frame
        else:
            packed.append(frame)
    return packed
