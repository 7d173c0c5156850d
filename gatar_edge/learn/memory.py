"""What each robot of an episode hears, and with whom it reckons, as `gatar_edge.agent` does it on a robot."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from gatar_edge.absent import PATIENCE_S, REMEMBER_S
from gatar_edge.learn.jit import compiled
from gatar_edge.learn.kernels import TARGET

Array = npt.NDArray[Any]

REMEMBER = int(REMEMBER_S)  # steps: a robot crosses one cell a second
FRESH = 3  # steps for which a neighbour counts where it was heard: `AgentConfig.max_age_s`
NOBODY = 255  # age of a robot that another one does not reckon with


@compiled
def share(beliefs: Array, hops: Array, out: Array) -> None:
    """Everybody hears everybody within the hop limit: [N, W, H] -> the merged beliefs in `out`."""
    count, size = beliefs.shape[0], beliefs.shape[1] * beliefs.shape[2]
    told, merged = beliefs.reshape(count, size), out.reshape(count, size)  # rows, so that the compiler uses vectors
    for n in range(count):
        row = merged[n]
        row[:] = told[n]
        for m in range(count):
            if m != n and hops[n, m] > 0:
                other = told[m]
                for cell in range(size):
                    row[cell] = max(row[cell], other[cell])


@compiled
def hear(
    hops: Array, loss: float, cells: Array, tasks: Array, step: int, ears: Array, heard: Array, last: Array
) -> None:
    """Who hears whom at this step into `ears` (hops, -1 where nothing came), and what is remembered of everybody.

    `heard` [N, N] is the step, `last` [N, N, 4] the cell and the goal of the newest message.
    """
    count = len(hops)
    for n in range(count):
        for m in range(count):
            ears[n, m] = hops[n, m]
            if hops[n, m] > 0 and loss > 0 and np.random.random() < loss:
                ears[n, m] = -1
            if ears[n, m] > 0:
                heard[n, m] = step
                last[n, m, :2] = cells[m]
                last[n, m, 2:] = tasks[m]


@compiled
def reckon(
    n: int, cells: Array, speeds: Array, ears: Array, r_comm: float, area: int, remember: int, step: int,
    heard: Array, last: Array, out: Array,
) -> None:  # fmt: skip
    """With whom robot `n` reckons, and where, into `out` uint8 [N, 3]: cell and age in steps, `NOBODY` where not.

    As the agent does: what is fresh counts where it was heard; what fell silent, where it is expected, for as long as
    `absent.patience_s` in a world of `area` cells, unless it should be heard there (`absent.out_of_range`).
    """
    alone = True
    for m in range(len(cells)):
        alone &= m == n or heard[n, m] < 0 or step - heard[n, m] > FRESH
    patience = float(remember)
    if not alone and r_comm > 0:
        patience = min(patience, PATIENCE_S * area / (np.pi * r_comm**2))
    for m in range(len(cells)):
        out[m] = NOBODY
        age = step - heard[n, m]
        if m == n:
            out[m, 0], out[m, 1], out[m, 2] = cells[n, 0], cells[n, 1], 0
            continue
        if heard[n, m] < 0 or age > max(remember, 0) or (age > 0 and remember == 0):
            continue
        x, y = last[n, m, 0], last[n, m, 1]
        if age > FRESH:
            if age > patience:
                continue
            gx, gy = last[n, m, 2], last[n, m, 3]
            way = abs(gx - x) + abs(gy - y) if gx >= 0 else 0
            if gx >= 0 and way > 0:
                share_done = min(1.0, age * speeds[m] / way)
                x = int(np.floor(x + share_done * (gx - x) + 0.5))
                y = int(np.floor(y + share_done * (gy - y) + 0.5))
            audible = False
            for k in range(len(cells)):
                if k == n or ears[n, k] == 1:
                    audible |= (cells[k, 0] - x) ** 2 + (cells[k, 1] - y) ** 2 <= r_comm * r_comm
            if audible:
                continue
        out[m, 0], out[m, 1], out[m, 2] = x, y, age


@compiled
def keep_task(n: int, belief: Array, cells: Array, ears: Array, tasks: Array, goals: Array) -> None:
    """A target once taken is kept, as on the robot, unless somebody nearer is on the way to it."""
    x, y = tasks[n, 0], tasks[n, 1]
    if x < 0 or belief[x, y] != TARGET:
        return
    own = abs(cells[n, 0] - x) + abs(cells[n, 1] - y)
    for m in range(len(cells)):
        if m != n and ears[n, m] > 0 and tasks[m, 0] == x and tasks[m, 1] == y:
            other = abs(cells[m, 0] - x) + abs(cells[m, 1] - y)
            if other < own or (other == own and m < n):
                return
    goals[n] = tasks[n]
