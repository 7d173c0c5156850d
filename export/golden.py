"""Makes the golden vectors of a folder of models, which `gatar selftest` replays: what torch says in double precision.

Only scenes are taken whose decisions stay the same when the scores are shaken a hundred times harder than another
processor would: a selftest must not fail for a tie.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from gatar_edge.allocators.gatar import Gatar
from gatar_edge.errors import ModelError
from gatar_edge.export.verify import network_of
from gatar_edge.features import LENGTH_SCALE_CELLS, Inputs
from gatar_edge.manifest import OUTPUTS
from gatar_edge.policy import Policy, PolicyOutput
from gatar_edge.scenes import CONFIG, inputs_of, make_scene
from gatar_edge.selftest import (
    ARRAYS,
    FORMAT_VERSION,
    OUTPUT_TOLERANCE,
    TEXT,
    Golden,
    decision_of,
    features_key,
    robot_of,
    sha256,
    view_of,
)

SIZES = ((1, 0), (5, 7), (12, 25))  # robots, targets
SHAKE = 1e-3  # of each score, relative
SHAKES = 20
MOST_SEEDS = 200


class Shaken(Policy):
    """A policy whose scores are a little off, each time in another way."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._rng = np.random.default_rng(0)

    def run(self, inputs: Inputs) -> PolicyOutput:
        output = super().run(inputs)
        noise = self._rng.uniform(1 - SHAKE, 1 + SHAKE, output.scores.shape).astype(np.float32)
        return replace(output, scores=output.scores * noise)


def record(folder: Path) -> tuple[Path, Path]:
    """Write the golden files for all models in `folder`. Raises ModelError where one is not equal to its weights."""
    paths = sorted(folder.glob("*.onnx"))
    if not paths:
        raise ModelError(f"{folder} holds no .onnx file")
    scenes: list[dict[str, Any]] = []
    arrays: dict[str, Any] = {}
    for number, (robots, targets) in enumerate(SIZES):
        scene, belief = _clear_scene(robots, targets, paths)
        scenes.append(scene)
        arrays[f"{number}/belief"] = belief
        arrays |= _expected(Golden(folder, scenes, {}, arrays), number, paths)
    text = {"format": FORMAT_VERSION, "models": {path.name: sha256(path) for path in paths}, "scenes": scenes}
    (folder / TEXT).write_text(json.dumps(text, indent=1) + "\n")
    np.savez_compressed(folder / ARRAYS, **arrays)
    return folder / TEXT, folder / ARRAYS


def _clear_scene(robots: int, targets: int, paths: list[Path]) -> tuple[dict[str, Any], Any]:
    """The first scene in which no model's decision hangs on a hair, and its belief."""
    for seed in range(MOST_SEEDS):
        made = make_scene(robots, targets, seed)
        seen, told = made.datagrams(1)
        scene = {"kind": int(made.kind), "observation": seen.hex(), "messages": [data.hex() for data in told]}
        decisions = {path.name: _clear_decision(scene, made.belief, path) for path in paths}
        if all(decisions.values()):
            return {**scene, "decisions": decisions}, made.belief
    raise ModelError(f"in {MOST_SEEDS} scenes of {robots} robots, some model's decision always hung on a hair")


def _clear_decision(scene: dict[str, Any], belief: Any, path: Path) -> dict[str, Any] | None:
    allocator = Gatar(path, CONFIG)
    decision = decision_of(robot_of(scene, belief, allocator)[0])
    allocator.policy = Shaken(path)
    shaken = (decision_of(robot_of(scene, belief, allocator)[0]) for _ in range(SHAKES))
    return decision if all(other == decision for other in shaken) else None


def _expected(golden: Golden, number: int, paths: list[Path]) -> dict[str, Any]:
    view = view_of(golden, number)
    found: dict[str, Any] = {f"{number}/{name}": getattr(view, name) for name in ("targets", "lengths", "hops")}
    for ahead in (False, True):
        prefix = features_key(number, ahead)
        found |= {prefix + name: array for name, array in inputs_of(view, ahead).items()}
    for path in paths:
        policy = Policy(path)
        inputs = inputs_of(view, policy.manifest.looks_ahead)
        for name, array in _in_torch(path, policy, inputs).items():
            gap = float(np.abs(array - getattr(policy.run(inputs), name)).max(initial=0.0))
            if gap > OUTPUT_TOLERANCE:
                raise ModelError(f"{path.name}: {name} differs from its weights by {gap:.1e}: run `gatar verify`")
            found[f"{number}/{path.name}/{name}"] = array
    return found


def _in_torch(path: Path, policy: Policy, inputs: Inputs) -> dict[str, Any]:
    network = network_of(path, policy)
    arrays = (np.ascontiguousarray(inputs[name]) for name in network.inputs)
    tensors = (torch.from_numpy(array.astype(np.float64) if array.dtype.kind == "f" else array) for array in arrays)
    with torch.inference_mode():
        found = dict(zip(OUTPUTS, (output.numpy() for output in network(*tensors)), strict=True))
    found["xy"] = found["xy"] * LENGTH_SCALE_CELLS  # as `Policy` gives it
    return found
