"""What every way for neighbour messages offers: send and forget, take what has come, never block, never raise.

A transport raises LinkError only while it is being opened. Afterwards a broken network is counted, not raised: a robot
that cannot talk goes on alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

MAX_DATAGRAM_BYTES = 256  # longer ones are no message of any version: dropped and counted
MAX_DATAGRAMS_PER_RECEIVE = 256  # four copies from each of 63 neighbours; the rest waits for the next call


@dataclass(slots=True)
class LinkCounters:
    """What a transport did since it was opened."""

    sent: int = 0
    sent_bytes: int = 0
    send_errors: int = 0
    received: int = 0
    received_bytes: int = 0
    receive_errors: int = 0
    too_long: int = 0  # received and dropped


class Transport(Protocol):
    """One way for neighbour messages; `sends` is the number of datagrams that one `send` puts on the air."""

    counters: LinkCounters

    @property
    def sends(self) -> int:
        """Datagrams per call of `send`: 1 for a multicast group, the number of peers for a list."""
        ...

    def send(self, data: bytes) -> None:
        """Send one datagram to all peers; failures are counted."""
        ...

    def receive(self) -> list[bytes]:
        """The datagrams that have come, at most `MAX_DATAGRAMS_PER_RECEIVE`, without waiting."""
        ...

    def fileno(self) -> int:
        """What `select` waits on until `receive` has something."""
        ...

    def close(self) -> None:
        """Give the link back; later calls do nothing."""
        ...
