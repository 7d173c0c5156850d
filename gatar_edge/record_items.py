"""Values of the runtime in the form in which the log holds them."""

from __future__ import annotations

import base64
import struct
from typing import Any

from gatar_edge import channels as ch
from gatar_edge.errors import MessageError
from gatar_edge.message import unpack
from gatar_edge.types import Cells, Goto, Hold, Mission, VehicleCommand

EFFECTIVE = frozenset(("accepted", "nearer"))  # outcomes of a datagram that changed what a robot knows


def command_record(command: VehicleCommand) -> dict[str, Any]:
    """A command as the log holds it."""
    match command:
        case Goto(cell):
            return {"type": "goto", "cell": cell}
        case Mission(cells):
            return {"type": "mission", "cells": cells}
        case Hold(reason):
            return {"type": "hold", "reason": reason}


def radio_item(datagram: bytes, way: ch.RadioWay, outcome: str, now_ns: int, keep: bool) -> ch.RadioItem:
    """One datagram as the log holds it, its bytes only where `keep`; its claims where it is a message."""
    try:
        message = unpack(datagram)
    except (MessageError, struct.error) as error:
        return ch.RadioItem(now_ns, way, outcome or type(error).__name__, size=len(datagram))
    return ch.RadioItem(
        t_ns=now_ns,
        way=way,
        outcome=outcome,
        author=message.robot_id,
        seq=message.seq,
        hops=message.hops,
        sent_ms=message.t_ms,
        cell=message.cell,
        task=message.task,
        task_cell=message.task_cell,
        cost=message.cost,
        size=len(datagram),
        data=base64.b64encode(datagram).decode() if keep else "",
    )


def flat_cells(cells: Cells) -> list[int]:
    """Cells [n, 2] as x0, y0, x1, y1, ..."""
    flat: list[int] = cells.reshape(-1).tolist()
    return flat
