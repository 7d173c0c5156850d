"""Every topic of a mission log in one table: its name, encoding, schema, rate and meaning.

The recorder writes no topic that is not here, and the review reads by these names. What people look at in a viewer
(map, scene, positions, log lines) is foxglove protobuf; our own records are JSON with a JSON Schema made from the
types below; MAVLink frames are raw bytes. `{id}` stands for a robot's number.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import msgspec

from gatar_edge.types import Decision, TaskKind, VehicleState

FORMAT = 1  # of the log as a whole: raised when an older reader would misread it
PROFILE = "gatar"  # the MCAP header's profile is PROFILE-FORMAT


class Encoding(StrEnum):
    """How a topic's messages are written, by the name in the MCAP registry."""

    JSON = "json"
    PROTOBUF = "protobuf"
    MAVLINK = "mavlink"


class RadioWay(StrEnum):
    """What happened to a datagram at one robot."""

    HEARD = "heard"
    SENT = "sent"


class ObservationRecord(msgspec.Struct, frozen=True):
    """What a robot saw. Cells are flat: x0, y0, x1, y1, ..."""

    robot_id: int
    kind: int  # RobotKind
    cell: tuple[int, int]
    t_ns: int
    seen: list[int]
    obstacles: list[int]
    targets: list[int]


class RadioItem(msgspec.Struct, frozen=True, omit_defaults=True):
    """One datagram that was sent, news, or refused. `data` is base64, left out of what was refused."""

    t_ns: int  # of arrival or departure, local clock
    way: RadioWay
    outcome: str = ""  # HearOutcome of a heard datagram
    author: int = -1
    seq: int = -1
    talk: bool = False  # between allocators: see `talk`
    hops: int = -1
    sent_ms: int = -1  # the author's clock
    cell: tuple[int, int] | None = None
    task: TaskKind | None = None
    task_cell: tuple[int, int] | None = None
    cost: float = -1.0  # cells of way that the author still has to its task
    size: int = 0  # bytes on the air
    data: str = ""


class RadioRecord(msgspec.Struct, frozen=True):
    """The datagrams of one robot since its last record, in the order in which its agent met them.

    Those that have no effect on what a robot knows or says are only counted.
    """

    robot_id: int
    items: list[RadioItem]
    ignored: dict[str, int] = {}  # heard and ignored, by outcome: duplicates, own ones come back, too many hops
    relayed: int = 0
    relayed_bytes: int = 0


class DecisionRecord(msgspec.Struct, frozen=True):
    """One decision, the command it asked for, and the one that the safety gate let through."""

    decision: Decision
    wanted: dict[str, Any]
    sent: dict[str, Any]


class HeardRecord(msgspec.Struct, frozen=True):
    """The newest message of one author."""

    heard_ns: int
    data: str  # base64, without a signature


class MemoryRecord(msgspec.Struct, frozen=True):
    """What an agent remembered when its log went on in another file: see `agent.Memory`."""

    next_seq: int
    ticks: int
    takes_part: bool
    observation: ObservationRecord | None
    neighbors: list[HeardRecord]


class AgentStateRecord(msgspec.Struct, frozen=True):
    """What an agent starts with that takes over from an earlier one: see `persist.SavedState`.

    `memory` is there at the beginning of a later file of one run, and not after a restart.
    """

    robot_id: int
    width: int
    height: int
    belief: str  # base64 of zlib of uint8 [width, height]
    task_kind: TaskKind
    task_cell: tuple[int, int]
    task_path: list[tuple[int, int]]
    memory: MemoryRecord | None = None
    changes: int = 0


class VehicleRecord(msgspec.Struct, frozen=True):
    """What the bridge knew of its autopilot."""

    robot_id: int
    state: VehicleState


class Position(msgspec.Struct, frozen=True):
    """True place of a robot in cells: whole numbers are centres of cells."""

    robot_id: int
    x: float
    y: float


class PositionsRecord(msgspec.Struct, frozen=True):
    """Where all robots truly were (simulator only)."""

    robots: list[Position]


class VisitRecord(msgspec.Struct, frozen=True):
    """A target was localized (simulator only)."""

    robot_id: int
    cell: tuple[int, int]
    step: float


class FaultRecord(msgspec.Struct, frozen=True):
    """A fault was injected or ended (simulator only); `robot_id` 0 means all."""

    kind: str
    robot_id: int
    details: dict[str, Any]


class HealthRecord(msgspec.Struct, frozen=True):
    """The recorder's own figures so far."""

    messages: int
    bytes_written: int
    clock_steps_back: int  # how often `now_ns` was earlier than the message before


@dataclass(frozen=True, slots=True)
class Channel:
    """One topic, or one per robot where the name holds `{id}`."""

    topic: str
    encoding: Encoding
    schema: str
    rate: str
    meaning: str
    record: type[msgspec.Struct] | None = None  # of JSON topics; None: an object without fixed fields

    @property
    def per_robot(self) -> bool:
        """Whether each robot has its own."""
        return "{id}" in self.topic

    def of(self, robot_id: int) -> str:
        """The topic of one robot."""
        return self.topic.format(id=robot_id)


