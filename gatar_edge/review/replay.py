"""Runs the same agents on the recorded inputs, and says whether they decide the same.

The agent is deterministic, so every recorded decision and message must come out again, field by field. The key is not
in a log: what was accepted then is signed anew with a key of the replay. What no program can repeat is taken over from
the log: that an allocator was late, that the vehicle did not obey, that nothing obeys in a dry run.
"""

from __future__ import annotations

import base64
import binascii
import re
from collections.abc import Callable
from dataclasses import dataclass, field

import msgspec
from msgspec.structs import replace

from gatar_edge import channels as ch
from gatar_edge.agent import Agent, Identity
from gatar_edge.allocators.base import Allocator, Negotiator
from gatar_edge.config import AgentConfig
from gatar_edge.errors import DeadlineError, LogError
from gatar_edge.keys import DEMO_KEY
from gatar_edge.message import MAC_BYTES, with_hops
from gatar_edge.persist import restore
from gatar_edge.record_items import EFFECTIVE, memory_of, observation_of, saved_state
from gatar_edge.review.company import Json
from gatar_edge.review.difference import comparable, described, difference, differences, goal_differences
from gatar_edge.review.ghosts import Ghost, Prompted, PromptedNegotiator
from gatar_edge.review.reader import Entry, LogReader, decoder, json_object
from gatar_edge.talk import signed_anew
from gatar_edge.tasks import Task
from gatar_edge.types import Assignment, Reason, RobotKind, TaskKind

_INDEX = re.compile(r"\[\d+\]")
MAX_LISTED = 50
MAX_UNSENT = 100_000  # messages in a row that a robot composed and did not send

_LATE = f"{DeadlineError.__name__}: "
_observation = decoder(ch.ObservationRecord)
_radio = decoder(ch.RadioRecord)
_state = decoder(ch.AgentStateRecord)


@dataclass(slots=True)
class Replayed:
    """What came of a replay."""

    decisions: int = 0
    equal: int = 0
    messages: int = 0
    messages_equal: int = 0
    heard: int = 0
    heard_equal: int = 0
    robots: set[int] = field(default_factory=set)
    differences: list[Json] = field(default_factory=list)  # at most MAX_LISTED

    @property
    def same(self) -> bool:
        """Whether everything came out again."""
        return (self.decisions, self.messages, self.heard) == (self.equal, self.messages_equal, self.heard_equal)

    def to_json(self) -> Json:
        """For machines."""
        return {
            "decisions": self.decisions,
            "equal": self.equal,
            "messages": self.messages,
            "messages_equal": self.messages_equal,
            "heard": self.heard,
            "heard_equal": self.heard_equal,
            "robots": len(self.robots),
            "first_difference": self.differences[0] if self.differences else None,
            "differences": self.differences,
        }

    def differ(self, difference: Json) -> None:
        """Keep a difference while there is room."""
        if len(self.differences) < MAX_LISTED:
            self.differences.append(difference)


