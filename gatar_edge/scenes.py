"""Moments of a mission made from a seed, for benches and golden vectors: what one robot sees, knows and hears.

Everything is made as on a robot: the observation and the neighbours' messages are the bytes that reach its sockets.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from msgspec.structs import replace

from gatar_edge.agent import Agent, Identity, Inbox, Outbox
from gatar_edge.allocators.base import Allocator
from gatar_edge.belief import window_at, window_origin
from gatar_edge.config import AgentConfig
from gatar_edge.features import Inputs, features
from gatar_edge.message import NeighborMessage, encode
from gatar_edge.perception import Perception, encode_observation
from gatar_edge.sim_sitl.world import random_obstacles
from gatar_edge.types import (
    NS_PER_S,
    ByteGrid,
    Cell,
    CellState,
    GridSpec,
    Observation,
    RobotKind,
    TaskKind,
)
from gatar_edge.view import View, with_absent

SIZE = 20  # cells a side: larger than the window, so that targets lie outside it too
UNKNOWN_SHARE = 0.3
KEY = bytes(range(32))
EGO = 1
CONFIG = AgentConfig(grid=GridSpec(SIZE, SIZE))


@dataclass(frozen=True, slots=True)
class Scene:
    """One moment of robot `EGO`."""

    config: AgentConfig
    kind: RobotKind
    belief: ByteGrid
    observation: Observation
    messages: tuple[NeighborMessage, ...]  # of the other robots

    def agent(self, allocator: Allocator) -> Agent:
        """The robot, knowing what it knows."""
        agent = Agent(Identity(EGO, self.kind, 1.0), self.config, allocator, KEY)
        agent.belief = self.belief
        return agent

    def datagrams(self, seq: int) -> tuple[bytes, tuple[bytes, ...]]:
        """What reaches the robot between two ticks: the observation, and one message of each neighbour."""
        told = tuple(encode(replace(message, seq=seq), KEY) for message in self.messages)
        return encode_observation(self.observation, self.observation.t_ns), told


def inputs_of(view: View, looks_ahead: bool, with_windows: bool = True) -> Inputs:
    """Input of a network for one view, as the learned allocator makes it."""
    return features(with_absent(view) if looks_ahead else view, looks_ahead, with_windows)


def tick(agent: Agent, perception: Perception, arrived: tuple[bytes, tuple[bytes, ...]], now_ns: int) -> Outbox:
    """From the bytes that arrived to the command, as in the daemon."""
    return agent.tick(now_ns, Inbox(perception.take(arrived[0], now_ns, None), arrived[1]))


def make_scene(robots: int, targets: int, seed: int) -> Scene:
    """`robots` in one graph, ego in the middle of them, and so many known targets somewhere on the map."""
    rng = np.random.default_rng([seed, robots, targets])
    config = CONFIG
    belief = np.where(random_obstacles(SIZE, SIZE, rng), CellState.OBSTACLE, CellState.FREE).astype(np.uint8)
    centre = np.array([SIZE // 2, SIZE // 2])
    gap = np.stack(np.meshgrid(np.arange(SIZE), np.arange(SIZE), indexing="ij"), axis=-1) - centre
    squared = (gap**2).sum(axis=-1)
    near = np.argwhere((squared <= config.r_comm**2) & (squared > 0))
    places = np.vstack([centre, rng.permutation(near)])[:robots]
    belief[places[:, 0], places[:, 1]] = CellState.FREE
    belief[(rng.random(belief.shape) < UNKNOWN_SHARE) & (squared > config.r_sense**2)] = CellState.UNKNOWN
    free = np.argwhere(belief == CellState.FREE)
    chosen = rng.permutation(free[(free != centre).any(axis=1)])[:targets]
    belief[chosen[:, 0], chosen[:, 1]] = CellState.TARGET
    belief.flags.writeable = False
    kinds = [RobotKind(int(kind)) for kind in rng.integers(2, size=robots)]
    cells = [(int(x), int(y)) for x, y in places]
    others = tuple(_message(config, belief, EGO + n, kinds[n], cells[n]) for n in range(1, robots))
    return Scene(config, kinds[0], belief, _seen(config, belief, kinds[0], cells[0]), others)


def _seen(config: AgentConfig, belief: ByteGrid, kind: RobotKind, cell: Cell) -> Observation:
    x, y = np.indices(belief.shape)
    around = (x - cell[0]) ** 2 + (y - cell[1]) ** 2 <= config.r_sense**2

    def where(state: CellState) -> np.ndarray[tuple[int, ...], np.dtype[np.int16]]:
        return np.argwhere(around & (belief == state)).astype(np.int16)

    seen = np.argwhere(around).astype(np.int16)
    return Observation(EGO, kind, cell, seen, where(CellState.OBSTACLE), where(CellState.TARGET), NS_PER_S)


def _message(config: AgentConfig, belief: ByteGrid, robot_id: int, kind: RobotKind, cell: Cell) -> NeighborMessage:
    origin = window_origin(belief, cell, 1)
    return NeighborMessage(
        robot_id=robot_id, kind=kind, seq=1, t_ms=1000, cell=cell, speed_cells_s=1.0, task=TaskKind.HOLD,
        task_cell=(-1, -1), cost=0.0, window_origin=origin, window=window_at(belief, origin),
        config_digest=config.digest(),
    )  # fmt: skip