_JSON, _PROTO = Encoding.JSON, Encoding.PROTOBUF
RUN_INFO = Channel(
    "/run/info", _JSON, "gatar.RunInfo", "start, then 30 s", "configuration, model, versions of this run"
)
RESULT = Channel("/run/result", _JSON, "gatar.Result", "end", "the mission's figures, as the command printed them")
HEALTH = Channel("/run/health", _JSON, "gatar.Health", "5 s", "what the recorder wrote", HealthRecord)
OBSERVATION = Channel(
    "/robot/{id}/observation", _JSON, "gatar.Observation", "tick", "what the robot saw", ObservationRecord
)
RADIO = Channel("/robot/{id}/radio", _JSON, "gatar.Radio", "tick", "datagrams heard and sent", RadioRecord)
DECISION = Channel(
    "/robot/{id}/decision", _JSON, "gatar.Decision", "tick", "what was decided, on what, and why", DecisionRecord
)
AGENT_STATE = Channel(
    "/robot/{id}/state",
    _JSON,
    "gatar.AgentState",
    "restart, new file",
    "what it took over from before",
    AgentStateRecord,
)
VEHICLE = Channel("/robot/{id}/vehicle", _JSON, "gatar.Vehicle", "tick", "what the bridge knows", VehicleRecord)
MAVLINK_RX = Channel(
    "/robot/{id}/mavlink/rx", Encoding.MAVLINK, "mavlink.frame", "each frame", "frames from the autopilot"
)
MAVLINK_TX = Channel(
    "/robot/{id}/mavlink/tx", Encoding.MAVLINK, "mavlink.frame", "each frame", "frames to the autopilot"
)
BELIEF = Channel("/robot/{id}/belief", _PROTO, "foxglove.Grid", "change, and 2 s", "CellState of each cell it knows")
FIX = Channel("/robot/{id}/fix", _PROTO, "foxglove.LocationFix", "tick", "the vehicle's position on the Earth")
FRAME = Channel(
    "/robot/{id}/frame", _PROTO, "foxglove.FrameTransform", "tick", "the robot's place on the map, in metres"
)
SCENE = Channel("/scene", _PROTO, "foxglove.SceneUpdate", "tick, map 2 s", "robots, paths, targets, obstacles in 3D")
MAP = Channel("/map", _PROTO, "foxglove.Grid", "2 s", "CellState of each cell that anybody knows")
MAP_IMAGE = Channel("/map/image", _PROTO, "foxglove.RawImage", "2 s", "the same as a picture, north up")
LOG = Channel("/log", _PROTO, "foxglove.Log", "event", "log lines")
TRUTH_MAP = Channel("/truth/map", _PROTO, "foxglove.Grid", "2 s", "CellState as it truly is (simulator)")
TRUTH_ROBOTS = Channel("/truth/robots", _JSON, "gatar.Positions", "tick", "true places (simulator)", PositionsRecord)
TRUTH_VISITS = Channel("/truth/visits", _JSON, "gatar.Visit", "event", "targets localized (simulator)", VisitRecord)
FAULTS = Channel("/faults", _JSON, "gatar.Fault", "event", "faults injected (simulator)", FaultRecord)

CHANNELS = (
    RUN_INFO, RESULT, HEALTH, OBSERVATION, RADIO, DECISION, AGENT_STATE, VEHICLE, MAVLINK_RX, MAVLINK_TX, BELIEF, FIX,
    FRAME, SCENE, MAP, MAP_IMAGE, LOG, TRUTH_MAP, TRUTH_ROBOTS, TRUTH_VISITS, FAULTS,
)  # fmt: skip

_ROBOT_TOPIC = re.compile(r"/robot/(\d{1,5})(/.+)")
_BY_NAME = {channel.topic: channel for channel in CHANNELS}


def parse_topic(topic: str) -> tuple[Channel, int] | None:
    """Channel and robot (0 where not of one robot) of a topic's name; None for a topic that is not ours."""
    match = _ROBOT_TOPIC.fullmatch(topic)
    channel = _BY_NAME.get(f"/robot/{{id}}{match[2]}" if match else topic)
    return None if channel is None else (channel, int(match[1]) if match else 0)


def json_schema(channel: Channel) -> dict[str, Any]:
    """The JSON Schema of a JSON topic, without references and unions: viewers build their message paths from it."""
    if channel.record is None:
        return {"title": channel.schema, "description": channel.meaning, "type": "object", "properties": {}}
    schema = msgspec.json.schema(channel.record)
    plain: dict[str, Any] = _plain(schema, schema.get("$defs", {}))
    return {**plain, "title": channel.schema, "description": channel.meaning}


def _plain(node: Any, definitions: Mapping[str, Any]) -> Any:
    """`node` with references resolved, `X or null` as X, and tuples as arrays of their first item."""
    if isinstance(node, list):
        return [_plain(item, definitions) for item in node]
    if not isinstance(node, dict):
        return node
    if "$ref" in node:
        return _plain(definitions[node["$ref"].rsplit("/", 1)[1]], definitions)
    if "anyOf" in node:
        return _plain(next(option for option in node["anyOf"] if option.get("type") != "null"), definitions)
    plain = {key: _plain(value, definitions) for key, value in node.items() if key not in ("$defs", "default")}
    if "enum" in plain:
        plain["type"] = "string" if isinstance(plain["enum"][0], str) else "integer"
    if "prefixItems" in plain:
        plain = {"type": "array", "items": plain["prefixItems"][0]}
    return plain
