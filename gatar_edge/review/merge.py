"""One log a robot -> one time line.

The clocks of companions differ. Every neighbour message carries its author's clock and is heard at a time of the
receiver's: the least difference each way, over all messages of a pair, is the least delay plus and minus the offset of
the clocks, so that half of the difference of the two is the offset (as NTP and TIMESYNC do it). Robots that never heard
each other both ways are placed through others. Records stay as they were written; only their log and publish times
move.
"""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Metadata, Schema
from mcap.writer import CompressionType, Writer

from gatar_edge import channels as ch
from gatar_edge.errors import LogError
from gatar_edge.record import CHUNK_BYTES
from gatar_edge.review.container import parse, unpack_chunk
from gatar_edge.review.info import RadioBrief, RadioBriefs
from gatar_edge.review.reader import LogReader, decoder
from gatar_edge.review.recover import MESSAGE, split_records
from gatar_edge.review.whole import written_whole

NS_PER_MS = 1_000_000
MAX_FILES = 64

_radio = decoder(RadioBriefs)


@dataclass(frozen=True, slots=True)
class Merged:
    """What came of a merge."""

    messages: int
    offsets_ns: dict[str, int]  # by file name: what was added to its times
    unplaced: tuple[str, ...]  # files whose clock could not be compared: their times are as written

    def to_json(self) -> dict[str, Any]:
        """For machines."""
        offsets = {name: round(offset / 1e9, 6) for name, offset in self.offsets_ns.items()}
        return {"messages": self.messages, "offsets_s": offsets, "unplaced": list(self.unplaced)}


class _Raw(NamedTuple):
    log_ns: int
    publish_ns: int
    source: int
    order: int
    topic: str
    encoding: str
    schema: Schema | None
    data: bytes


def merge(sources: Sequence[Path], output: Path) -> Merged:
    """Merge `sources` into `output`, which appears only when it is complete. Raises LogError."""
    if not 2 <= len(sources) <= MAX_FILES:
        raise LogError(f"merging takes 2 to {MAX_FILES} logs, got {len(sources)}")
    if len({path.resolve() for path in sources}) < len(sources):
        raise LogError("a log is given twice: each of its records would be there twice")
    logs = [LogReader(path) for path in sources]
    offsets, unplaced = clock_offsets(logs)
    with written_whole(output, sources) as stream:
        writer: Any = Writer(stream, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        writer.start(logs[0].header.profile, logs[0].header.library)
        _copy_attached(logs, offsets, writer)
        count = _copy_messages(logs, offsets, writer)
        writer.finish()
    names = [path.name for path in sources]
    if len(set(names)) < len(names):
        names = list(map(str, sources))
    return Merged(count, dict(zip(names, offsets, strict=True)), tuple(names[index] for index in unplaced))


def clock_offsets(logs: Sequence[LogReader]) -> tuple[list[int], list[int]]:
    """What to add to each log's times so that they agree with the first's, and the logs for which nothing is known.

    Several files of one robot, as its recorder rotates them, have one clock.
    """
    least: dict[tuple[int, int], int] = {}
    robot_of: dict[int, int] = {}
    for index, log in enumerate(logs):
        for entry in log.messages(lambda channel, _: channel is ch.RADIO):
            robot_of.setdefault(index, entry.robot_id)
            for item in _radio(entry.data).items:
                _take_delay(least, entry.robot_id, item)
    # delay = least + (clock here - clock there), back = least - (clock here - clock there)
    ahead = {
        (here, there): (delay_ns - least[there, here]) // 2
        for (here, there), delay_ns in least.items()
        if (there, here) in least
    }
    offsets = _spread(robot_of.get(0, 0), ahead)
    unplaced = [index for index in range(1, len(logs)) if robot_of.get(index) not in offsets]
    return [offsets.get(robot_of.get(index, 0), 0) for index in range(len(logs))], unplaced


def _take_delay(least: dict[tuple[int, int], int], here: int, item: RadioBrief) -> None:
    if item.way != ch.RadioWay.HEARD.value or item.hops != 0 or item.outcome not in ("accepted", "nearer"):
        return
    pair = (here, item.author)
    delay_ns = item.t_ns - item.sent_ms * NS_PER_MS
    least[pair] = min(delay_ns, least.get(pair, delay_ns))


def _spread(first: int, ahead: dict[tuple[int, int], int]) -> dict[int, int]:
    """What to add to each robot's clock, from the first's over all pairs that heard each other."""
    offsets = {first: 0}
    waiting = deque([first])
    while waiting:
        known = waiting.popleft()
        for (here, there), ahead_ns in ahead.items():
            if there == known and here not in offsets:
                offsets[here] = offsets[known] - ahead_ns
                waiting.append(here)
    return offsets


def _copy_attached(logs: Sequence[LogReader], offsets: Sequence[int], writer: Any) -> None:
    for log, offset in zip(logs, offsets, strict=True):
        for _, opcode, content in log.raw_records():
            if opcode == Opcode.ATTACHMENT:
                a = parse(Attachment.read, content)
                name = f"{log.path.stem}/{a.name}"
                writer.add_attachment(a.create_time, max(0, a.log_time + offset), name, a.media_type, a.data)
            elif opcode == Opcode.METADATA:
                metadata = parse(Metadata.read, content)
                writer.add_metadata(
                    metadata.name, {**metadata.metadata, "file": log.path.name, "offset_ns": str(offset)}
                )


def _copy_messages(logs: Sequence[LogReader], offsets: Sequence[int], writer: Any) -> int:
    schemas: dict[str, int] = {}
    channels: dict[str, int] = {}
    count = 0
    streams = [_raw_messages(log, index, offset) for index, (log, offset) in enumerate(zip(logs, offsets, strict=True))]
    for raw in heapq.merge(*streams, key=lambda raw: (raw.log_ns, raw.source, raw.order)):
        if raw.topic not in channels:
            name = raw.schema.name if raw.schema is not None else ""
            if raw.schema is not None and name not in schemas:
                schemas[name] = writer.register_schema(name, raw.schema.encoding, raw.schema.data)
            channels[raw.topic] = writer.register_channel(raw.topic, raw.encoding, schemas.get(name, 0))
        writer.add_message(channels[raw.topic], raw.log_ns, raw.data, raw.publish_ns)
        count += 1
    return count


def _raw_messages(log: LogReader, source: int, offset: int) -> Iterator[_Raw]:
    channels: dict[int, Channel] = {}
    schemas: dict[int, Schema] = {}
    order = 0
    for _, opcode, content in log.raw_records():
        inner = split_records(unpack_chunk(content)) if opcode == Opcode.CHUNK else iter([(opcode, content)])
        for kind, data in inner:
            if kind == Opcode.SCHEMA:
                schema = parse(Schema.read, data)
                schemas[schema.id] = schema
            elif kind == Opcode.CHANNEL:
                channel = parse(Channel.read, data)
                channels[channel.id] = channel
            elif kind == Opcode.MESSAGE and len(data) >= MESSAGE.size:
                number, _, log_ns, publish_ns = MESSAGE.unpack_from(data)
                about = channels.get(number)
                if about is None:
                    raise LogError(f"log {log.path} has a message of a channel that is not described")
                order += 1
                times = (max(0, log_ns + offset), max(0, publish_ns + offset))
                schema_of = schemas.get(about.schema_id)
                payload = data[MESSAGE.size :]
                yield _Raw(*times, source, order, about.topic, about.message_encoding, schema_of, payload)
