"""The consensus-based bundle algorithm (Choi, Brunet, How 2009): robots bid for bundles of targets over the radio.

Phase 1: each robot adds to its bundle the target that gains it most, while it outbids all bids that it knows; a target
gains `DISCOUNT` ** (time of arrival), less what it delays others on the path. Phase 2: robots in range tell each other
bundles, own ones and heard ones; of each robot the latest counts. (The paper exchanges the winners that follow from the
bundles, and times of contact to tell which are later. Bundles numbered by their bidder say the same, and survive lost
and overtaken datagrams without a table of cases.) A bid that was overbid makes its bidder build its bundle anew.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gatar_edge.allocators.base import NO_TARGET, Allocation, scores_of
from gatar_edge.grid import UNREACHABLE
from gatar_edge.types import NS_PER_S, Cell
from gatar_edge.view import View, target_legs, travel_times

BUNDLE = 3
DISCOUNT = 0.95  # of a target's worth per second until its visit
MAX_AGE_MS = 3000  # a bundle not renewed for this long is a bundle of nobody
MAX_ROBOTS = 256  # remembered
MAX_PAYLOAD_BYTES = 109  # of `talk`

_UNIT = 1 << 31  # bids travel as whole numbers, so that all compare the same ones
_ENTRY = struct.Struct(">HIHB")  # robot_id, version, age_ms, stops
_STOP = struct.Struct(">hhI")  # cell, bid
_MS = NS_PER_S // 1000

Seconds = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Bundle:
    """What one robot bids for, in the order of its path."""

    robot_id: int
    version: int  # rises with each bundle of the robot, modulo 2^32
    born_ns: int  # when it was made, by the local clock as far as ages tell
    stops: tuple[tuple[Cell, int], ...]  # cell and bid

    def encoded(self, now_ns: int) -> bytes:
        """The entry of a payload."""
        age_ms = min(max(0, now_ns - self.born_ns) // _MS, 0xFFFF)
        head = _ENTRY.pack(self.robot_id, self.version, age_ms, len(self.stops))
        return head + b"".join(_STOP.pack(*cell, bid) for cell, bid in self.stops)


class Cbba:
    """One robot's part of the auction. Remembers what the others bid: one instance a robot."""

    name = "cbba"

    def __init__(self) -> None:
        self._bundles: dict[int, Bundle] = {}  # of the others
        self._version = 0

    def allocate(self, view: View) -> Allocation:
        """See `allocators.base.Allocator`: first stops of the own bundle and of those heard."""
        index_of = {(int(x), int(y)): index for index, (x, y) in enumerate(view.targets)}
        choices = np.full(len(view.robots), NO_TARGET, dtype=np.int32)
        bundles = {bundle.robot_id: bundle for bundle in (*self._fresh(view.now_ns), self._own(view))}
        for row, robot in enumerate(view.robots):
            stops = bundles[robot.robot_id].stops if robot.robot_id in bundles else ()
            choices[row] = next((index_of[cell] for cell, _ in stops if cell in index_of), NO_TARGET)
        return Allocation(choices, scores_of(travel_times(view)))

    def bid(self, view: View) -> tuple[bytes, ...]:
        """See `allocators.base.Negotiator`: the own bundle and all fresh ones heard, as many a payload as fit."""
        # by the clock, so that a robot which was started again is not taken for its own past
        self._version = max(self._version + 1, view.now_ns // _MS)
        payloads = [b""]
        for bundle in (self._own(view), *self._fresh(view.now_ns)):
            entry = bundle.encoded(view.now_ns)
            if len(payloads[-1]) + len(entry) > MAX_PAYLOAD_BYTES:
                payloads.append(b"")
            payloads[-1] += entry
        return tuple(payloads)

    def heard(self, payload: bytes, now_ns: int) -> None:
        """See `allocators.base.Negotiator`. What is cut off or no bundle is left out."""
        for bundle in decoded(payload, now_ns):
            known = self._bundles.get(bundle.robot_id)
            if known is not None and not _later(bundle.version, known.version):
                continue
            if known is not None or len(self._bundles) < MAX_ROBOTS:
                self._bundles[bundle.robot_id] = bundle

    def _fresh(self, now_ns: int) -> list[Bundle]:
        for bundle in list(self._bundles.values()):
            if now_ns - bundle.born_ns > MAX_AGE_MS * _MS:
                del self._bundles[bundle.robot_id]
        return [self._bundles[robot_id] for robot_id in sorted(self._bundles)]

    def _own(self, view: View) -> Bundle:
        ego = view.robots[0].robot_id
        self._bundles.pop(ego, None)  # what others remember of us is not news
        best: dict[Cell, tuple[int, int]] = {}  # bid and bidder; of equal bids the lower id's wins
        for bundle in self._fresh(view.now_ns):
            for cell, bid in bundle.stops:
                best[cell] = max(best.get(cell, (0, 0)), (bid, -bundle.robot_id))
        to_beat = [best.get((int(x), int(y)), (0, -ego)) for x, y in view.targets]
        stops = build_bundle(view, to_beat)
        return Bundle(ego, self._version & 0xFFFF_FFFF, view.now_ns, stops)


def build_bundle(view: View, to_beat: list[tuple[int, int]]) -> tuple[tuple[Cell, int], ...]:
    """Phase 1: ego's bundle, in the order of its path. `to_beat`: per target the best bid and minus its bidder."""
    ego = view.robots[0]
    first = np.where(view.lengths[0] == UNREACHABLE, np.inf, view.lengths[0]) / ego.speed_cells_s
    legs = target_legs(view, ego.kind) / ego.speed_cells_s
    path: list[int] = []
    bids: dict[int, int] = {}
    while len(path) < BUNDLE:
        gains, places = _gains(path, first, legs)
        offers = (np.minimum(gains, 1) * _UNIT).astype(np.int64).tolist()  # a stop on a shorter way may seem worth more
        open_to_ego = [
            target
            for target, offer in enumerate(offers)
            if offer > 0 and target not in bids and (offer, -ego.robot_id) > to_beat[target]
        ]
        if not open_to_ego:
            break
        best = max(open_to_ego, key=offers.__getitem__)
        path.insert(int(places[best]), best)
        bids[best] = offers[best]
    return tuple(((int(view.targets[stop, 0]), int(view.targets[stop, 1])), bids[stop]) for stop in path)


def _gains(path: list[int], first: Seconds, legs: Seconds) -> tuple[Seconds, npt.NDArray[np.int64]]:
    """What each target adds to the worth of a path where it fits best, and that place: [M] both."""
    arrivals: list[float] = []
    for before, stop in zip([-1, *path], path, strict=False):
        arrivals.append(float(first[stop]) if before < 0 else arrivals[-1] + float(legs[before, stop]))
    best, places = np.zeros(len(first)), np.zeros(len(first), dtype=np.int64)
    for place in range(len(path) + 1):
        reach = first if place == 0 else arrivals[place - 1] + legs[path[place - 1]]
        gain = DISCOUNT**reach
        if place < len(path):
            delay = reach + legs[:, path[place]] - arrivals[place]
            for arrival in arrivals[place:]:
                gain = gain + DISCOUNT ** (arrival + delay) - DISCOUNT**arrival
        better = gain > best
        best, places = np.where(better, gain, best), np.where(better, place, places)
    return best, places


def decoded(payload: bytes, now_ns: int) -> list[Bundle]:
    """The bundles in a payload, up to the first byte that is none. Never raises."""
    bundles: list[Bundle] = []
    at = 0
    while len(payload) - at >= _ENTRY.size:
        robot_id, version, age_ms, count = _ENTRY.unpack_from(payload, at)
        at += _ENTRY.size
        if count > BUNDLE or len(payload) - at < count * _STOP.size:
            break
        stops = [_STOP.unpack_from(payload, at + place * _STOP.size) for place in range(count)]
        at += count * _STOP.size
        if age_ms <= MAX_AGE_MS:
            born_ns = now_ns - age_ms * _MS
            bundles.append(Bundle(robot_id, version, born_ns, tuple(((x, y), bid) for x, y, bid in stops)))
    return bundles


def _later(version: int, than: int) -> bool:
    """Of two versions modulo 2^32, the one less than half a turn ahead is the later."""
    return 0 < (version - than) & 0xFFFF_FFFF < 1 << 31
