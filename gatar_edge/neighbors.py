"""Whom a robot hears: accepts each message once, says what to relay, and forgets who fell silent.

Rule 1: time is local. A neighbour's age counts from the reception here; its own clock decides nothing.
Rule 2: per author only a rising sequence is news. It is remembered after the author fell silent, so that a recording
        of the team's radio cannot bring a robot back.
Rule 3: `hear` takes any bytes and never raises; each cause has its outcome, each outcome its counter.
"""

from __future__ import annotations

import math
from enum import StrEnum
from operator import attrgetter

import msgspec
from msgspec.structs import replace

from gatar_edge.errors import ConfigError, MessageError
from gatar_edge.keys import KEY_BYTES
from gatar_edge.message import NeighborMessage, open_envelope, unpack, with_hops
from gatar_edge.relaying import Place, passes_on
from gatar_edge.types import NS_PER_S, Cell

MAX_HOPS = 255  # one byte
MAX_AUTHORS = 1024  # remembered sequences: the longest silent author is forgotten first


class HearOutcome(StrEnum):
    """What became of one datagram: one per cause. The values of `MessageCause` are among them."""

    ACCEPTED = "accepted"
    NEARER = "nearer"  # heard before, but over more hops: the same news by a shorter way
    DUPLICATE = "duplicate"  # heard before over as many hops or fewer
    OLDER = "older"  # a later message of this author was heard: overtaken, or replayed
    OWN = "own"  # ours, relayed or looped back
    FOREIGN_CONFIG = "foreign_config"  # of a robot whose configuration differs from ours
    TOO_FAR = "too_far"  # over more hops than the team's limit
    TALK = "talk"  # no neighbour message: between allocators
    MALFORMED = "malformed"
    VERSION = "version"
    FORGED = "forged"


class Heard(msgspec.Struct, frozen=True):
    """The outcome; the message where it is ACCEPTED or NEARER; the bytes to send on where it is this robot's turn."""

    outcome: HearOutcome
    message: NeighborMessage | None = None
    relay: bytes | None = None


# The usual answer: most of what is heard is known already.
_IGNORED = {outcome: Heard(outcome) for outcome in HearOutcome}


class Neighbor(msgspec.Struct, frozen=True):
    """The newest message of one author, and when it was first heard here."""

    message: NeighborMessage
    heard_ns: int

    @property
    def robot_id(self) -> int:
        """Who wrote the message."""
        return self.message.robot_id

    @property
    def hops(self) -> int:
        """Relays on the shortest way the message came: 0 when heard from the author."""
        return self.message.hops

    def age_ns(self, now_ns: int) -> int:
        """Time since the reception, by the local clock."""
        return now_ns - self.heard_ns

    def place(self, now_ns: int) -> Place:
        """Where it was, and how far it may have gone since it was heard: it may be anywhere when it does not know."""
        message = self.message
        lost = message.cell[0] < 0
        moved_cells = math.inf if lost else message.speed_cells_s * self.age_ns(now_ns) / NS_PER_S
        return Place(message.robot_id, message.cell, moved_cells)


