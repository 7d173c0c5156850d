"""The mission recorder: everything that a reviewer or a replay may ask for, into one MCAP file that survives a kill.

Rule 1: the order of calls for one robot is the order in which its agent met things. Call `observation`, `heard`, `sent`
        and `decision` beside the agent's `observe`, `hear`, `beacon` and `decide`: a replay does them in that order.
Rule 2: recording never stops the robot. When the disk fails, the recorder says so once and takes in nothing more.
Rule 3: no keys, no signatures of the MAVLink link.

Not safe for use by several threads.
"""

from __future__ import annotations

import hashlib
import logging
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np

from gatar_edge import __version__, foxglove
from gatar_edge import channels as ch
from gatar_edge.errors import LogError
from gatar_edge.logfile import RecordStream
from gatar_edge.mavlink_frame import without_secrets
from gatar_edge.mcap_writer import McapWriter
from gatar_edge.persist import SavedState
from gatar_edge.record_items import RadioBuffers, agent_state, command_record, observation_record
from gatar_edge.types import (
    NS_PER_S,
    BoolGrid,
    ByteGrid,
    Cell,
    Cells,
    CellState,
    Decision,
    GridSpec,
    Observation,
    RobotKind,
    VehicleCommand,
    VehicleState,
)

CHUNK_BYTES = 64 * 1024  # what a kill between flushes can cost is bounded by this and by FLUSH_NS
FLUSH_NS = NS_PER_S
SYNC_NS = 5 * NS_PER_S
STATIC_NS = 2 * NS_PER_S
RUN_INFO_NS = 30 * NS_PER_S
LARGE_MAP_CELLS = 64 * 1024  # larger maps are repeated as seldom as the run info

_log = logging.getLogger(__name__)
_encoder = msgspec.json.Encoder(order="deterministic")


