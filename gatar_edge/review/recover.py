"""Saves what can be read of a log into a complete file that every reader opens, and says what was lost."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Metadata, Schema
from mcap.writer import CompressionType, Writer

from gatar_edge.errors import LogError
from gatar_edge.record import CHUNK_BYTES, FLUSH_NS
from gatar_edge.review.container import RECORD, chunk_span, parse, unpack_chunk
from gatar_edge.review.reader import LogReader
from gatar_edge.review.whole import written_whole
from gatar_edge.types import NS_PER_S

MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time


@dataclass(slots=True)
class Recovered:
    """What was saved and what was not."""

    recovered: int = 0  # messages
    first_ns: int = -1
    last_ns: int = 0
    lost_bytes: int = 0
    lost_spans_ns: list[tuple[int, int]] = field(default_factory=list)  # of damaged chunks whose head was readable
    finished: bool = False
    places: list[tuple[int, str]] = field(default_factory=list)

    def to_json(self) -> dict[str, Any]:
        """For machines. `lost_s` is the most that can be missing: damaged spans, and the tail of a file without end."""
        spans = sum(end - start for start, end in self.lost_spans_ns) / NS_PER_S
        tail = 0.0 if self.finished else FLUSH_NS / NS_PER_S
        return {
            "recovered": self.recovered,
            "duration_s": round((self.last_ns - max(self.first_ns, 0)) / NS_PER_S, 3),
            "lost_s": round(spans + tail, 3),
            "lost_bytes": self.lost_bytes,
            "finished": self.finished,
            "damage": [{"byte": at, "why": why} for at, why in self.places],
        }


class _Copier:
    """Copies records into a new file. Channels and schemas are repeated where the file has them under new numbers."""

    def __init__(self, writer: Any) -> None:
        self._writer = writer
        self._schemas: dict[int, int] = {0: 0}
        self._channels: dict[int, int] = {}
        self.result = Recovered()

    def add(self, opcode: int, content: bytes) -> None:
        """One record. Raises LogError where it does not parse."""
        if opcode == Opcode.CHUNK:
            for inner, data in split_records(unpack_chunk(content)):
                self.add(inner, data)
        elif opcode == Opcode.SCHEMA:
            schema = parse(Schema.read, content)
            if schema.id not in self._schemas:
                self._schemas[schema.id] = self._writer.register_schema(schema.name, schema.encoding, schema.data)
        elif opcode == Opcode.CHANNEL:
            self._channel(parse(Channel.read, content))
        elif opcode == Opcode.MESSAGE:
            self._message(content)
        elif opcode == Opcode.ATTACHMENT:
            a = parse(Attachment.read, content)
            self._writer.add_attachment(a.create_time, a.log_time, a.name, a.media_type, a.data)
        elif opcode == Opcode.METADATA:
            metadata = parse(Metadata.read, content)
            self._writer.add_metadata(metadata.name, metadata.metadata)

    def _channel(self, channel: Channel) -> None:
        if channel.id not in self._channels and channel.schema_id in self._schemas:
            self._channels[channel.id] = self._writer.register_channel(
                channel.topic, channel.message_encoding, self._schemas[channel.schema_id], channel.metadata
            )

    def _message(self, content: bytes) -> None:
        if len(content) < MESSAGE.size:
            raise LogError("a message without a head")
        number, sequence, log_ns, publish_ns = MESSAGE.unpack_from(content)
        if number not in self._channels:
            raise LogError(f"a message of a channel {number} that is not described")
        self._writer.add_message(self._channels[number], log_ns, content[MESSAGE.size :], publish_ns, sequence)
        self.result.recovered += 1
        self.result.last_ns = max(self.result.last_ns, log_ns)
        if self.result.first_ns < 0:
            self.result.first_ns = log_ns


def recover(source: Path, output: Path) -> Recovered:
    """Copy what can be read of `source` to `output`, which appears only when it is complete. Raises LogError.

    Refuses only a file that is not ours, and to write over the damaged one.
    """
    log = LogReader(source, salvage=True)
    with written_whole(output, [source]) as stream:
        writer: Any = Writer(stream, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        writer.start(log.header.profile, log.header.library)
        result = _copy(log, _Copier(writer))
        writer.finish()
    return result


def _copy(log: LogReader, copier: _Copier) -> Recovered:
    result = copier.result
    for at, opcode, content in log.raw_records():
        try:
            copier.add(opcode, content)
        except LogError as error:
            log.damage.skipped.append((at, str(error)))
            result.lost_bytes += len(content)
            start, end = chunk_span(content) if opcode == Opcode.CHUNK else (0, 0)
            if 0 < start <= end:
                result.lost_spans_ns.append((start, end))
    damage = log.damage
    result.finished = damage.finished
    result.places = list(damage.skipped)
    if damage.cut_off_at is not None:
        result.places.append((damage.cut_off_at, "cut off"))
        result.lost_bytes += max(0, log.path.stat().st_size - damage.cut_off_at)
    return result


def split_records(data: bytes) -> Iterator[tuple[int, bytes]]:
    """The records of an unpacked chunk. Raises LogError where one reaches beyond its end."""
    at = 0
    while at + RECORD.size <= len(data):
        opcode, length = RECORD.unpack_from(data, at)
        after = at + RECORD.size + length
        if after > len(data):
            raise LogError("a message reaches beyond its chunk")
        yield opcode, data[at + RECORD.size : after]
        at = after
