"""What viewers show: foxglove protobuf messages built from our values.

One frame, `map`: metres from the outer south-west corner of cell (0, 0), x and y along the grid's axes.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import IntEnum
from functools import lru_cache
from typing import Any

import numpy as np
from foxglove_schemas_protobuf import (
    Color_pb2,
    CubePrimitive_pb2,
    FrameTransform_pb2,
    Grid_pb2,
    LinePrimitive_pb2,
    LocationFix_pb2,
    Log_pb2,
    PackedElementField_pb2,
    Pose_pb2,
    Quaternion_pb2,
    RawImage_pb2,
    SceneEntity_pb2,
    SceneUpdate_pb2,
    SpherePrimitive_pb2,
    Vector2_pb2,
    Vector3_pb2,
)
from google.protobuf.descriptor import FileDescriptor
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.message import DecodeError
from google.protobuf.timestamp_pb2 import Timestamp

from gatar_edge.errors import LogError
from gatar_edge.types import (
    NS_PER_S,
    BoolGrid,
    ByteGrid,
    Cell,
    CellState,
    Decision,
    GridSpec,
    RobotKind,
    TaskKind,
    VehicleState,
)

MAP_FRAME = "map"
_UPRIGHT = Quaternion_pb2.Quaternion(w=1.0)
# Okabe and Ito's colours, told apart by the colour-blind too.
_RGB = {
    CellState.UNKNOWN: (222, 222, 220),
    CellState.FREE: (250, 250, 248),
    CellState.OBSTACLE: (70, 76, 84),
    CellState.TARGET: (230, 159, 0),
    CellState.LOCALIZED: (0, 158, 115),
}
_ROBOT_RGB = {RobotKind.UAV: (0, 114, 178), RobotKind.UGV: (213, 94, 0)}
_PALETTE = np.array([_RGB[state] for state in CellState], dtype=np.uint8)


class Level(IntEnum):
    """Weight of a log line, as foxglove.Log numbers it."""

    DEBUG = 1
    INFO = 2
    WARNING = 3
    ERROR = 4


@dataclass(frozen=True, slots=True)
class LogLine:
    """A decoded foxglove.Log."""

    level: int
    name: str
    text: str


@dataclass(frozen=True, slots=True)
class GridMessage:
    """A decoded foxglove.Grid of cell states: uint8 [W, H]."""

    cells: ByteGrid
    cell_m: float


_LEVELS = {level: Log_pb2.Log.Level.Value(level.name) for level in Level}

MESSAGES: dict[str, Any] = {
    "foxglove.Grid": Grid_pb2.Grid,
    "foxglove.RawImage": RawImage_pb2.RawImage,
    "foxglove.SceneUpdate": SceneUpdate_pb2.SceneUpdate,
    "foxglove.LocationFix": LocationFix_pb2.LocationFix,
    "foxglove.FrameTransform": FrameTransform_pb2.FrameTransform,
    "foxglove.Log": Log_pb2.Log,
}


def descriptor_set(schema: str) -> bytes:
    """The serialized FileDescriptorSet of a schema, dependencies first: the schema data of an MCAP protobuf channel."""
    files: dict[str, FileDescriptor] = {}

    def collect(file: FileDescriptor) -> None:
        for dependency in file.dependencies:
            collect(dependency)
        files.setdefault(file.name, file)

    collect(MESSAGES[schema].DESCRIPTOR.file)
    result = FileDescriptorSet()
    for file in files.values():
        file.CopyToProto(result.file.add())
    return bytes(result.SerializeToString())


def grid(states: ByteGrid, spec: GridSpec, now_ns: int) -> bytes:
    """A foxglove.Grid of `states` [W, H]; row 0 is the southernmost."""
    message = Grid_pb2.Grid()
    message.CopyFrom(_grid(states.shape[0], spec.cell_m))
    _set_stamp(message.timestamp, now_ns)
    message.data = states.T.tobytes()
    return bytes(message.SerializeToString())


@lru_cache(maxsize=8)
def _grid(columns: int, cell_m: float) -> Any:
    """What `grid` serializes, but for its time and data. To be copied: a message that is kept keeps all bytes that its
    fields ever held, so that one used for every map would grow with each.
    """
    field = PackedElementField_pb2.PackedElementField
    return Grid_pb2.Grid(
        frame_id=MAP_FRAME,
        pose=_pose(0.0, 0.0, 0.0),
        column_count=columns,
        cell_size=Vector2_pb2.Vector2(x=cell_m, y=cell_m),
        row_stride=columns,
        cell_stride=1,
        fields=[field(name="state", offset=0, type=field.UINT8)],
    )


def read_grid(data: bytes) -> GridMessage:
    """Inverse of `grid`. Raises LogError where the bytes are not one of ours."""
    try:
        message = Grid_pb2.Grid.FromString(data)
        rows = np.frombuffer(message.data, dtype=np.uint8).reshape(-1, message.column_count)
    except (DecodeError, ValueError) as error:
        raise LogError(f"a message is no grid: {error}") from error
    return GridMessage(np.ascontiguousarray(rows.T), float(message.cell_size.x))


def image(states: ByteGrid, now_ns: int) -> bytes:
    """A foxglove.RawImage of `states` [W, H], one pixel a cell, north up."""
    pixels = _PALETTE[states.T[::-1]]
    message = RawImage_pb2.RawImage(
        timestamp=_stamp(now_ns),
        frame_id=MAP_FRAME,
        width=states.shape[0],
        height=states.shape[1],
        encoding="rgb8",
        step=3 * states.shape[0],
        data=pixels.tobytes(),
    )
    return bytes(message.SerializeToString())


def location(state: VehicleState, robot_id: int) -> bytes:
    """A foxglove.LocationFix of the autopilot's own position."""
    message = _location(robot_id)
    _set_stamp(message.timestamp, state.position_t_ns)
    message.latitude, message.longitude, message.altitude = state.lat_deg, state.lon_deg, state.alt_rel_m
    return bytes(message.SerializeToString())


