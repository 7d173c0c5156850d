"""How long one decision takes, part by part, on scenes of N robots: what `gatar bench policy` prints."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from gatar_edge.allocators.base import in_id_order
from gatar_edge.allocators.gatar import Gatar, decode
from gatar_edge.errors import ModelError
from gatar_edge.features import Inputs
from gatar_edge.perception import Perception
from gatar_edge.policy import Policy
from gatar_edge.scenes import EGO, KEY, SIZE, Scene, inputs_of, make_scene, tick
from gatar_edge.types import NS_PER_S

PARTS = ("view", "features", "policy", "decode", "tick", "torch")
SCENES = 10  # different ones for each number of robots
WARM_UP = 2  # calls a scene that are not counted
PERIOD_NS = NS_PER_S // 5
Eager = Callable[[Inputs], object]
Result = TypeVar("Result")


@dataclass(slots=True)
class Clock:
    """Times of one part, wall and CPU of the whole process, in ns."""

    wall_ns: list[int] = field(default_factory=list)
    cpu_ns: list[int] = field(default_factory=list)

    def time(self, call: Callable[[], Result], counts: bool) -> Result:
        """Call, and keep the time where it counts."""
        cpu_ns, wall_ns = time.process_time_ns(), time.perf_counter_ns()
        result = call()
        wall_ns, cpu_ns = time.perf_counter_ns() - wall_ns, time.process_time_ns() - cpu_ns
        if counts:
            self.wall_ns.append(wall_ns)
            self.cpu_ns.append(cpu_ns)
        return result

    def figures(self) -> dict[str, float]:
        """Microseconds: median and 99th percentile of the wall clock, mean of the CPU."""
        p50, p99 = np.percentile(self.wall_ns, [50, 99]) / 1e3
        return {"p50_us": round(p50, 1), "p99_us": round(p99, 1), "cpu_us": round(np.mean(self.cpu_ns) / 1e3, 1)}


def measure(allocator: Gatar, robots: int, targets: int, repeats: int, eager: Eager | None) -> dict[str, Any]:
    """Times of every part with so many robots, each `SCENES` x `repeats` times; `eager` is the network in torch."""
    clocks = {part: Clock() for part in PARTS}
    for seed in range(SCENES):
        _measure_scene(allocator, make_scene(robots, targets, seed), repeats, eager, clocks)
    timed = {part: clock.figures() for part, clock in clocks.items() if clock.wall_ns}
    return {"robots": robots, "candidates": targets, **timed}


def _measure_scene(allocator: Gatar, scene: Scene, repeats: int, eager: Eager | None, clocks: dict[str, Clock]) -> None:
    policy, agent = allocator.policy, scene.agent(allocator)
    perception = Perception(EGO, scene.kind, scene.config.grid)
    for number in range(WARM_UP + repeats):
        now_ns = (number + 10) * PERIOD_NS
        arrived = scene.datagrams(number + 1)
        outbox = clocks["tick"].time(partial(tick, agent, perception, arrived, now_ns), counts=number >= WARM_UP)
        if outbox.decision.fallback:
            raise ModelError(f"{policy.path.name}: the model failed on a scene: {outbox.decision.fallback}")
    view = agent.view(now_ns, scene.observation)
    read = policy.manifest.looks_ahead, policy.manifest.reads_windows
    inputs = inputs_of(view, *read)
    output = policy.run(inputs)
    scores, possible, order = output.scores, inputs["valid"].astype(np.bool_), in_id_order(view)
    calls: dict[str, Callable[[], object]] = {
        "view": lambda: agent.view(now_ns, scene.observation),
        "features": lambda: inputs_of(view, *read),
        "policy": lambda: policy.run(inputs),
        "decode": lambda: decode(scores, possible, order),
    }
    if eager is not None:
        calls["torch"] = lambda: eager(inputs)
    for number in range(WARM_UP + repeats):
        for part, call in calls.items():
            clocks[part].time(call, counts=number >= WARM_UP)


def eager_network(policy: Policy) -> Eager | None:
    """The same network in torch on one thread, or None where torch or the weights are not there."""
    try:
        import torch

        from gatar_edge.export.verify import network_of
    except ImportError:
        return None
    if not policy.path.with_suffix(".safetensors").is_file():
        return None
    torch.set_num_threads(1)
    network = network_of(policy.path, policy).float()

    def run(inputs: Inputs) -> object:
        with torch.inference_mode():
            return network(*(torch.from_numpy(np.ascontiguousarray(inputs[name])) for name in network.inputs))

    return run


def measure_process(model: Path | None, robots: int, targets: int, seconds: float, rate_hz: float) -> dict[str, Any]:
    """A fresh process: seconds from its start to its first decision, its memory, its share of a core.

    Raises ModelError where it fails, as with a model that was trained for other ranges than a robot has by default.
    """
    scene = make_scene(robots, targets, seed=0)
    ticks = [scene.datagrams(number + 1) for number in range(1 + round(seconds * rate_hz))]
    task = {
        "model": str(model) if model else "",
        "grid": [SIZE, SIZE],
        "kind": int(scene.kind),
        "robot_id": EGO,
        "key": KEY.hex(),
        "rate_hz": rate_hz,
        "started_s": time.monotonic(),  # the same clock in all processes
        "ticks": [[seen.hex(), [message.hex() for message in told]] for seen, told in ticks],
    }
    line = [sys.executable, "-m", "gatar_edge.commands._first_decision"]
    done = subprocess.run(line, input=json.dumps(task), capture_output=True, text=True, check=False)
    if done.returncode:
        said = done.stderr.strip().splitlines()
        raise ModelError(f"the measured process failed: {said[-1] if said else f'exit code {done.returncode}'}")
    figures: dict[str, Any] = json.loads(done.stdout)
    return {"rate_hz": rate_hz, **figures}