class Replay:
    """Feeds a log's inputs to agents. `make` gives the allocator of one robot, by the recorded name.

    Fields in `ignore` (written without indices, such as `candidates[].score`) need not be equal.
    With `otherwise`, the agents follow the recorded tasks whatever they would have decided themselves: each decision
    then answers what this allocator would have done in that robot's place at that moment.
    """

    def __init__(
        self,
        make: Callable[[str], Allocator],
        *,
        otherwise: bool = False,
        key: bytes | None = None,
        ignore: frozenset[str] = frozenset(),
    ) -> None:
        self.result = Replayed()
        self.ghosts: dict[int, Ghost] = {}
        self._make = make
        self._otherwise = otherwise
        self._ignore = ignore
        self._key = DEMO_KEY if key is None else key
        self._sign = key is None

    def run(self, log: LogReader) -> Replayed:
        """The whole log. Raises LogError where it cannot be read or lacks its configuration."""
        for entry in log.messages(lambda channel, _: channel.topic in _FEEDS):
            self.feed(entry)
        if not self.ghosts:
            raise LogError(f"log {log.path} does not say what flew: nothing to replay")
        return self.result

    def feed(self, entry: Entry) -> None:
        """One message of the log; those that no agent met have no effect."""
        handler = _FEEDS.get(entry.channel.topic)
        if handler is not None:
            handler(self, entry)

    def _on_run_info(self, entry: Entry) -> None:
        info = json_object(entry.data)
        for robot in info.get("robots", ()):
            known = self.ghosts.get(robot["robot_id"])
            # the daemon started anew: what it had heard before is forgotten
            if known is None or known.first_seq != robot.get("first_seq", 1):
                self.ghosts[robot["robot_id"]] = self._ghost(info, robot)

    def _ghost(self, info: Json, robot: Json) -> Ghost:
        try:
            config = msgspec.convert(info["config"], AgentConfig)
            identity = Identity(robot["robot_id"], RobotKind(robot["kind"]), robot["speed_cells_s"])
            inner = self._make(info["allocator"])
            allocator = PromptedNegotiator(inner) if isinstance(inner, Negotiator) else Prompted(inner)
        except (KeyError, ValueError, msgspec.ValidationError) as error:
            raise LogError(f"the log's run info cannot be used: {error}") from error
        first_seq = robot.get("first_seq", 1)
        return Ghost(Agent(identity, config, allocator, self._key, first_seq), allocator, first_seq)

    def _robot(self, entry: Entry) -> Ghost:
        ghost = self.ghosts.get(entry.robot_id)
        if ghost is None:
            raise LogError(f"the log has messages of robot {entry.robot_id}, but its run info does not know it")
        self.result.robots.add(entry.robot_id)
        return ghost

    def _on_state(self, entry: Entry) -> None:
        agent = self._robot(entry).agent
        record: ch.AgentStateRecord = _state(entry.data)
        restore(agent, saved_state(record, agent.config))
        if record.memory is not None:
            agent.recall(memory_of(record.memory))

    def _on_observation(self, entry: Entry) -> None:
        record: ch.ObservationRecord = _observation(entry.data)
        self._robot(entry).agent.observe(observation_of(record))

    def _on_radio(self, entry: Entry) -> None:
        ghost = self._robot(entry)
        for item in _radio(entry.data).items:
            if item.way is ch.RadioWay.SENT and item.talk:
                self._compare_talk(ghost, item)
            elif item.way is ch.RadioWay.SENT:
                self._compare_message(ghost, item)
            elif item.way is ch.RadioWay.HEARD and item.outcome in EFFECTIVE:
                self._hear(ghost, item)

    def _hear(self, ghost: Ghost, item: ch.RadioItem) -> None:
        datagram = _datagram(item)
        if self._sign:
            datagram = signed_anew(datagram, self._key) if item.talk else with_hops(datagram, item.hops, self._key)
        outcome = ghost.agent.hear(datagram, item.t_ns).outcome
        self.result.heard += 1
        self.result.heard_equal += outcome.value == item.outcome
        if outcome.value != item.outcome:
            number = ghost.agent.identity.robot_id
            self.result.differ(difference(number, item.t_ns, f"heard of {item.author}", item.outcome, outcome.value))

    def _compare_message(self, ghost: Ghost, item: ch.RadioItem) -> None:
        """What the robot says again; messages that it composed and the byte budget held back are passed over."""
        agent = ghost.agent
        if not agent.next_seq <= item.seq <= agent.next_seq + MAX_UNSENT:
            self.result.messages += 1
            number = agent.identity.robot_id
            self.result.differ(difference(number, item.t_ns, "message sequence", item.seq, agent.next_seq))
            return
        while agent.next_seq < item.seq:
            agent.beacon(item.t_ns)
        again, then = agent.beacon(item.t_ns), _datagram(item)
        if self._otherwise:
            return
        if self._sign:
            again, then = again[:-MAC_BYTES], then[:-MAC_BYTES]
        self.result.messages += 1
        self.result.messages_equal += again == then
        if again != then:
            number = agent.identity.robot_id
            self.result.differ(difference(number, item.t_ns, f"message {item.seq}", then.hex(), again.hex()))

    def _compare_talk(self, ghost: Ghost, item: ch.RadioItem) -> None:
        """What its allocator tells the others again; what the byte budget held back is passed over."""
        if self._otherwise:
            return
        wanted = _datagram(item)[:-MAC_BYTES]
        if not any(talk[:-MAC_BYTES] == wanted for talk in ghost.talks):
            ghost.talks = list(ghost.agent.negotiate(item.t_ns))
        found = next((n for n, talk in enumerate(ghost.talks) if talk[:-MAC_BYTES] == wanted), None)
        self.result.messages += 1
        self.result.messages_equal += found is not None
        if found is None:
            again = ghost.talks[0].hex() if ghost.talks else ""
            number = ghost.agent.identity.robot_id
            self.result.differ(difference(number, item.t_ns, f"talk {item.seq}", wanted.hex(), again))
        else:
            del ghost.talks[: found + 1]

    def _on_decision(self, entry: Entry) -> None:
        ghost = self._robot(entry)
        record = json_object(entry.data)
        then = record["decision"]
        agent = ghost.agent
        ghost.allocator.late = "" if self._otherwise else then["fallback"].partition(_LATE)[2]
        agent.has_vehicle = then["assignment"]["reason"] != Reason.NO_VEHICLE.value
        agent.shunned = frozenset((x, y) for x, y in then.get("shunned", ()))
        agent.shadow = record["sent"] == {"type": "hold", "reason": "dry run"}
        task = agent.task
        decision = replace(agent.decide(then["t_ns"]), latency_ns=then["latency_ns"])
        now = msgspec.json.decode(msgspec.json.encode(decision))
        self.result.decisions += 1
        found = goal_differences(then, now) if self._otherwise else differences(then, comparable(then, now), "")
        fields = [d for d in found if _INDEX.sub("[]", d["field"]) not in self._ignore]
        self.result.equal += not fields
        if fields:
            self.result.differ(described(entry.robot_id, then, now, fields))
        if self._otherwise:
            agent.task = _next_task(task, then)


_FEEDS: dict[str, Callable[[Replay, Entry], None]] = {
    ch.RUN_INFO.topic: Replay._on_run_info,
    ch.AGENT_STATE.topic: Replay._on_state,
    ch.OBSERVATION.topic: Replay._on_observation,
    ch.RADIO.topic: Replay._on_radio,
    ch.DECISION.topic: Replay._on_decision,
}


def _next_task(task: Task, decision: Json) -> Task:
    """What the robot was doing after the recorded decision, and `task` before it."""
    assignment = decision["assignment"]
    if assignment["kind"] == TaskKind.HOLD and assignment["reason"] in _STOPPED:
        return Task()
    return task.followed_by(msgspec.convert(assignment, Assignment), given_up=decision["retask"])


_STOPPED = frozenset((Reason.NO_PERCEPTION.value, Reason.NO_VEHICLE.value))


def _datagram(item: ch.RadioItem) -> bytes:
    try:
        return base64.b64decode(item.data, validate=True)
    except (binascii.Error, ValueError) as error:
        raise LogError(f"a recorded datagram is damaged: {error}") from error
