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
    mine, here = _turn(own.robot_id, seq), own.cell
    author_id, origin, hearing = author.robot_id, author.cell, r_comm - author.moved_cells
    earlier: list[Place] = []  # those whose turn comes before ours
    in_range: list[Place] = []  # of ours and of the author
    out_of_range: list[Place] = []  # of the author, in ours
    for other in others:
        robot_id, cell, moved = other
        if robot_id == author_id:
            continue
        heard = dist(cell, origin) <= hearing - moved
        if heard and _turn(robot_id, seq) < mine:
            earlier.append(other)
        if dist(cell, here) <= r_comm + moved:
            (in_range if heard else out_of_range).append(other)
    return _lacks(in_range, earlier, r_comm, IN_RANGE_COPIES) or _lacks(
        out_of_range, earlier, r_comm, OUT_OF_RANGE_COPIES
    )


def _lacks(robots: list[Place], senders: list[Place], r_comm: float, copies: int) -> bool:
    """Whether one of the robots is surely told by fewer than `copies` of the senders."""
    if len(senders) < copies:
        return bool(robots)
    for robot_id, cell, moved in robots:
        told, reach = 0, r_comm - moved
        for sender_id, sender, sender_moved in senders:
            if sender_id != robot_id and dist(sender, cell) <= reach - sender_moved:
                told += 1
                if told == copies:
                    break
        else:
            return True
    return False


def _turn(robot_id: int, seq: int) -> int:
    """Ranks the robots, another way for each message."""
    return ((robot_id * 0x9E37 + seq) * 0x85EB & 0xFFFF) << 32 | robot_id
