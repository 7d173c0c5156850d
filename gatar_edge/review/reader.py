"""Reads the messages of a log in the order in which they were written.

Refused, with one clear line: what is foreign, of a later version, corrupt, cut off or empty. See `container` for how a
file may end.
"""

from __future__ import annotations

import re
import struct
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Header, Metadata

from gatar_edge import channels as ch
from gatar_edge.errors import LogError
from gatar_edge.review.container import RECORD, Container, Damage, parse, unpack_chunk

_MESSAGE = struct.Struct("<BQHIQQ")  # opcode, length, channel, sequence, log time, publish time
_MESSAGE_HEAD_BYTES = _MESSAGE.size - RECORD.size
_MAX_ATTACHMENTS = 1000

Wanted = Callable[[ch.Channel, int], bool]


class Entry(NamedTuple):
    """One message of a log."""

    channel: ch.Channel
    robot_id: int  # 0 where the topic is not of one robot
    log_ns: int
    publish_ns: int
    data: bytes


@dataclass(slots=True)
class Tally:
    """Counts of all messages that were passed, by the number of their channel."""

    counts: defaultdict[int, int] = field(default_factory=lambda: defaultdict(int))
    record_bytes: defaultdict[int, int] = field(default_factory=lambda: defaultdict(int))
    first_ns: int = -1
    last_ns: int = 0
    not_in_order: int = 0

    def add(self, number: int, length: int, log_ns: int) -> None:
        """One message's record."""
        self.counts[number] += 1
        self.record_bytes[number] += length
        if log_ns >= self.last_ns:
            self.last_ns = log_ns
            if self.first_ns < 0:
                self.first_ns = log_ns
        else:
            self.not_in_order += 1

    def payload(self, number: int) -> int:
        """Bytes of a channel's messages without their heads."""
        return self.record_bytes[number] - self.counts[number] * _MESSAGE_HEAD_BYTES


Accepted = dict[int, tuple[ch.Channel, int]]
_HOLDERS = frozenset((Opcode.CHUNK, Opcode.MESSAGE, Opcode.CHANNEL, Opcode.SCHEMA))


class LogReader:
    """One log file of ours; each method reads it anew. Raises LogError for a file that cannot be used."""

    def __init__(self, path: Path, *, salvage: bool = False) -> None:
        self._container = Container(path, salvage)
        self._known: dict[int, tuple[ch.Channel, int] | None] = {}
        self._learned = True
        self.path = path
        self.header = self._check_header()

    @property
    def damage(self) -> Damage:
        """What was wrong with the file in the last pass over it."""
        return self._container.damage

    def messages(self, wanted: Wanted | None = None, tally: Tally | None = None) -> Iterator[Entry]:
        """All messages of our topics, or those of the channels that `wanted` accepts; `tally` counts all of them."""
        accepted: Accepted = {}
        self._learned = True
        for at, opcode, content in self._container.records():
            if opcode not in _HOLDERS:
                continue
            try:
                data = unpack_chunk(content) if opcode == Opcode.CHUNK else RECORD.pack(opcode, len(content)) + content
            except LogError as error:
                self._container.corrupt(at, str(error))
                continue
            yield from self._unpacked(at, data, accepted, wanted, tally)

    def run_info(self) -> dict[str, Any]:
        """The first run info of the log. Raises LogError where there is none."""
        for entry in self.messages(lambda channel, _: channel is ch.RUN_INFO):
            return json_object(entry.data)
        raise LogError(f"log {self.path} does not say what flew: it ended before its first second")

    def attachments(self) -> list[Attachment]:
        """All attachments."""
        return [parse(Attachment.read, content) for content in self._contents(Opcode.ATTACHMENT)]

    def metadata(self) -> list[Metadata]:
        """All metadata records."""
        return [parse(Metadata.read, content) for content in self._contents(Opcode.METADATA)]

    def raw_records(self) -> Iterator[tuple[int, int, bytes]]:
        """Place, opcode and content of all records."""
        return self._container.records()

    def _contents(self, wanted: int) -> list[bytes]:
        found = [content for _, opcode, content in self._container.records() if opcode == wanted]
        if len(found) > _MAX_ATTACHMENTS:
            raise LogError(
                f"log {self.path} has {len(found)} attachments or metadata, at most {_MAX_ATTACHMENTS} are read"
            )
        return found

    def _unpacked(
        self, place: int, data: bytes, accepted: Accepted, wanted: Wanted | None, tally: Tally | None
    ) -> Iterator[Entry]:
        at, end = 0, len(data)
        while at + RECORD.size <= end:
            opcode, length, number, _, log_ns, publish_ns = _message_at(data, at)
            after = at + RECORD.size + length
            if after > end:
                self._container.corrupt(place, "a message reaches beyond its chunk")
                return
            if opcode == Opcode.MESSAGE and length >= _MESSAGE_HEAD_BYTES:
                if self._learned:
                    self._accept(accepted, wanted)
                if tally is not None:
                    tally.add(number, length, log_ns)
                known = accepted.get(number)
                if known is not None:
                    yield Entry(known[0], known[1], log_ns, publish_ns, data[at + _MESSAGE.size : after])
            elif opcode == Opcode.CHANNEL:
                channel = parse(Channel.read, data[at + RECORD.size : after])
                self._known[channel.id] = ch.parse_topic(channel.topic)
                self._learned = True
            at = after

    def _accept(self, accepted: Accepted, wanted: Wanted | None) -> None:
        """Which channels are wanted, asked once for each channel and not for each message."""
        self._learned = False
        for number, known in self._known.items():
            if known is not None and (wanted is None or wanted(*known)):
                accepted[number] = known

    def topic_of(self, number: int) -> str:
        """The table's topic of a channel's number in this file, for a `Tally`."""
        known = self._known.get(number)
        return "" if known is None else known[0].topic

    def _check_header(self) -> Header:
        first = next(self._container.records(), None)
        if first is None or first[1] != Opcode.HEADER:
            raise LogError(f"log {self.path} has no header: nothing of it was written")
        header: Header = parse(Header.read, first[2])
        match = re.fullmatch(rf"{ch.PROFILE}-(\d{{1,9}})", header.profile)
        if match is None:
            writer = header.library[:60] or "an unknown program"
            raise LogError(f"{self.path} was written by {writer}, not by gatar-edge")
        if int(match[1]) > ch.FORMAT:
            raise LogError(
                f"log {self.path} is of format {match[1]}, this program reads up to {ch.FORMAT}: update gatar-edge"
            )
        return header


def _message_at(data: bytes, at: int) -> tuple[int, int, int, int, int, int]:
    """Opcode, length, and what stands where a message has its head; zeros behind the end of the data."""
    if at + _MESSAGE.size <= len(data):
        return _MESSAGE.unpack_from(data, at)
    return (*RECORD.unpack_from(data, at), 0, 0, 0, 0)


def json_object(data: bytes) -> dict[str, Any]:
    """A JSON message without fixed fields. Raises LogError where it is none."""
    try:
        return msgspec.json.decode(data, type=dict[str, Any])
    except msgspec.MsgspecError as error:
        raise LogError(f"a message is no JSON object: {error}") from error


def decoder(kind: type[Any]) -> Callable[[bytes], Any]:
    """A decoder of JSON messages into `kind`, whose errors are LogError."""
    inner = msgspec.json.Decoder(kind)

    def decode(data: bytes) -> Any:
        try:
            return inner.decode(data)
        except msgspec.MsgspecError as error:
            raise LogError(f"a message is not as {kind.__name__} should be: {error}") from error

    return decode
