"""The file under a log: written in whole MCAP records or not at all, so that all that a kill leaves can be read.

The MCAP writer's output is collected and handed to the operating system in one piece at each flush. A kill then finds
the file ending at a record; a disk that fills up leaves it cut back to the last whole one.
"""

from __future__ import annotations

import os
from pathlib import Path

MAX_PENDING_BYTES = 1024 * 1024


class RecordStream:
    """A write-only stream for `McapWriter` over an unbuffered file."""

    def __init__(self, path: Path) -> None:
        self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o644)
        self._pending = bytearray()
        self._written = 0
        self._closed = False

    def write(self, data: bytes) -> int:
        """Collect whole records; they reach the file at the next `flush` or, where many wait, now. Raises OSError."""
        self._pending += data
        if len(self._pending) > MAX_PENDING_BYTES:
            self.flush()
        return len(data)

    def tell(self) -> int:
        """Bytes written and collected."""
        return self._written + len(self._pending)

    def flush(self) -> None:
        """Hand everything to the operating system. Raises OSError with the file cut back to its last whole record."""
        if self._closed or not self._pending:
            return
        data, done = bytes(self._pending), 0
        self._pending.clear()
        try:
            while done < len(data):
                done += os.write(self._descriptor, data[done:] if done else data)
        except OSError:
            self._cut_back()
            raise
        self._written += done

    def sync(self) -> None:
        """Wait until the disk has it. Raises OSError."""
        os.fsync(self._descriptor)

    def close(self) -> None:
        """Flush and close. Raises OSError."""
        if self._closed:
            return
        try:
            self.flush()
        finally:
            self._closed = True
            os.close(self._descriptor)

    def abandon(self) -> None:
        """Close without writing what is collected: the disk is full."""
        self._pending.clear()
        self.close()

    def _cut_back(self) -> None:
        try:
            os.ftruncate(self._descriptor, self._written)
        except OSError:
            return  # a device: it has no end to cut