@lru_cache(maxsize=64)
def _location(robot_id: int) -> Any:
    """What `location` serializes, but for its time and place, which alone may be changed: numbers, see `_grid`."""
    return LocationFix_pb2.LocationFix(frame_id=robot_frame(robot_id))


def frame(robot_id: int, x_cell: float, y_cell: float, spec: GridSpec, now_ns: int) -> bytes:
    """A foxglove.FrameTransform from the map to a robot."""
    message = _frame(robot_id)
    _set_stamp(message.timestamp, now_ns)
    message.translation.x, message.translation.y = _metres(x_cell, spec), _metres(y_cell, spec)
    return bytes(message.SerializeToString())


@lru_cache(maxsize=64)
def _frame(robot_id: int) -> Any:
    """What `frame` serializes, but for its time and place, which alone may be changed: numbers, see `_grid`."""
    return FrameTransform_pb2.FrameTransform(
        parent_frame_id=MAP_FRAME, child_frame_id=robot_frame(robot_id), rotation=_UPRIGHT
    )


def log_line(level: Level, robot_id: int, text: str, now_ns: int) -> bytes:
    """A foxglove.Log."""
    name = robot_frame(robot_id) if robot_id else "run"
    message = Log_pb2.Log(timestamp=_stamp(now_ns), level=_LEVELS[level], message=text, name=name)
    return bytes(message.SerializeToString())


def read_log_line(data: bytes) -> LogLine:
    """Inverse of `log_line`. Raises LogError where the bytes are not one of ours."""
    try:
        message = Log_pb2.Log.FromString(data)
    except DecodeError as error:
        raise LogError(f"a message is no log line: {error}") from error
    return LogLine(message.level, message.name, message.message)


def robot_scene(decision: Decision, kind: RobotKind, spec: GridSpec, now_ns: int) -> bytes:
    """A foxglove.SceneUpdate of one robot: its body, its number, and the way it means to go."""
    assignment = decision.assignment
    way = (assignment.path, assignment.cell) if assignment.kind is not TaskKind.HOLD else None
    scene = _robot_scene(decision.robot_id, kind, decision.cell, way, assignment.reason.value, spec)
    _set_stamp(scene.entities[0].timestamp, now_ns)
    return bytes(scene.SerializeToString())


