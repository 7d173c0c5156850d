"""The contract inside a model file: what it was trained to read, and the refusal of a model that reads something else.

One JSON object in the ONNX metadata under `KEY`. `FIXED` lists the fields that must equal what this version's feature
code makes; ranges (`r_sense`, `r_comm`) must contain the configuration of the robot.
"""

from __future__ import annotations

import hashlib
import json
import sys
from dataclasses import dataclass
from typing import Any

import numpy as np

from gatar_edge import features
from gatar_edge.config import AgentConfig
from gatar_edge.errors import ModelError
from gatar_edge.features import MAX_CANDIDATES

KEY = "gatar"
FORMAT_VERSION = 1
MAX_ROBOTS = 64
OUTPUTS: dict[str, tuple[str, ...]] = {"scores": ("N", "M+1"), "xy": ("xy",), "attention": ("N",)}
UNITS = {"cell": "grid cell", "time": "s", "speed": "cells/s", "xy": "10 cells from ego"}
DTYPES = {"cells": "int64", "hops": "int64"}  # all others float32
LARGEST_MANIFEST = 1 << 20  # characters
GOLDEN_SCALE = 128  # of the numbers in the golden digest: none of them lies near the edge of rounding


@dataclass(frozen=True, slots=True)
class Manifest:
    """A model's contract as read from its file."""

    fields: dict[str, Any]

    @property
    def name(self) -> str:
        return str(self.fields["name"])

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the inputs that the model takes, of those in `features.AXES`."""
        return tuple(self.fields["inputs"])

    @property
    def looks_ahead(self) -> bool:
        """Whether the model has frontiers among its candidates, and robots that are out of range among its robots."""
        return "places" in self.inputs

    @property
    def reads_windows(self) -> bool:
        """Whether the model reads the maps round each robot."""
        return "maps" in self.inputs


def fixed_fields() -> dict[str, Any]:
    """What this version's features are, as the contract says it."""
    return {
        "format": FORMAT_VERSION,
        "features_version": features.FEATURES_VERSION,
        "channels": list(features.CHANNELS),
        "robot_features": list(features.ROBOT_FEATURES),
        "pair_features": list(features.PAIR_FEATURES),
        "place_features": list(features.PLACE_FEATURES),
        "window": features.WINDOW,
        "sigma": features.SIGMA,
        "epsilon": features.EPSILON,
        "outputs": {name: list(axes) for name, axes in OUTPUTS.items()},
        "units": UNITS,
        "max_robots": MAX_ROBOTS,
        "max_candidates": MAX_CANDIDATES,
        "golden_input": golden_digest(),
    }


def input_fields(names: tuple[str, ...]) -> dict[str, Any]:
    """Axes and type of each input, as the contract says it."""
    return {name: {"axes": list(features.AXES[name]), "dtype": DTYPES.get(name, "float32")} for name in names}


def parse(text: str | None, where: str) -> Manifest:
    """Read and check the contract. Raises ModelError naming the field, the model's value and ours."""
    if text is None:
        raise ModelError(f"{where}: no gatar contract in the file's metadata: not a model of gatar-edge")
    if len(text) > LARGEST_MANIFEST:
        raise ModelError(f"{where}: contract of {len(text)} characters, at most {LARGEST_MANIFEST} are read")
    try:
        fields = json.loads(text)
    except ValueError as error:
        raise ModelError(f"{where}: the contract is not JSON: {error}") from None
    if not isinstance(fields, dict):
        raise ModelError(f"{where}: the contract is not a JSON object")
    expected = fixed_fields()
    for name, ours in expected.items():
        _equal(where, name, fields.get(name), ours)
    inputs = fields.get("inputs")
    if not isinstance(inputs, dict) or not inputs:
        raise ModelError(f"{where}: field inputs is {inputs!r}, expected an object of input names")
    for name, theirs in inputs.items():
        known = input_fields((name,))[name] if name in features.AXES else None
        _equal(where, f"inputs.{name}", theirs, known)
    for name in ("name", "levels", "r_sense", "r_comm", "opset", "git_revision", "training"):
        if name not in fields:
            raise ModelError(f"{where}: field {name} is missing in the contract")
    for name in ("r_sense", "r_comm"):
        if not _is_range(fields[name]):
            raise ModelError(f"{where}: field {name} is {fields[name]!r:.80}, expected [lowest, highest]")
    return Manifest(fields)


