"""Who passes a message on: not everybody that heard it, but a few of them for each robot that may lack it.

Twelve robots that all hear each other would send every message twelve times. All of them know about where the others
are, so each works out by itself whether it is its turn:

Rule 1: a robot surely in the author's range is passed the message once, for the case that it was lost on the way;
        any other one twice, for to it that may be the only way.
Rule 2: the turn goes to robots that surely hear the author and reach the one that lacks it, in an order that changes
        with each message: no single bad link silences an author.
Rule 3: in doubt, pass it on. A robot may have moved since it was heard: "surely" means wherever it may be by now.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
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

    `r_comm` is the range of radio in cells.
    """
    mine, dist = _turn(own.robot_id, seq), math.dist
    author_id, author_cell, author_moved_cells = author
    earlier: list[Place] = []  # those whose turn comes before ours
    lacking: list[tuple[Place, int]] = []
    for other in others:
        robot_id, cell, moved_cells = other
        if robot_id == author_id:
            continue
        heard = dist(cell, author_cell) <= r_comm - moved_cells - author_moved_cells
        if heard and _turn(robot_id, seq) < mine:
            earlier.append(other)
        if dist(cell, own.cell) <= r_comm + moved_cells:
            lacking.append((other, IN_RANGE_COPIES if heard else OUT_OF_RANGE_COPIES))
    return any(not _is_reached(other, copies, earlier, r_comm) for other, copies in lacking)


def _is_reached(place: Place, copies: int, senders: list[Place], r_comm: float) -> bool:
    """Whether at least so many of the senders surely reach a robot."""
    if len(senders) < copies:
        return False
    for sender in senders:
        if sender is not place and (
            math.dist(sender.cell, place.cell) <= r_comm - sender.moved_cells - place.moved_cells
        ):
            copies -= 1
            if not copies:
                return True
    return False


def _turn(robot_id: int, seq: int) -> tuple[int, int]:
    """Ranks the robots, another way for each message."""
    return (robot_id * 0x9E37 + seq) * 0x85EB & 0xFFFF, robot_id
