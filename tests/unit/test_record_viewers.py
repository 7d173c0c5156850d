"""What general viewers make of a log: schemas that travel with it, and a layout that names topics which exist."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.reader import make_reader
from missions import record_mission

from gatar_edge import channels as ch

LAYOUT = Path(__file__).resolve().parents[2] / "examples" / "foxglove" / "gatar-layout.json"


def strings_of(node: Any) -> list[str]:
    if isinstance(node, dict):
        return [text for key, value in node.items() for text in (key, *strings_of(value))]
    if isinstance(node, list):
        return [text for value in node for text in strings_of(value)]
    return [node] if isinstance(node, str) else []


def fields_exist(schema: dict[str, Any], path: list[str]) -> bool:
    for name in path:
        schema = schema.get("properties", {}).get(name, {})
    return bool(schema)


def test_protobuf_messages_are_read_with_the_schema_in_the_file_alone(tmp_path: Path) -> None:
    record_mission(tmp_path / "a.mcap", steps=6)
    seen = set()
    with (tmp_path / "a.mcap").open("rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages():
            if channel.message_encoding != "protobuf" or schema is None:
                continue
            pool = descriptor_pool.DescriptorPool()
            for file in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
                pool.Add(file)
            kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))
            assert kind.FromString(message.data).ByteSize() > 0
            seen.add(schema.name)
    assert {"foxglove.Grid", "foxglove.RawImage", "foxglove.SceneUpdate", "foxglove.FrameTransform"} <= seen


def test_every_topic_and_field_of_the_layout_exists() -> None:
    layout = json.loads(LAYOUT.read_text())
    paths = [text for text in strings_of(layout["configById"]) if re.match(r"/(robot|map|scene|truth|log)\b", text)]
    assert len(paths) > 20
    for path in paths:
        topic, *fields = path.split(".")
        known = ch.parse_topic(topic)
        assert known is not None, path
        assert fields_exist(ch.json_schema(known[0]), fields) or not fields, path


def test_every_panel_of_the_layout_is_configured() -> None:
    layout = json.loads(LAYOUT.read_text())
    shown = [text for text in strings_of(layout["layout"]) if "!" in text]
    assert sorted(shown) == sorted(layout["configById"])
