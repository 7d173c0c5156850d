"""An MCAP file as `mcap.writer.Writer` writes it with chunks, Zstandard and checksums, byte for byte, at a part of its
cost: what comes once a message, the message and its place in the index, is packed in one go.

The rare records are mcap's own. Log times must not go back. https://mcap.dev/spec
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, Protocol

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC

_MESSAGE = struct.Struct("<BQHIQQ")  # opcode, length, channel, sequence, log time, publish time; then the data
_BEFORE_DATA = _MESSAGE.size - 9  # of what the length counts
_MESSAGE_INDEX = int(Opcode.MESSAGE_INDEX)
_FOOTER_HEAD = struct.Struct("<BQQQ")


class Stream(Protocol):
    """What is written to."""

    def write(self, data: bytes) -> int: ...
    def tell(self) -> int: ...
    def flush(self) -> None: ...


class McapWriter:
    """Call `start`, then what you like, then `finish`. Raises what the stream raises."""

    def __init__(self, stream: Stream, chunk_bytes: int) -> None:
        self._stream = stream
        self._chunk_bytes = chunk_bytes
        self._compress = zstandard.ZstdCompressor().compress
        self._parts: list[bytes] = []  # of the chunk in progress
        self._size = 0  # of these together
        self._index: dict[int, list[int]] = {}  # by channel: log time, offset in the chunk, of each message in turn
        self._start_ns = self._end_ns = 0  # log times of the chunk's first and last message
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._chunks: list[ChunkIndex] = []
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._counts: dict[int, int] = {}  # messages by channel

    def start(self, profile: str, library: str) -> None:
        """Begin the file."""
        self._stream.write(MCAP0_MAGIC + _packed(Header(profile, library)))

    def add_metadata(self, name: str, metadata: dict[str, str]) -> None:
        """Write key-value pairs."""
        offset, data = self._stream.tell(), _packed(Metadata(name=name, metadata=metadata))
        self._metadata.append(MetadataIndex(offset=offset, length=len(data), name=name))
        self._stream.write(data)

    def add_attachment(self, t_ns: int, name: str, media_type: str, data: bytes) -> None:
        """Write an attachment, of time `t_ns`."""
        attachment = Attachment(create_time=t_ns, log_time=t_ns, name=name, media_type=media_type, data=data)
        offset, packed = self._stream.tell(), _packed(attachment)
        self._attachments.append(AttachmentIndex(offset, len(packed), t_ns, t_ns, len(data), name, media_type))
        self._stream.write(packed)

    def register_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Number a schema."""
        schema = Schema(id=len(self._schemas) + 1, data=data, encoding=encoding, name=name)
        self._schemas.append(schema)
        self._add(_packed(schema))
        return schema.id

    def register_channel(self, topic: str, encoding: str, schema_id: int) -> int:
        """Number a topic."""
        channel = Channel(len(self._channels) + 1, topic, encoding, {}, schema_id)
        self._channels.append(channel)
        self._add(_packed(channel))
        return channel.id

    def add_message(self, channel_id: int, log_ns: int, data: bytes, publish_ns: int) -> None:
        """Add a message, to the chunk in progress."""
        index = self._index
        if not index:
            self._start_ns = log_ns
        self._end_ns = log_ns
        if channel_id in index:
            index[channel_id] += (log_ns, self._size)
        else:
            index[channel_id] = [log_ns, self._size]
        length = _BEFORE_DATA + len(data)
        self._parts += (_MESSAGE.pack(5, length, channel_id, 0, log_ns, publish_ns), data)
        self._size += 9 + length
        if self._size > self._chunk_bytes:
            self._finish_chunk()

    def flush(self) -> None:
        """End the chunk in progress and flush the stream."""
        self._finish_chunk()
        self._stream.flush()

    def finish(self) -> None:
        """Write the summary: the file is complete."""
        self._finish_chunk()
        self._stream.write(_packed(DataEnd(0)))
        self._stream.write(self._summary(self._stream.tell()) + MCAP0_MAGIC)

    def _add(self, record: bytes) -> None:
        self._parts.append(record)
        self._size += len(record)
        if self._size > self._chunk_bytes:
            self._finish_chunk()

    def _finish_chunk(self) -> None:
        if not self._index:
            return
        data = b"".join(self._parts)
        packed = self._compress(data)
        chunk = Chunk("zstd", packed, self._end_ns, self._start_ns, zlib.crc32(data), len(data))
        offset, record = self._stream.tell(), _packed(chunk)
        offsets, indexes, at = {}, [], offset + len(record)
        for channel_id, entries in self._index.items():
            self._counts[channel_id] = self._counts.get(channel_id, 0) + len(entries) // 2
            offsets[channel_id] = at
            indexes.append(_packed_index(channel_id, entries))
            at += len(indexes[-1])
        self._chunks.append(
            ChunkIndex(
                chunk_length=len(record),
                chunk_start_offset=offset,
                compression="zstd",
                compressed_size=len(packed),
                message_end_time=self._end_ns,
                message_index_length=at - offset - len(record),
                message_index_offsets=offsets,
                message_start_time=self._start_ns,
                uncompressed_size=len(data),
            )
        )
        self._parts, self._size, self._index = [], 0, {}
        self._stream.write(record + b"".join(indexes))

    def _summary(self, start: int) -> bytes:
        builder: Any = RecordBuilder()  # partly untyped
        groups: Any = RecordBuilder()
        for opcode, records in self._summary_groups():
            before = builder.count
            for record in records:
                record.write(builder)
            SummaryOffset(opcode, start + before, builder.count - before).write(groups)
        offsets_start = start + builder.count
        data: bytes = builder.end() + groups.end()
        crc = zlib.crc32(_FOOTER_HEAD.pack(Opcode.FOOTER, 20, start, offsets_start), zlib.crc32(data))
        return data + _packed(Footer(start, offsets_start, crc))

    def _summary_groups(self) -> list[tuple[Opcode, Sequence[McapRecord]]]:
        statistics = Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=len(self._chunks),
            message_count=sum(self._counts.values()),
            message_end_time=self._end_ns,
            message_start_time=self._chunks[0].message_start_time if self._chunks else 0,
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )
        return [
            (Opcode.SCHEMA, self._schemas),
            (Opcode.CHANNEL, self._channels),
            (Opcode.STATISTICS, [statistics]),
            (Opcode.CHUNK_INDEX, self._chunks),
            (Opcode.ATTACHMENT_INDEX, self._attachments),
            (Opcode.METADATA_INDEX, self._metadata),
        ]


def _packed(record: McapRecord) -> bytes:
    builder: Any = RecordBuilder()  # partly untyped
    record.write(builder)
    data: bytes = builder.end()
    return data


def _packed_index(channel_id: int, entries: list[int]) -> bytes:
    size = 8 * len(entries)
    return _index_layout(len(entries)).pack(_MESSAGE_INDEX, 6 + size, channel_id, size, *entries)


@lru_cache(maxsize=256)  # most topics have a few messages in each chunk
def _index_layout(entries: int) -> struct.Struct:
    return struct.Struct(f"<BQHI{entries}Q")