@lru_cache(maxsize=256)  # a robot shows the same for several ticks
def _robot_scene(
    robot_id: int, kind: RobotKind, cell: Cell, way: tuple[tuple[Cell, ...], Cell] | None, reason: str, spec: GridSpec
) -> Any:
    """What `robot_scene` serializes, but for its time, which alone may be changed. `way`: the path, and where to."""
    height = 1.5 if kind is RobotKind.UAV else 0.3
    entity = SceneEntity_pb2.SceneEntity(frame_id=MAP_FRAME, id=robot_frame(robot_id))
    color = _color(_ROBOT_RGB[kind])
    x, y, z = (*_centre(cell, spec), height * spec.cell_m)
    body = entity.spheres if kind is RobotKind.UAV else entity.cubes
    body.add(pose=_pose(x, y, z), size=_robot_size(spec.cell_m), color=color)
    entity.texts.add(
        pose=_pose(x, y, z + 0.5 * spec.cell_m),
        billboard=True,
        font_size=14.0,
        scale_invariant=True,
        color=color,
        text=f"{kind.name} {robot_id} {reason}",
    )
    if way is not None:
        line = entity.lines.add(
            type=LinePrimitive_pb2.LinePrimitive.LINE_STRIP,
            pose=_pose(0.0, 0.0, 0.0),
            thickness=3.0,
            scale_invariant=True,
            color=color,
        )
        for place in (cell, *way[0], way[1]):
            x, y = _centre(place, spec)
            line.points.add(x=x, y=y, z=z)
    return SceneUpdate_pb2.SceneUpdate(entities=[entity])


def map_scene(states: ByteGrid, spec: GridSpec, now_ns: int) -> bytes:
    """A foxglove.SceneUpdate of what the team knows: obstacles as blocks, targets as balls."""
    obstacles = SceneEntity_pb2.SceneEntity(timestamp=_stamp(now_ns), frame_id=MAP_FRAME, id="obstacles")
    obstacles.cubes.extend(_cubes(states == CellState.OBSTACLE, spec))
    targets = SceneEntity_pb2.SceneEntity(timestamp=_stamp(now_ns), frame_id=MAP_FRAME, id="targets")
    for state in (CellState.TARGET, CellState.LOCALIZED):
        targets.spheres.extend(_balls(states == state, _color(_RGB[state]), spec))
    return bytes(SceneUpdate_pb2.SceneUpdate(entities=[obstacles, targets]).SerializeToString())


def robot_frame(robot_id: int) -> str:
    """Name of a robot's frame, scene entity and log lines."""
    return f"robot_{robot_id}"


def _cubes(mask: BoolGrid, spec: GridSpec) -> Iterable[Any]:
    side = Vector3_pb2.Vector3(x=spec.cell_m, y=spec.cell_m, z=0.5 * spec.cell_m)
    color = _color(_RGB[CellState.OBSTACLE])
    for x, y in np.argwhere(mask):
        pose = _pose(*_centre((int(x), int(y)), spec), 0.25 * spec.cell_m)
        yield CubePrimitive_pb2.CubePrimitive(pose=pose, size=side, color=color)


def _balls(mask: BoolGrid, color: Any, spec: GridSpec) -> Iterable[Any]:
    side = Vector3_pb2.Vector3(x=0.4 * spec.cell_m, y=0.4 * spec.cell_m, z=0.4 * spec.cell_m)
    for x, y in np.argwhere(mask):
        pose = _pose(*_centre((int(x), int(y)), spec), 0.2 * spec.cell_m)
        yield SpherePrimitive_pb2.SpherePrimitive(pose=pose, size=side, color=color)


@lru_cache(maxsize=8)
def _robot_size(cell_m: float) -> Any:
    return Vector3_pb2.Vector3(x=0.6 * cell_m, y=0.6 * cell_m, z=0.2 * cell_m)


def _stamp(t_ns: int) -> Timestamp:
    return Timestamp(seconds=t_ns // NS_PER_S, nanos=t_ns % NS_PER_S)


def _set_stamp(stamp: Timestamp, t_ns: int) -> None:
    stamp.seconds, stamp.nanos = divmod(t_ns, NS_PER_S)


def _pose(x: float, y: float, z: float) -> Any:
    return Pose_pb2.Pose(position=Vector3_pb2.Vector3(x=x, y=y, z=z), orientation=_UPRIGHT)


@lru_cache(maxsize=32)  # shared: whoever puts it into a message copies it
def _color(rgb: tuple[int, int, int]) -> Any:
    return Color_pb2.Color(r=rgb[0] / 255, g=rgb[1] / 255, b=rgb[2] / 255, a=1.0)


def _metres(cells: float, spec: GridSpec) -> float:
    return (cells + 0.5) * spec.cell_m


def _centre(cell: Cell, spec: GridSpec) -> tuple[float, float]:
    return _metres(cell[0], spec), _metres(cell[1], spec)