class Recorder:
    """Writes one log. `run_info` comes from `runinfo.describe_run`; all times are of one injected clock."""

    def __init__(self, path: Path, run_info: dict[str, Any], now_ns: int, *, durable: bool = True) -> None:
        """Open `path` for writing. Raises LogError where that is impossible; later failures only stop the recording.

        `durable`: what is flushed also survives that the machine goes down, to within `SYNC_NS`.
        """
        self.stopped = ""  # why the recording ended before `close`
        self.messages = 0
        self.clock_steps_back = 0
        self._path, self._durable = path, durable
        self._run_info = _encoder.encode({"format": ch.FORMAT, **run_info})
        self._spec = msgspec.convert(run_info.get("config", {}).get("grid", {}), GridSpec)
        self._kinds = {robot["robot_id"]: RobotKind(robot["kind"]) for robot in run_info.get("robots", ())}
        self._topics: dict[tuple[str, int], int] = {}
        self._schemas: dict[str, int] = {}
        self._radio = RadioBuffers()
        self._beliefs: dict[int, ByteGrid] = {}
        self._truth: ByteGrid | None = None
        self._now_ns = self._polled_ns = now_ns
        self._due = dict.fromkeys((FLUSH_NS, SYNC_NS, STATIC_NS, RUN_INFO_NS), now_ns)
        try:
            self._stream = RecordStream(path)
        except OSError as error:
            raise LogError(f"log {path} cannot be written: {error.strerror}") from error
        self._writer = McapWriter(self._stream, CHUNK_BYTES)
        self._open(now_ns)

    def _open(self, now_ns: int) -> None:
        self._writer.start(f"{ch.PROFILE}-{ch.FORMAT}", f"gatar-edge {__version__}")
        digest = hashlib.sha256(self._run_info).hexdigest()
        self._writer.add_metadata("gatar", {"format": str(ch.FORMAT), "run_info_sha256": digest})
        self._writer.add_attachment(now_ns, "run_info.json", "application/json", self._run_info)
        self.poll(now_ns)

    @property
    def size_bytes(self) -> int:
        """Length of the file so far, but for the chunk that is being filled."""
        return self._stream.tell()

    # What an agent meets and does

    def observation(self, observation: Observation) -> None:
        """Beside `Agent.observe`."""
        robot_id = observation.robot_id
        self._flush_radio(robot_id)
        record = observation_record(observation)
        self._json(ch.OBSERVATION, record, max(self._now_ns, observation.t_ns), robot_id, observation.t_ns)

    def takes_over(self, state: SavedState, now_ns: int) -> None:
        """Beside `persist.restore`: what the agent starts with, where that is not nothing."""
        self._json(ch.AGENT_STATE, agent_state(state), now_ns, state.robot_id)

    def goes_on(self, state: ch.AgentStateRecord, now_ns: int) -> None:
        """At the beginning of a later file: `record_items.carried_state` of the agent."""
        self._json(ch.AGENT_STATE, state, now_ns, state.robot_id)

    def heard(self, robot_id: int, datagram: bytes, outcome_name: str, now_ns: int) -> None:
        """Beside `Agent.hear`, with the value of the outcome. The bytes are kept where they had an effect."""
        self._radio[robot_id].heard(datagram, outcome_name, now_ns)

    def sent(self, robot_id: int, datagram: bytes, now_ns: int) -> None:
        """Beside `Agent.beacon`, and for each relay that is sent on."""
        self._radio[robot_id].sent(datagram, now_ns)

    def decision(self, decision: Decision, wanted: VehicleCommand, sent: VehicleCommand, now_ns: int) -> None:
        """Beside `Agent.decide`: what was decided, wanted of the vehicle, and sent through the safety gate."""
        robot_id = decision.robot_id
        self._flush_radio(robot_id)
        record = ch.DecisionRecord(decision, command_record(wanted), command_record(sent))
        self._json(ch.DECISION, record, now_ns, robot_id, decision.t_ns)
        kind = self._kinds.get(robot_id, RobotKind.UAV)
        self._write(ch.SCENE, foxglove.robot_scene(decision, kind, self._spec, now_ns), now_ns)
        self.poll(now_ns)

    # What surrounds the agent

    def vehicle(self, robot_id: int, state: VehicleState, now_ns: int) -> None:
        """What the bridge knows of the autopilot."""
        self._json(ch.VEHICLE, ch.VehicleRecord(robot_id, state), now_ns, robot_id, state.t_ns)
        if state.position_t_ns >= 0 and math.isfinite(state.lat_deg) and math.isfinite(state.lon_deg):
            self._write(ch.FIX, foxglove.location(state, robot_id), now_ns, robot_id, state.position_t_ns)

    def mavlink(self, robot_id: int, direction: Literal["rx", "tx"], frame: bytes, now_ns: int) -> None:
        """A raw frame from ("rx") or to ("tx") the autopilot, without its signature; keys on their way are left out."""
        kept = without_secrets(frame)
        if kept is not None:
            self._write(ch.MAVLINK_RX if direction == "rx" else ch.MAVLINK_TX, kept, now_ns, robot_id)

    def belief(self, robot_id: int, belief: ByteGrid, grid: GridSpec, now_ns: int) -> None:
        """What the robot knows: written when it changed since the last call, and repeated as static state."""
        known = self._beliefs.get(robot_id)
        if known is belief or (known is not None and np.array_equal(known, belief)):
            return
        self._beliefs[robot_id] = belief
        self._write(ch.BELIEF, foxglove.grid(belief, grid, now_ns), now_ns, robot_id)

    def text(self, level: foxglove.Level, robot_id: int, text: str, now_ns: int) -> None:
        """A log line; robot 0 is the run itself."""
        self._write(ch.LOG, foxglove.log_line(level, robot_id, text, now_ns), now_ns)

    # The simulator's truth

    def truth_map(self, obstacles: BoolGrid, targets: Cells, now_ns: int) -> None:
        """Where obstacles (bool [W, H]) and targets (int16 [m, 2]) truly are."""
        states = np.where(obstacles, CellState.OBSTACLE, CellState.FREE).astype(np.uint8)
        states[targets[:, 0], targets[:, 1]] = CellState.TARGET
        self._truth = states
        self._write(ch.TRUTH_MAP, foxglove.grid(states, self._spec, now_ns), now_ns)

    def truth_positions(self, positions: Iterable[tuple[int, float, float]], now_ns: int) -> None:
        """Where all robots truly are: (robot id, x, y) in cells, whole numbers at the centres."""
        robots = [ch.Position(robot_id, round(x, 3), round(y, 3)) for robot_id, x, y in positions]
        self._json(ch.TRUTH_ROBOTS, ch.PositionsRecord(robots), now_ns)
        for robot in robots:
            transform = foxglove.frame(robot.robot_id, robot.x, robot.y, self._spec, now_ns)
            self._write(ch.FRAME, transform, now_ns, robot.robot_id)

    def truth_visit(self, robot_id: int, cell: Cell, step: float, now_ns: int) -> None:
        """A target was localized at `step`."""
        self._json(ch.TRUTH_VISITS, ch.VisitRecord(robot_id, cell, step), now_ns)

    def fault(self, kind: str, robot_id: int, details: dict[str, Any], now_ns: int) -> None:
        """A fault begins or ends; robot 0 means all."""
        self._json(ch.FAULTS, ch.FaultRecord(kind, robot_id, details), now_ns)

    def result(self, figures: dict[str, Any], now_ns: int) -> None:
        """The mission's figures, at its end."""
        self._json(ch.RESULT, figures, now_ns)

    # The file

    def poll(self, now_ns: int) -> None:
        """Write what is due: repeated state, flush, fsync. Call at least every half second."""
        if self.stopped:
            return
        self.clock_steps_back += now_ns < self._polled_ns
        self._polled_ns = now_ns
        if self._is_due(RUN_INFO_NS, now_ns):
            self._write(ch.RUN_INFO, self._run_info, now_ns)
        if self._is_due(STATIC_NS, now_ns):
            self._repeat_static(now_ns)
        if self._is_due(FLUSH_NS, now_ns):
            self._flush(now_ns, sync=self._is_due(SYNC_NS, now_ns))

    def close(self) -> None:
        """Write what is collected, the summary and the index. The file is complete after it."""
        for robot_id in list(self._radio):
            self._flush_radio(robot_id)
        if self.stopped:
            return
        try:
            self._writer.finish()
            self._stream.flush()
            self._stream.sync()
            self._stream.close()
        except OSError as error:
            self._stop(error)
        self.stopped = self.stopped or "closed"

    def _repeat_static(self, now_ns: int) -> None:
        large = self._spec.width * self._spec.height > LARGE_MAP_CELLS
        if large:
            self._due[STATIC_NS] = now_ns + RUN_INFO_NS
        for robot_id, belief in self._beliefs.items():
            self._write(ch.BELIEF, foxglove.grid(belief, self._spec, now_ns), now_ns, robot_id)
        if self._beliefs:
            team = np.maximum.reduce(list(self._beliefs.values()))
            self._write(ch.MAP, foxglove.grid(team, self._spec, now_ns), now_ns)
            self._write(ch.MAP_IMAGE, foxglove.image(team, now_ns), now_ns)
            self._write(ch.SCENE, foxglove.map_scene(team, self._spec, now_ns), now_ns)
        if self._truth is not None:
            self._write(ch.TRUTH_MAP, foxglove.grid(self._truth, self._spec, now_ns), now_ns)

    def _flush(self, now_ns: int, sync: bool) -> None:
        for robot_id in list(self._radio):
            self._flush_radio(robot_id)
        if sync:
            self._json(ch.HEALTH, ch.HealthRecord(self.messages, self._stream.tell(), self.clock_steps_back), now_ns)
        if self.stopped:
            return
        try:
            self._writer.flush()
            if sync and self._durable:
                self._stream.sync()
        except OSError as error:
            self._stop(error)

    def _flush_radio(self, robot_id: int) -> None:
        buffer = self._radio.pop(robot_id, None)
        if buffer is not None:
            self._json(ch.RADIO, buffer.record(), self._now_ns, robot_id)

    def _json(self, channel: ch.Channel, record: Any, now_ns: int, robot_id: int = 0, source_ns: int = -1) -> None:
        if not self.stopped:
            self._write(channel, _encoder.encode(record), now_ns, robot_id, source_ns)

    def _write(self, channel: ch.Channel, data: bytes, now_ns: int, robot_id: int = 0, source_ns: int = -1) -> None:
        if self.stopped:
            return
        self._now_ns = max(self._now_ns, now_ns)  # readers rely on a log time that never goes back
        self.messages += 1
        try:
            topic = self._topics.get((channel.topic, robot_id)) or self._new_topic(channel, robot_id)
            self._writer.add_message(topic, self._now_ns, data, source_ns if source_ns >= 0 else now_ns)
        except OSError as error:
            self._stop(error)

    def _new_topic(self, channel: ch.Channel, robot_id: int) -> int:
        if channel.schema not in self._schemas:
            self._schemas[channel.schema] = self._register(channel)
        schema = self._schemas[channel.schema]
        topic = self._writer.register_channel(channel.of(robot_id), channel.encoding.value, schema)
        self._topics[channel.topic, robot_id] = topic
        return topic

    def _register(self, channel: ch.Channel) -> int:
        encoding, definition = "", b""  # MAVLink frames describe themselves
        if channel.encoding is ch.Encoding.JSON:
            encoding, definition = "jsonschema", _encoder.encode(ch.json_schema(channel))
        elif channel.encoding is ch.Encoding.PROTOBUF:
            encoding, definition = "protobuf", foxglove.descriptor_set(channel.schema)
        return self._writer.register_schema(channel.schema, encoding, definition)

    def _is_due(self, period_ns: int, now_ns: int) -> bool:
        if now_ns < self._due[period_ns]:
            return False
        self._due[period_ns] = now_ns + period_ns
        return True

    def _stop(self, error: OSError) -> None:
        self.stopped = f"recording to {self._path} stopped: {error.strerror or error}"
        _log.error("%s; the mission goes on without it", self.stopped)
        try:
            self._stream.abandon()
        except OSError:
            return
