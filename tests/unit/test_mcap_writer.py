"""The log's writer writes what mcap's own would write."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from mcap.writer import CompressionType, Writer

from gatar_edge.logfile import RecordStream
from gatar_edge.mcap_writer import McapWriter

CHUNK_BYTES = 300


def write_ours(path: Path, messages: int) -> None:
    stream = RecordStream(path)
    writer = McapWriter(stream, CHUNK_BYTES)
    writer.start("p", "l")
    writer.add_metadata("m", {"key": "value"})
    writer.add_attachment(7, "a.json", "application/json", b"{}")
    fill(writer, messages)
    writer.finish()
    stream.close()


def write_theirs(path: Path, messages: int) -> None:
    with path.open("wb") as file:
        writer: Any = Writer(file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        writer.start("p", "l")
        writer.add_metadata("m", {"key": "value"})
        writer.add_attachment(7, 7, "a.json", "application/json", b"{}")
        fill(writer, messages)
        writer.finish()


def fill(writer: Any, messages: int) -> None:
    """Messages of all lengths on three channels, one of which begins late, and a flush between."""
    schema = writer.register_schema("s", "jsonschema", b"{" + bytes(200) + b"}")
    channels = [writer.register_channel(f"/{number}", "json", schema) for number in range(2)]
    for number in range(messages):
        if number == 20:
            channels.append(writer.register_channel("/late", "", writer.register_schema("t", "", b"")))
        if number % 13 == 0:
            writer.flush()
            writer.flush()
        writer.add_message(channels[number % len(channels)], 10 * number, bytes(number % 70), 10 * number + 3)


@pytest.mark.parametrize("messages", [0, 1, 100])
def test_a_file_is_byte_for_byte_what_the_writer_of_mcap_writes(tmp_path: Path, messages: int) -> None:
    write_ours(tmp_path / "ours", messages)
    write_theirs(tmp_path / "theirs", messages)
    assert (tmp_path / "ours").read_bytes() == (tmp_path / "theirs").read_bytes()
