"""Values of the runtime in the form in which the log holds them."""

from __future__ import annotations

import base64
import struct
import zlib
from collections import Counter
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import msgspec
import numpy as np

from gatar_edge import channels as ch
from gatar_edge.agent import Agent, Memory
from gatar_edge.config import AgentConfig
from gatar_edge.errors import LogError, MessageError
from gatar_edge.keys import KEY_BYTES
from gatar_edge.message import MAC_BYTES, encode, sender_of, unpack
from gatar_edge.neighbors import Neighbor
from gatar_edge.persist import SavedState, snapshot
from gatar_edge.talk import author_of
from gatar_edge.types import Cells, Goto, Hold, Mission, Observation, RobotKind, TaskKind, VehicleCommand

EFFECTIVE = frozenset(("accepted", "nearer", "talk"))  # outcomes of a datagram that changed what a robot knows
COMMONPLACE = frozenset(("duplicate", "own", "too_far"))  # outcomes that are only counted
MAX_REFUSED = 20  # of one record: what a robot refuses must not fill its disk


@dataclass(slots=True)
class RadioBuffer:
    """The datagrams of one robot that are not written yet."""

    robot_id: int
    items: list[ch.RadioItem] = field(default_factory=list)
    ignored: Counter[str] = field(default_factory=Counter)
    relayed: int = 0
    relayed_bytes: int = 0
    refused: int = 0

    def heard(self, datagram: bytes, outcome: str, now_ns: int) -> None:
        """One datagram that was heard, and what became of it."""
        if outcome in COMMONPLACE:
            self.ignored[outcome] += 1
        elif outcome in EFFECTIVE:
            self.items.append(radio_item(datagram, ch.RadioWay.HEARD, outcome, now_ns, keep=True))
        elif self.refused >= MAX_REFUSED:
            self.ignored[outcome] += 1
        else:
            self.refused += 1
            self.items.append(radio_item(datagram, ch.RadioWay.HEARD, outcome, now_ns, keep=False))

    def sent(self, datagram: bytes, now_ns: int) -> None:
        """One datagram that was sent: own, or another robot's passed on."""
        talk = author_of(datagram)
        author = talk[0] if talk is not None else sender_of(datagram)
        if author == self.robot_id:
            self.items.append(radio_item(datagram, ch.RadioWay.SENT, "", now_ns, keep=True))
        else:
            self.relayed += 1
            self.relayed_bytes += len(datagram)

    def record(self) -> ch.RadioRecord:
        """As the log holds it."""
        return ch.RadioRecord(self.robot_id, self.items, dict(self.ignored), self.relayed, self.relayed_bytes)


class RadioBuffers(dict[int, RadioBuffer]):
    """The buffers of all robots, made when asked for."""

    def __missing__(self, robot_id: int) -> RadioBuffer:
        """An empty buffer, kept."""
        self[robot_id] = RadioBuffer(robot_id)
        return self[robot_id]


def command_record(command: VehicleCommand) -> dict[str, Any]:
    """A command as the log holds it."""
    match command:
        case Goto(cell):
            return {"type": "goto", "cell": cell}
        case Mission(cells):
            return {"type": "mission", "cells": cells}
        case Hold(reason):
            return {"type": "hold", "reason": reason}


@lru_cache(maxsize=128)  # in a simulator all in range log the same
def radio_item(datagram: bytes, way: ch.RadioWay, outcome: str, now_ns: int, keep: bool) -> ch.RadioItem:
    """One datagram as the log holds it, its bytes only where `keep`; its claims where it is a message."""
    data = base64.b64encode(datagram).decode() if keep else ""
    talk = author_of(datagram)
    if talk is not None:
        return ch.RadioItem(now_ns, way, outcome, author=talk[0], seq=talk[1], talk=True, size=len(datagram), data=data)
    try:
        told = unpack(datagram)
    except (MessageError, struct.error) as error:
        return ch.RadioItem(now_ns, way, outcome or type(error).__name__, size=len(datagram))
    return ch.RadioItem(
        t_ns=now_ns,
        way=way,
        outcome=outcome,
        author=told.robot_id,
        seq=told.seq,
        hops=told.hops,
        sent_ms=told.t_ms,
        cell=told.cell,
        task=told.task,
        task_cell=told.task_cell,
        cost=told.cost,
        size=len(datagram),
        data=data,
    )


