"""One robot's mind: what came in since the last tick -> what goes out.

The daemon, the simulator and the replay run this. No sockets, no clock, no randomness: time and inputs are handed in,
so that the same inputs give the same decisions.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gatar_edge.absent import REMEMBER_S, out_of_range, patience_s
from gatar_edge.allocators.base import Allocation, Allocator, Negotiator
from gatar_edge.allocators.greedy import Greedy
from gatar_edge.belief import merged, nothing_known, observed, same_sight, window_at, window_origin
from gatar_edge.config import AgentConfig
from gatar_edge.message import NeighborMessage, encode
from gatar_edge.neighbors import Heard, HearOutcome, Neighbor, NeighborTable
from gatar_edge.roster import remembered, taking_part
from gatar_edge.talk import TALK, Talk
from gatar_edge.tasks import Rules, Task, decide, to_command
from gatar_edge.types import (
    NS_PER_S,
    Assignment,
    ByteGrid,
    Candidate,
    Cell,
    CellState,
    Decision,
    Observation,
    Reason,
    RobotKind,
    RobotState,
    TaskKind,
    VehicleCommand,
)
from gatar_edge.view import View, build_view, hops_from_ego, without

MOST_TOLD = 64  # windows that are remembered, for which a belief has nothing to learn


@dataclass(frozen=True, slots=True)
class Inbox:
    """What reached the robot since its last tick."""

    observation: Observation | None = None
    datagrams: tuple[bytes, ...] = ()


@dataclass(frozen=True, slots=True)
class Outbox:
    """What one tick gives: the decision, what the vehicle is to do, and what goes on the air."""

    decision: Decision
    command: VehicleCommand
    message: bytes
    relays: tuple[bytes, ...]
    talks: tuple[bytes, ...] = ()  # between allocators that talk


@dataclass(frozen=True, slots=True)
class Identity:
    """Who this robot is."""

    robot_id: int
    kind: RobotKind
    speed_cells_s: float


@dataclass(frozen=True, slots=True)
class Memory:
    """What an agent's next decisions depend on, beside its belief, its task, and what allocators told each other."""

    next_seq: int
    ticks: int
    takes_part: bool
    observation: Observation | None
    neighbors: tuple[Neighbor, ...]


