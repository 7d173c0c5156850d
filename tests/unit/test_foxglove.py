"""What viewers are shown costs no memory once it is written: a log goes on for days."""

from __future__ import annotations

import ctypes
import gc
from collections.abc import Callable

import numpy as np
import pytest

from gatar_edge import foxglove
from gatar_edge.foxglove import Level
from gatar_edge.types import (
    NS_PER_S,
    Assignment,
    CellState,
    Decision,
    GridSpec,
    Reason,
    RobotKind,
    TaskKind,
    VehicleState,
)

SPEC = GridSpec(width=100, height=100)
STATES = np.zeros((SPEC.width, SPEC.height), dtype=np.uint8)
STATES[3, :4] = (CellState.OBSTACLE, CellState.TARGET, CellState.LOCALIZED, CellState.FREE)
EXPLORES = Assignment(TaskKind.EXPLORE, (2, 1), Reason.FRONTIER, ((1, 1), (2, 1)))
DECISION = Decision(1, 0, 0, (1, 1), EXPLORES, "greedy", "", False, (), (), (), ())
TIMES = 200
MOST_KEPT_BYTES = TIMES * 500  # a twentieth of the maps that were written

MESSAGES: dict[str, Callable[[int], bytes]] = {
    "frame": lambda now_ns: foxglove.frame(1, now_ns / NS_PER_S % 9, 1.0, SPEC, now_ns),
    "grid": lambda now_ns: foxglove.grid(STATES, SPEC, now_ns),
    "image": lambda now_ns: foxglove.image(STATES, now_ns),
    "location": lambda now_ns: foxglove.location(VehicleState(now_ns, lat_deg=now_ns % 9, position_t_ns=now_ns), 1),
    "log_line": lambda now_ns: foxglove.log_line(Level.INFO, 1, f"{now_ns} " * 200, now_ns),
    "map_scene": lambda now_ns: foxglove.map_scene(STATES, SPEC, now_ns),
    "robot_scene": lambda now_ns: foxglove.robot_scene(DECISION, RobotKind.UAV, SPEC, now_ns),
}


class _MallocInfo(ctypes.Structure):
    """mallinfo2(3)."""

    _fields_ = [
        (name, ctypes.c_size_t)
        for name in (
            *("arena", "ordblks", "smblks", "hblks", "hblkhd"),
            *("usmblks", "fsmblks", "uordblks", "fordblks", "keepcost"),
        )
    ]


def allocated_bytes() -> int:
    """What the C library has handed out and not got back. Protobuf's messages are not among Python's objects."""
    mallinfo = getattr(ctypes.CDLL(None), "mallinfo2", None)
    if mallinfo is None:
        pytest.skip("the C library is no glibc of 2.33 or newer")
    mallinfo.restype = _MallocInfo
    gc.collect()
    info = mallinfo()
    return int(info.uordblks) + int(info.hblkhd)


@pytest.mark.parametrize("name", MESSAGES)
def test_a_message_that_is_written_is_forgotten(name: str) -> None:
    for turn in range(TIMES // 10):  # fills what is kept for good
        MESSAGES[name](turn * NS_PER_S)
    before = allocated_bytes()
    for turn in range(TIMES):
        MESSAGES[name](turn * NS_PER_S)
    assert allocated_bytes() - before < MOST_KEPT_BYTES


def test_a_grid_is_that_of_its_own_call_alone() -> None:
    first = foxglove.grid(STATES, SPEC, 1)
    foxglove.grid(STATES + 1, SPEC, 2 * NS_PER_S)
    assert foxglove.grid(STATES, SPEC, 1) == first
    assert np.array_equal(foxglove.read_grid(first).cells, STATES)