def agent_state(state: SavedState) -> ch.AgentStateRecord:
    """A saved state as the log holds it."""
    return ch.AgentStateRecord(
        robot_id=state.robot_id,
        width=state.width,
        height=state.height,
        belief=base64.b64encode(zlib.compress(state.belief, 6)).decode(),
        task_kind=TaskKind(state.task_kind),
        task_cell=state.task_cell,
        task_path=state.task_path,
        changes=state.changes,
    )


def saved_state(record: ch.AgentStateRecord, config: AgentConfig) -> SavedState:
    """Inverse of `agent_state`. Raises LogError where the record does not fit the configuration."""
    cells = record.width * record.height
    if (record.width, record.height) != (config.grid.width, config.grid.height):
        raise LogError(f"a recorded state is of {record.width} x {record.height} cells, the grid is not")
    try:
        belief = zlib.decompressobj().decompress(base64.b64decode(record.belief, validate=True), cells + 1)
    except (zlib.error, ValueError) as error:
        raise LogError(f"a recorded state is damaged: {error}") from error
    if len(belief) != cells:
        raise LogError(f"a recorded state has {len(belief)} cells, not {cells}")
    return SavedState(
        robot_id=record.robot_id,
        config_digest=config.digest(),
        unix_ns=0,
        next_seq=0,
        width=record.width,
        height=record.height,
        belief=belief,
        task_kind=record.task_kind.value,
        task_cell=record.task_cell,
        task_path=record.task_path,
        changes=record.changes,
    )


def carried_state(agent: Agent) -> ch.AgentStateRecord:
    """All that the next file of a log needs to be replayed without the files before it."""
    memory = agent.memory()
    unsigned = [
        ch.HeardRecord(
            neighbor.heard_ns,
            base64.b64encode(encode(neighbor.message, bytes(KEY_BYTES))[:-MAC_BYTES]).decode(),
        )
        for neighbor in memory.neighbors
    ]
    seen = None if memory.observation is None else observation_record(memory.observation)
    record = ch.MemoryRecord(memory.next_seq, memory.ticks, memory.takes_part, seen, unsigned)
    return msgspec.structs.replace(agent_state(snapshot(agent, 0)), memory=record)


def memory_of(record: ch.MemoryRecord) -> Memory:
    """Inverse of the part of `carried_state` that `agent_state` lacks. Raises LogError where it is damaged."""
    try:
        neighbors = tuple(
            Neighbor(unpack(base64.b64decode(heard.data, validate=True) + bytes(MAC_BYTES)), heard.heard_ns)
            for heard in record.neighbors
        )
    except (MessageError, ValueError, struct.error) as error:
        raise LogError(f"a recorded state is damaged: {error}") from error
    seen = None if record.observation is None else observation_of(record.observation)
    return Memory(record.next_seq, record.ticks, record.takes_part, seen, neighbors)


def observation_record(observation: Observation) -> ch.ObservationRecord:
    """An observation as the log holds it."""
    return ch.ObservationRecord(
        robot_id=observation.robot_id,
        kind=observation.kind.value,
        cell=observation.cell,
        t_ns=observation.t_ns,
        seen=flat_cells(observation.seen),
        obstacles=flat_cells(observation.obstacles),
        targets=flat_cells(observation.targets),
    )


def observation_of(record: ch.ObservationRecord) -> Observation:
    """Inverse of `observation_record`."""
    return Observation(
        robot_id=record.robot_id,
        kind=RobotKind(record.kind),
        cell=record.cell,
        seen=_cells(record.seen),
        obstacles=_cells(record.obstacles),
        targets=_cells(record.targets),
        t_ns=record.t_ns,
    )


def _cells(flat: list[int]) -> Cells:
    return np.array(flat, dtype=np.int16).reshape(-1, 2)


def flat_cells(cells: Cells) -> list[int]:
    """Cells [n, 2] as x0, y0, x1, y1, ..."""
    flat: list[int] = cells.reshape(-1).tolist()
    return flat
