"""The one interface behind which learned and classical rules stand, with exactly the same input."""

from __future__ import annotations

from functools import lru_cache
from typing import Protocol, runtime_checkable

import msgspec
import numpy as np
import numpy.typing as npt

from gatar_edge.types import Cell, Floats, RobotState
from gatar_edge.view import View

NO_TARGET = -1
Choices = npt.NDArray[np.int32]


class Allocation(msgspec.Struct, frozen=True):
    """What an allocator proposes for every robot of a view; ego is row 0."""

    choices: Choices  # [N], index into view.targets or NO_TARGET
    scores: Floats  # [N, M], higher is better, -inf where impossible
    xy: tuple[float, float] | None = None  # the paper's output for ego, in cells
    attention: tuple[float, ...] = ()  # of ego over the robots of the graph
    steady: bool = False  # weighs what robots are doing itself: its choice stands even where tasks are kept
    frontier: Cell | None = None  # where ego is to go and look; None leaves it to the rule of `explore`
    absent: tuple[RobotState, ...] = ()  # robots out of range that it reckoned with
    kept_for_absent: tuple[int, ...] = ()  # like `choices`, of the robots in `absent`


class Allocator(Protocol):
    """A rule that assigns known targets to the robots of one view."""

    @property
    def name(self) -> str:
        """As given to --allocator."""

    def allocate(self, view: View) -> Allocation:
        """Propose a target for every robot of the view. Must be deterministic."""


@runtime_checkable
class Negotiator(Allocator, Protocol):
    """An allocator that talks to its like on the robots in range; one instance a robot."""

    def bid(self, view: View) -> tuple[bytes, ...]:
        """What to tell them now: payloads for `talk`, each to be understood without the others."""

    def heard(self, payload: bytes, now_ns: int) -> None:
        """Take in what one of them told. Never raises for what was sent."""


def scores_of(times: npt.NDArray[np.float64]) -> Floats:
    """Scores of a rule that goes by travel time [N, M]: sooner is better."""
    return (-times).astype(np.float32)


def in_id_order(view: View) -> npt.NDArray[np.int64]:
    """Rows of the view sorted by robot id: every robot of a graph breaks ties in this order."""
    return _order_of(tuple([robot.robot_id for robot in view.robots]))


@lru_cache(maxsize=256)  # a team stays together for many ticks
def _order_of(ids: tuple[int, ...]) -> npt.NDArray[np.int64]:
    order = np.array(sorted(range(len(ids)), key=ids.__getitem__), dtype=np.int64)
    order.flags.writeable = False
    return order