class Agent:
    """Belief, neighbours, allocation and task of one robot."""

    def __init__(
        self, identity: Identity, config: AgentConfig, allocator: Allocator, key: bytes, first_seq: int = 1
    ) -> None:
        self.identity = identity
        self.config = config
        self.allocator = allocator
        self.belief: ByteGrid = nothing_known(config.grid)
        self.task = Task()
        self.neighbors = NeighborTable(
            robot_id=identity.robot_id,
            key=key,
            config_digest=config.digest(),
            hop_limit=config.hop_limit,
            max_age_ns=int(config.max_age_s * NS_PER_S),
            r_comm=config.r_comm,
            max_neighbors=config.max_neighbors,
        )
        self._negotiator = allocator if isinstance(allocator, Negotiator) else None
        self._talk = Talk(identity.robot_id, key, config.digest(), first_seq)
        self._key = key
        self._digest = config.digest()
        self._seq = first_seq
        self._tick = 0
        self._fallback = Greedy()
        self._observation: Observation | None = None
        self.has_vehicle = True  # set false by the caller while the vehicle cannot be commanded
        self._looked: ByteGrid | None = None  # the belief that held all that was seen
        self._told_to: ByteGrid | None = None  # the belief to which windows by origin and identity added nothing
        self._told: dict[tuple[Cell, int], ByteGrid] = {}
        self.shunned: frozenset[Cell] = frozenset()  # where the vehicle could not go lately: set by the caller
        self.shadow = False  # set true by the caller where nothing obeys: tell what is seen, claim nothing
        self._takes_part = True  # a robot that cannot move says so, and nobody allocates targets to it

    @property
    def next_seq(self) -> int:
        """Sequence number of the next message: what a restarted robot must go on from."""
        return self._seq

    def memory(self) -> Memory:
        """What a log's next file must hold, so that it can be replayed on its own."""
        return Memory(self._seq, self._tick, self._takes_part, self._observation, self.neighbors.remembered())

    def recall(self, memory: Memory) -> None:
        """Go on from what `memory` gave."""
        self._seq, self._tick = memory.next_seq, memory.ticks
        self._takes_part, self._observation = memory.takes_part, memory.observation
        self.neighbors.recall(memory.neighbors)

    def tick(self, now_ns: int, inbox: Inbox) -> Outbox:
        """Take in what came, decide, and compose the message that tells the neighbours."""
        if inbox.observation is not None:
            self.observe(inbox.observation)
        relays = tuple(relay for data in inbox.datagrams if (relay := self.hear(data, now_ns).relay) is not None)
        decision = self.decide(now_ns)
        command = to_command(self.identity.kind, decision.assignment)
        return Outbox(decision, command, self.beacon(now_ns), relays, self.negotiate(now_ns))

    def observe(self, observation: Observation) -> None:
        """Take in what the robot sees; the same as before adds nothing to the same belief."""
        before, self._observation = self._observation, observation
        if before is None or self._looked is not self.belief or not same_sight(before, observation):
            self.belief = self._looked = observed(self.belief, observation)

    def hear(self, datagram: bytes, now_ns: int) -> Heard:
        """Take in bytes from the radio; the answer may hold a relay to send on. Never raises for what was sent."""
        if datagram and datagram[0] == TALK:
            return Heard(self._listen(datagram, now_ns))
        heard = self.neighbors.hear(datagram, now_ns, self._observation.cell if self._observation is not None else None)
        if heard.message is not None:
            self._merge(heard.message.window_origin, heard.message.window)
        return heard

    def _merge(self, origin: Cell, window: ByteGrid) -> None:
        """Take over what a neighbour knows; most often it tells what it told before, and nothing new."""
        if self._told_to is not self.belief or len(self._told) >= MOST_TOLD:
            self._told_to, self._told = self.belief, {}
        if (origin, id(window)) not in self._told:
            self._told[origin, id(window)] = window
            self.belief = merged(self.belief, origin, window)

    def beacon(self, now_ns: int) -> bytes:
        """The message of this moment: where the robot is, what it is doing, and what it knows."""
        observation = self._observation
        cell = observation.cell if observation is not None else (-1, -1)
        origin = window_origin(self.belief, cell, self._seq)
        moves = self._takes_part and not self.shadow
        task = self.task if moves else Task()
        message = NeighborMessage(
            robot_id=self.identity.robot_id,
            kind=self.identity.kind,
            seq=self._seq,
            t_ms=now_ns // 1_000_000,
            cell=cell,
            speed_cells_s=self.identity.speed_cells_s if moves else 0.0,
            task=task.kind,
            task_cell=task.cell,
            cost=float(max(0, len(task.path) - 1)),
            window_origin=origin,
            window=window_at(self.belief, origin),
            hops=0,
            config_digest=self._digest,
        )
        self._seq += 1
        return encode(message, self._key)

    def negotiate(self, now_ns: int) -> tuple[bytes, ...]:
        """What the allocator has to tell its like in range, one datagram each; nothing where it does not talk."""
        observation, negotiator = self._observation, self._negotiator
        if negotiator is None or observation is None or not self._takes_part or self.shadow:
            return ()
        return tuple(self._talk.seal(payload) for payload in negotiator.bid(self.view(now_ns, observation)))

    def decide(self, now_ns: int) -> Decision:
        """Choose what to do with what is known now."""
        self._tick += 1
        observation = self._observation
        oldest_ns = self.config.perception_max_age_s * NS_PER_S
        if observation is None or now_ns - observation.t_ns > oldest_ns or not self.config.grid.has(observation.cell):
            return self._stand_still(now_ns, Reason.NO_PERCEPTION)
        if not self.has_vehicle:
            return self._stand_still(now_ns, Reason.NO_VEHICLE)
        self._takes_part = True
        view = self.view(now_ns, observation)
        allocation, name, fallback = self._allocate(view)
        assignment = decide(view, allocation, self.task, Rules(self.config.keep_task, self.config.r_sense))
        retask = self._gives_up(assignment)
        self.task = self.task.followed_by(assignment, given_up=retask)
        return Decision(
            robot_id=self.identity.robot_id,
            tick=self._tick,
            t_ns=now_ns,
            cell=observation.cell,
            assignment=assignment,
            allocator=name,
            fallback=fallback,
            retask=retask,
            robots=view.robots,
            hops=hops_from_ego(view.robots, self.config.r_comm, self.config.hop_limit),
            candidates=_candidates(view, allocation),
            choices=tuple(allocation.choices.tolist()),
            attention=allocation.attention,
            shunned=tuple(sorted(self.shunned)),
            steady=allocation.steady,
            frontier=allocation.frontier,
            absent=allocation.absent,
            kept_for_absent=allocation.kept_for_absent,
        )

    def view(self, now_ns: int, observation: Observation) -> View:
        """What the decision is made on."""
        identity, config = self.identity, self.config
        ego = RobotState(
            identity.robot_id, identity.kind, observation.cell, identity.speed_cells_s, self.task.kind, self.task.cell
        )
        others = taking_part(self.neighbors.fresh(now_ns, observation.cell), config.grid, now_ns)
        near = [robot for robot in (ego, *others) if math.dist(robot.cell, ego.cell) <= config.r_comm]
        silent = remembered(self.neighbors.silent(now_ns, int(REMEMBER_S * NS_PER_S)), config.grid, now_ns)
        for_s = patience_s(len(others), config.grid.width * config.grid.height, config.r_comm)
        absent = out_of_range(silent[: config.max_neighbors - len(others)], near, for_s, config.r_comm)
        view = build_view(
            now_ns, ego, others, self.belief, config.r_comm, config.hop_limit, config.max_candidates, absent
        )
        return without(view, self.shunned) if self.shunned else view

    def _listen(self, datagram: bytes, now_ns: int) -> HearOutcome:
        """Hand the allocator what its like told."""
        outcome, payload = self._talk.open(datagram)
        if outcome is HearOutcome.TALK and self._negotiator is not None:
            self._negotiator.heard(payload, now_ns)
        self.neighbors.counters[outcome] += 1
        return outcome

    def _allocate(self, view: View) -> tuple[Allocation, str, str]:
        """The configured allocator's proposal, or the fallback's with the reason why."""
        try:
            allocation = self.allocator.allocate(view)
        except Exception as error:  # whatever a model does, the robot goes on
            return self._fallback.allocate(view), self._fallback.name, f"{type(error).__name__}: {error}"[:200]
        if np.isnan(allocation.scores).any() or len(allocation.choices) != len(view.robots):
            return self._fallback.allocate(view), self._fallback.name, "scores are not finite"
        return allocation, self.allocator.name, ""

    def _gives_up(self, assignment: Assignment) -> bool:
        """A target left before it was reached, for anything else."""
        if self.task.kind is not TaskKind.TARGET or assignment.cell == self.task.cell:
            return False
        return bool(self.belief[self.task.cell] == CellState.TARGET)

    def _stand_still(self, now_ns: int, reason: Reason) -> Decision:
        """Without fresh perception or a vehicle that obeys, the robot gives its task back and says so."""
        self._takes_part = False
        cell = self._observation.cell if self._observation is not None else (-1, -1)
        self.task = Task()
        return Decision(
            robot_id=self.identity.robot_id,
            tick=self._tick,
            t_ns=now_ns,
            cell=cell,
            assignment=Assignment(TaskKind.HOLD, cell, reason),
            allocator=self.allocator.name,
            fallback="",
            retask=False,
            robots=(),
            hops=(),
            candidates=(),
            choices=(),
        )


def _candidates(view: View, allocation: Allocation) -> tuple[Candidate, ...]:
    rows = zip(view.targets.tolist(), view.lengths[0].tolist(), allocation.scores[0].tolist(), strict=True)
    return tuple(Candidate((x, y), length, score) for (x, y), length, score in rows)