class NeighborTable:
    """All that one robot remembers of what it heard; bounded, deterministic, without a clock of its own.

    `hop_limit` is K: 0 hears nobody, 1 the authors in range, 2 also what those relay; `r_comm` the range of radio in
    cells. Raises ConfigError for a key of another length than 32 bytes.
    """

    def __init__(
        self,
        robot_id: int,
        key: bytes,
        config_digest: int,
        *,
        hop_limit: int,
        max_age_ns: int,
        r_comm: float,
        max_neighbors: int = 63,
    ) -> None:
        if len(key) != KEY_BYTES:  # an empty one would mean no signature at all
            raise ConfigError(f"the team's key has {len(key)} bytes, must be {KEY_BYTES}: read it with keys.read_key")
        self.counters: dict[HearOutcome, int] = dict.fromkeys(HearOutcome, 0)
        self._robot_id = robot_id
        self._key = key
        self._config_digest = config_digest
        self._hop_limit = min(hop_limit, MAX_HOPS)
        self._max_age_ns = max_age_ns
        self._r_comm = r_comm
        self._max_neighbors = max_neighbors
        self._authors: dict[int, Neighbor] = {}  # in order of reception, the longest silent first
        self._placed_ns = -1
        self._placed: dict[int, Place] = {}  # where the neighbours of that moment were and how far they may have gone

    def hear(self, data: bytes | bytearray | memoryview, now_ns: int, own_cell: Cell | None = None) -> Heard:
        """Judge one datagram received at `now_ns`; a robot that does not know its own cell passes on all that is news.

        Copies cost no signature check and no unpacking.
        """
        heard = self._judge(bytes(data), now_ns, own_cell)  # what is looked up by its content must not change
        self.counters[heard.outcome] += 1
        return heard

    def fresh(self, now_ns: int, own_cell: Cell) -> tuple[Neighbor, ...]:
        """The neighbours not older than the limit, by id; of too many those nearest to `own_cell` (then lower id)."""
        found = self._not_older(now_ns - self._max_age_ns)
        if len(found) > self._max_neighbors:
            found.sort(key=lambda neighbor: (_squared_distance(neighbor.message.cell, own_cell), neighbor.robot_id))
            del found[self._max_neighbors :]
        return tuple(sorted(found, key=_author))

    def silent(self, now_ns: int, most_ns: int) -> tuple[Neighbor, ...]:
        """Neighbours not heard for longer than the limit, but not for longer than `most_ns`; the last heard first."""
        first_ns, last_ns = now_ns - most_ns, now_ns - self._max_age_ns
        return tuple([n for n in reversed(self._authors.values()) if first_ns <= n.heard_ns < last_ns])

    def remembered(self) -> tuple[Neighbor, ...]:
        """The newest message of every author, the longest silent first."""
        return tuple(self._authors.values())

    def recall(self, neighbors: tuple[Neighbor, ...]) -> None:
        """Know what `remembered` gave, and nothing else."""
        self._authors = {neighbor.robot_id: neighbor for neighbor in neighbors}
        self._placed_ns = -1

    def _judge(self, data: bytes, now_ns: int, own_cell: Cell | None) -> Heard:
        try:
            robot_id, seq, hops, digest = open_envelope(data, self._key)
            known = self._authors.get(robot_id)
            if robot_id == self._robot_id:
                return _IGNORED[HearOutcome.OWN]
            if digest != self._config_digest:
                return _IGNORED[HearOutcome.FOREIGN_CONFIG]
            if hops >= self._hop_limit:
                return _IGNORED[HearOutcome.TOO_FAR]
            if known is None or seq > known.message.seq:
                outcome, message = HearOutcome.ACCEPTED, unpack(data)
                self._remember(Neighbor(message, now_ns))
            elif seq < known.message.seq:
                return _IGNORED[HearOutcome.OLDER]
            elif hops >= known.message.hops:
                return _IGNORED[HearOutcome.DUPLICATE]
            else:
                outcome, message = HearOutcome.NEARER, replace(known.message, hops=hops)
                self._authors[robot_id] = Neighbor(message, known.heard_ns)  # no younger for it
        except MessageError as error:
            return _IGNORED[HearOutcome(error.cause.value)]
        relays = hops + 1 < self._hop_limit and self._passes_on(message, now_ns, own_cell)
        return Heard(outcome, message, with_hops(data, hops + 1, self._key) if relays else None)

    def _passes_on(self, message: NeighborMessage, now_ns: int, own_cell: Cell | None) -> bool:
        """A message that was relayed before is news to few: those pass it on."""
        if own_cell is None or message.hops > 0:
            return True
        own, others = Place(self._robot_id, own_cell), self._places(now_ns)
        return passes_on(own, _told_place(message), message.seq, others.values(), self._r_comm)

    def _places(self, now_ns: int) -> dict[int, Place]:
        """Where the neighbours are, by id: worked out once for all that is heard in one moment."""
        if now_ns != self._placed_ns:
            fresh = self._not_older(now_ns - self._max_age_ns)
            self._placed_ns, self._placed = now_ns, {neighbor.robot_id: neighbor.place(now_ns) for neighbor in fresh}
        return self._placed

    def _not_older(self, oldest_ns: int) -> list[Neighbor]:
        """Neighbours heard since `oldest_ns`, the last heard first."""
        found = []
        for neighbor in reversed(self._authors.values()):
            if neighbor.heard_ns < oldest_ns:
                break
            found.append(neighbor)
        return found

    def _remember(self, neighbor: Neighbor) -> None:
        robot_id = neighbor.robot_id
        self._authors.pop(robot_id, None)  # so that the new entry is the last
        if len(self._authors) >= MAX_AUTHORS:
            forgotten = next(iter(self._authors))
            del self._authors[forgotten]
            self._placed.pop(forgotten, None)
        self._authors[robot_id] = neighbor
        if neighbor.heard_ns == self._placed_ns:
            self._placed[robot_id] = _told_place(neighbor.message)
        else:
            self._placed_ns = -1


_author = attrgetter("message.robot_id")


def _told_place(message: NeighborMessage) -> Place:
    """Where the author of a message is in the moment in which it is heard: anywhere when it does not know."""
    return Place(message.robot_id, message.cell, math.inf if message.cell[0] < 0 else 0.0)


def _squared_distance(one: Cell, other: Cell) -> int:
    return (one[0] - other[0]) ** 2 + (one[1] - other[1]) ** 2
