"""Neighbour messages through the autopilots' telemetry radios: each travels in one MAVLink TUNNEL (385), 128 bytes.

The vehicle's link is shared with the bridge: what comes in is handed here by `feed`. The tunnel speaks as a component
of its own, so that the sequence numbers of the bridge stay without gaps.
"""

from __future__ import annotations

import io
import os
from collections import deque
from collections.abc import Callable
from typing import Any

from gatar_edge.transports.base import MAX_DATAGRAMS_PER_RECEIVE, LinkCounters

os.environ["MAVLINK20"] = "1"  # read by pymavlink when it is imported
from pymavlink.dialects.v20 import ardupilotmega as mavlink

COMPONENT = 192  # MAV_COMP_ID_ONBOARD_COMPUTER2; the bridge is 191
PAYLOAD_TYPE = 0xED6E  # from 32768 on free for private use (MAV_TUNNEL_PAYLOAD_TYPE)
PAYLOAD_BYTES = 128
FRAME_BYTES = 12 + 5 + PAYLOAD_BYTES  # of a MAVLink 2 TUNNEL frame without signature, at most
MAX_FEED_BYTES = 65_536


class MavlinkTunnel:
    """A `Transport` on a link that belongs to somebody else, who gives `send` and `fileno` and calls `feed`."""

    sends = 1

    def __init__(self, send: Callable[[bytes], object], fileno: Callable[[], int], sysid: int) -> None:
        self.counters = LinkCounters()
        self._send = send
        self._fileno = fileno
        self._sysid = sysid
        self._mav = mavlink.MAVLink(io.BytesIO(), srcSystem=sysid, srcComponent=COMPONENT)
        self._mav.robust_parsing = True
        self._arrived: deque[bytes] = deque(maxlen=MAX_DATAGRAMS_PER_RECEIVE)

    def send(self, data: bytes) -> None:
        """Send one datagram to all that the autopilot's routing reaches; one that does not fit is counted."""
        if len(data) > PAYLOAD_BYTES:
            self.counters.send_errors += 1
            return
        payload = list(data.ljust(PAYLOAD_BYTES, b"\0"))
        frame = mavlink.MAVLink_tunnel_message(0, 0, PAYLOAD_TYPE, len(data), payload).pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        self._send(frame)
        self.counters.sent += 1
        self.counters.sent_bytes += len(data)

    def feed(self, data: bytes) -> None:
        """Take in bytes of the shared link, whole frames or pieces; all but our tunnel's frames are ignored."""
        for frame in self._mav.parse_buffer(data[:MAX_FEED_BYTES]) or []:
            if frame.get_msgId() == mavlink.MAVLINK_MSG_ID_TUNNEL:
                self._take(frame)

    def receive(self) -> list[bytes]:
        """The datagrams that have come, without waiting."""
        received = list(self._arrived)
        self._arrived.clear()
        self.counters.received += len(received)
        self.counters.received_bytes += sum(map(len, received))
        return received

    def fileno(self) -> int:
        """The shared link, for `select`."""
        return self._fileno()

    def close(self) -> None:
        """Forget what has come; the link belongs to the bridge."""
        self._arrived.clear()

    def _take(self, frame: Any) -> None:
        own = (frame.get_srcSystem(), frame.get_srcComponent()) == (self._sysid, COMPONENT)
        if own or frame.payload_type != PAYLOAD_TYPE:
            return
        if frame.payload_length > PAYLOAD_BYTES:
            self.counters.too_long += 1
            return
        self._arrived.append(bytes(frame.payload[: frame.payload_length]))
