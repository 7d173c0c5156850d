"""Who passes a message on: not everybody that heard it, but a few of them for each robot that may lack it.

Twelve robots that all hear each other would send every message twelve times. All of them know about where the others
are, so each works out by itself whether it is its turn:

Rule 1: a robot surely in the author's range is passed the message `IN_RANGE_COPIES` times, for the case that it was
        lost on the way; any other one `OUT_OF_RANGE_COPIES` times, for to it that may be the only way.
Rule 2: the turn goes to robots that surely hear the author and reach the one that lacks it, in an order that changes
        with each message: no single bad link silences an author.
Rule 3: in doubt, pass it on. A robot may have moved since it was heard: "surely" means wherever it may be by now.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import dist
from typing import NamedTuple

from gatar_edge.types import Cell

IN_RANGE_COPIES = 2
OUT_OF_RANGE_COPIES = 3


class Place(NamedTuple):
    """Where a robot was when it was heard last, and how far it may have gone since then."""

    robot_id: int
    cell: Cell
    moved_cells: float = 0.0


def passes_on(own: Place, author: Place, seq: int, others: Iterable[Place], r_comm: float) -> bool:
    """Whether robot `own`, which heard message `seq` from its author, sends it on; `others` are the robots it knows of.

    `r_comm` is the range of radio in cells. In plain loops, because a robot asks this of each message that it hears.
    """
    mine, hearing = _turn(own.robot_id, seq), r_comm - author.moved_cells
    earlier: list[Place] = []  # those whose turn comes before ours
    lacking: list[tuple[Place, int]] = []
    for other in others:
        robot_id, cell, moved = other
        if robot_id == author.robot_id:
            continue
        heard = dist(cell, author.cell) <= hearing - moved
        if heard and _turn(robot_id, seq) < mine:
            earlier.append(other)
        if dist(cell, own.cell) <= r_comm + moved:
            lacking.append((other, IN_RANGE_COPIES if heard else OUT_OF_RANGE_COPIES))
    for (robot_id, cell, moved), copies in lacking:
        told = 0
        for sender_id, sender, sender_moved in earlier:
            told += dist(sender, cell) <= r_comm - moved - sender_moved and sender_id != robot_id
            if told == copies:
                break
        else:
            return True
    return False


def _turn(robot_id: int, seq: int) -> int:
    """Ranks the robots, another way for each message."""
    return ((robot_id * 0x9E37 + seq) * 0x85EB & 0xFFFF) << 32 | robot_id
