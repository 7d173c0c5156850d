"""What may be kept of a raw MAVLink frame: never a signature, never a key."""

from __future__ import annotations

MAGIC_V2 = 0xFD
SIGNED_FLAG = 0x01  # MAVLINK_IFLAG_SIGNED
SIGNATURE_BYTES = 13
SETUP_SIGNING = 256  # carries the vehicle's secret key
_HEADER_BYTES = 10  # with the magic
_CRC_BYTES = 2


def without_secrets(frame: bytes) -> bytes | None:
    """`frame` as if it had been sent unsigned, its checksum valid; None for SETUP_SIGNING and what is no frame."""
    if len(frame) < 8:
        return None
    if frame[0] != MAGIC_V2:
        return frame  # MAVLink 1 knows neither signatures nor message 256
    if len(frame) < _HEADER_BYTES + _CRC_BYTES or int.from_bytes(frame[7:10], "little") == SETUP_SIGNING:
        return None
    if not frame[2] & SIGNED_FLAG:
        return frame
    end = _HEADER_BYTES + frame[1]
    if len(frame) < end + _CRC_BYTES:
        return None
    crc = int.from_bytes(frame[end : end + _CRC_BYTES], "little") ^ _crc_change(end)
    return frame[:2] + bytes((frame[2] & ~SIGNED_FLAG,)) + frame[3:end] + crc.to_bytes(_CRC_BYTES, "little")


def _crc_change(end: int) -> int:
    """What clearing the signed flag does to the checksum, whatever the message.

    The checksum is linear over XOR, so that its change is the checksum of the changed bits alone; the extra byte of the
    message's definition, unknown here, is the same before and after.
    """
    crc = 0
    for byte in (0, SIGNED_FLAG, *bytes(end - 3), 0):  # from the byte after the magic to the extra byte
        part = (byte ^ crc) & 0xFF
        part = (part ^ part << 4) & 0xFF
        crc = crc >> 8 ^ part << 8 ^ part << 3 ^ part >> 4
    return crc
