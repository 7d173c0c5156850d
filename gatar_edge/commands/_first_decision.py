"""A robot in a process of its own, for `gatar bench policy`: how soon it decides, what it weighs, what it costs.

`python -m gatar_edge.commands._first_decision` reads one JSON object from standard input and writes one.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

from gatar_edge.agent import Agent, Identity, Inbox, Outbox
from gatar_edge.allocators.gatar import Gatar
from gatar_edge.config import AgentConfig
from gatar_edge.perception import Perception
from gatar_edge.types import NS_PER_S, GridSpec, RobotKind


def main() -> None:
    """Decide once, then `len(ticks) - 1` times more at `rate_hz` of the real clock."""
    task = json.load(sys.stdin)
    config = AgentConfig(grid=GridSpec(*task["grid"]))
    kind = RobotKind(task["kind"])
    allocator = Gatar(Path(task["model"]) if task["model"] else None, config)
    agent = Agent(Identity(task["robot_id"], kind, 1.0), config, allocator, bytes.fromhex(task["key"]))
    perception = Perception(task["robot_id"], kind, config.grid)
    period_ns = int(NS_PER_S / task["rate_hz"])
    now_ns = 10 * NS_PER_S
    arrived = [(bytes.fromhex(seen), tuple(map(bytes.fromhex, told))) for seen, told in task["ticks"]]

    def tick(number: int) -> Outbox:
        seen, told = arrived[number]
        at_ns = now_ns + number * period_ns
        return agent.tick(at_ns, Inbox(perception.take(seen, at_ns, None), told))

    first = tick(0)
    first_s = time.monotonic() - task["started_s"]
    cpu_s, since_s = time.process_time(), time.monotonic()
    for number in range(1, len(arrived)):
        time.sleep(max(0.0, since_s + number / task["rate_hz"] - time.monotonic()))
        tick(number)
    used = (time.process_time() - cpu_s) / (time.monotonic() - since_s)
    figures = {
        "first_decision_s": round(first_s, 3),
        "decided_by": first.decision.allocator,
        "robots": len(first.decision.robots),
        "percent_of_core": round(100 * used, 2),
        "rss_mb": round(_resident_mb(), 1),
    }
    json.dump(figures, sys.stdout)


def _resident_mb() -> float:
    status = Path("/proc/self/status").read_text()
    return int(status.partition("VmRSS:")[2].split()[0]) / 1024


if __name__ == "__main__":
    main()