def check_config(manifest: Manifest, config: AgentConfig, where: str) -> None:
    """Raises ModelError where the robot's configuration is outside what the model was trained for."""
    _equal(where, "levels", manifest.fields["levels"], config.hop_limit)
    for name, ours in (("r_sense", config.r_sense), ("r_comm", config.r_comm)):
        low, high = manifest.fields[name]
        if not low <= ours <= high:
            raise ModelError(f"{where}: field {name} is {low:g} to {high:g} cells, the robot is configured to {ours:g}")
    if config.max_candidates > MAX_CANDIDATES or config.max_neighbors >= MAX_ROBOTS:
        raise ModelError(
            f"{where}: at most {MAX_ROBOTS - 1} neighbours and {MAX_CANDIDATES} candidates, the robot is configured "
            f"to {config.max_neighbors} and {config.max_candidates}"
        )


def _is_range(value: Any) -> bool:
    """Whether `value`, as read from JSON, is a pair of finite numbers."""
    return isinstance(value, list) and len(value) == 2 and all(_is_finite(number) for number in value)


def _is_finite(value: Any) -> bool:
    # whole numbers of JSON have no largest; a comparison with NaN is false
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= sys.float_info.max


def _equal(where: str, name: str, theirs: Any, ours: Any) -> None:
    if theirs != ours:
        raise ModelError(f"{where}: field {name} is {theirs!r}, this version needs {ours!r}: export the model again")


def golden_view() -> features.ViewArrays:
    """A fixed small view with a wall, an unreachable pair, a claimed task, a frontier and two robots out of earshot."""
    belief = np.ones((15, 15), dtype=np.uint8)
    belief[7, 2:15] = 2
    belief[10:, 11:] = 0
    targets = np.array([[2, 2], [3, 9], [8, 3], [14, 14]])
    belief[targets[:, 0], targets[:, 1]] = 3
    targets = np.concatenate([targets, [[12, 12]]])
    robots = np.array([[2, 4], [6, 8], [12, 1]])
    x, y = np.arange(15)[:, None], np.arange(15)[None, :]
    distances = np.stack([abs(x - i) + abs(y - j) for i, j in robots]).astype(np.int32)
    distances[1, 8:] = -1
    return features.ViewArrays(
        belief=belief,
        distances=distances,
        robots=robots,
        kinds=np.array([0, 1, 0]),
        speeds=np.array([1.0, 1.0, 2.0], dtype=np.float32),
        ids=np.array([4, 2, 7]),
        tasks=np.array([[-1, -1], [3, 9], [-1, -1]]),
        ages_s=np.array([0.0, 1.0, 2.0], dtype=np.float32),
        present=np.ones(3, dtype=np.bool_),
        hops=np.array([[0, 1, 2], [1, 0, -1], [2, -1, 0]]),
        targets=targets,
        listed=np.ones(5, dtype=np.bool_),
        dark=np.array([0, 0, 0, 0, 12]),
    )


def golden_digest() -> str:
    """Digest of the features of `golden_view`, coarse enough to be the same on every processor."""
    digest = hashlib.sha256()
    for name, array in sorted(features.features_of(golden_view()).items()):
        digest.update(f"{name}{array.shape}".encode())
        digest.update(np.round(np.asarray(array, dtype=np.float64) * GOLDEN_SCALE).astype("<i4").tobytes())
    return digest.hexdigest()[:16]
