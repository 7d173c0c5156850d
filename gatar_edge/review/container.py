"""The MCAP container, record by record, in bounded memory, however the file ended.

complete    has its footer
unfinished  ends between two records: still being written, or its writer was killed; all that is there is read
cut off     ends within a record: refused, unless salvaging, with the place and what to do
corrupt     a checksum or a length is wrong: refused, or skipped up to the next chunk when salvaging
"""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, TypeVar

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode

from gatar_edge.errors import LogError

MAX_RECORD_BYTES = 64 * 1024 * 1024
MAX_CHUNK_BYTES = 256 * 1024 * 1024
MAGIC = b"\x89MCAP0\r\n"
RECORD = struct.Struct("<BQ")  # opcode, length

_CHUNK = struct.Struct("<QQQII")  # start, end, unpacked size, its checksum, length of the compression's name
_CHUNK_NAME = b"\x04\x00\x00\x00zstd"  # stands at this distance from the start of a chunk's record:
_CHUNK_NAME_AT = RECORD.size + _CHUNK.size - 4
_FOOTER_BYTES = 20
_SEARCH_BYTES = 1024 * 1024

T = TypeVar("T")


@dataclass(slots=True)
class Damage:
    """What was wrong with a file, as far as it has been read."""

    skipped: list[tuple[int, str]] = field(default_factory=list)  # byte, and why
    cut_off_at: int | None = None
    finished: bool = False

    @property
    def any(self) -> bool:
        """Whether anything is missing that was written."""
        return bool(self.skipped) or self.cut_off_at is not None


@dataclass(slots=True)
class Container:
    """One file. `salvage` notes damage and goes on where else LogError would be raised."""

    path: Path
    salvage: bool = False
    damage: Damage = field(default_factory=Damage)

    def records(self) -> Iterator[tuple[int, int, bytes]]:
        """Place, opcode and content of all records up to the end of the data."""
        self.damage = Damage()
        with self._open() as stream:
            self._check_magic(stream)
            while (record := self._next(stream)) is not None:
                if record[1] == Opcode.DATA_END:  # what follows repeats what was read
                    self._check_end(stream)
                    return
                yield record

    def corrupt(self, at: int, why: str) -> None:
        """Note damage, or refuse."""
        self.damage.skipped.append((at, why))
        if not self.salvage:
            raise LogError(
                f"log {self.path} is corrupt at byte {at} ({why}): `gatar log recover {self.path}` saves what it can"
            )

    def _next(self, stream: IO[bytes]) -> tuple[int, int, bytes] | None:
        while True:
            at = stream.tell()
            head = stream.read(RECORD.size)
            if not head:
                return None
            if len(head) < RECORD.size:
                self._cut_off(at)
                return None
            opcode, length = RECORD.unpack(head)
            if 0 < opcode <= Opcode.DATA_END and length <= MAX_RECORD_BYTES:
                content = stream.read(length)
                if len(content) < length:
                    self._cut_off(at)
                    return None
                return at, opcode, content
            self.corrupt(at, f"record of type {opcode} and {length} bytes")
            if not self._seek_chunk(stream, at + 1):
                return None

    def _seek_chunk(self, stream: IO[bytes], start: int) -> bool:
        """Go to the next place that looks like the start of a chunk."""
        stream.seek(start)
        window = b""
        while block := stream.read(_SEARCH_BYTES):
            window = window[-_CHUNK_NAME_AT - len(_CHUNK_NAME) :] + block
            found = window.find(_CHUNK_NAME, _CHUNK_NAME_AT)
            while found >= 0:
                place = found - _CHUNK_NAME_AT
                if window[place] == Opcode.CHUNK:
                    stream.seek(stream.tell() - len(window) + place)
                    return True
                found = window.find(_CHUNK_NAME, found + 1)
        return False

    def _check_end(self, stream: IO[bytes]) -> None:
        at = stream.tell()
        tail = RECORD.size + _FOOTER_BYTES + len(MAGIC)
        size = stream.seek(0, io.SEEK_END)
        stream.seek(max(at, size - tail))
        end = stream.read(tail)
        self.damage.finished = end[:1] == bytes((Opcode.FOOTER,)) and end.endswith(MAGIC)
        if not self.damage.finished:
            self._cut_off(size)

    def _cut_off(self, at: int) -> None:
        self.damage.cut_off_at = at
        if not self.salvage:
            raise LogError(
                f"log {self.path} is cut off at byte {at}: `gatar log recover {self.path}` saves what is before it"
            )

    def _open(self) -> IO[bytes]:
        try:
            return self.path.open("rb", buffering=1024 * 1024)
        except OSError as error:
            raise LogError(f"log {self.path} cannot be read: {error.strerror}") from error

    def _check_magic(self, stream: IO[bytes]) -> None:
        try:
            magic = stream.read(len(MAGIC))
        except OSError as error:
            raise LogError(f"log {self.path} cannot be read: {error.strerror}") from error
        if not magic:
            raise LogError(f"log {self.path} is empty")
        if magic[:5] == MAGIC[:5] and magic[6:] == MAGIC[6:] and magic > MAGIC:
            version = magic[5:6].decode("ascii", "replace")
            raise LogError(f"log {self.path} is of MCAP version {version}, this program reads 0: update gatar-edge")
        if magic != MAGIC:
            raise LogError(f"{self.path} is no MCAP file")


def unpack_chunk(content: bytes) -> bytes:
    """The records of a chunk, checked. Raises LogError saying what is wrong."""
    if len(content) < _CHUNK.size:
        raise LogError("a chunk without a head")
    _, _, size, checksum, name_length = _CHUNK.unpack_from(content)
    name = content[_CHUNK.size : _CHUNK.size + name_length]
    packed = content[_CHUNK.size + name_length + 8 :]
    if size > MAX_CHUNK_BYTES:
        raise LogError(f"a chunk of {size} bytes exceeds {MAX_CHUNK_BYTES}")
    if name == b"zstd":
        try:
            data = zstandard.ZstdDecompressor().decompress(packed, max_output_size=size)
        except zstandard.ZstdError as error:
            raise LogError(f"a chunk does not unpack: {error}") from error
    elif name == b"":
        data = packed
    else:
        raise LogError(f"a chunk is packed with {name[:20]!r}, known are zstd and none")
    if len(data) != size or (checksum and zlib.crc32(data) != checksum):
        raise LogError("a chunk's checksum is wrong")
    return data


def chunk_span(content: bytes) -> tuple[int, int]:
    """First and last log time in a chunk's content, without unpacking it; zeros where the head is damaged."""
    if len(content) < _CHUNK.size:
        return 0, 0
    start, end, *_ = _CHUNK.unpack_from(content)
    return start, end


def parse(read: Callable[[ReadDataStream], T], content: bytes) -> T:
    """A record from its content by one of mcap's `read` functions. Raises LogError where it is none."""
    try:
        return read(ReadDataStream(io.BytesIO(content)))
    except (McapError, struct.error, ValueError, OverflowError, MemoryError) as error:
        raise LogError(f"a record does not parse: {error}") from error
