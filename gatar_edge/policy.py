"""Runs an exported network on the robot's CPU: onnxruntime and nothing else.

Shapes, types and finiteness are checked before each run, because onnxruntime broadcasts a wrong shape in silence and a
NaN in a hidden row would poison every other.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")  # read when it is imported: a robot tells nobody what it runs
import onnxruntime

from gatar_edge import manifest as contract
from gatar_edge.errors import ModelError
from gatar_edge.features import AXES, LENGTH_SCALE_CELLS, MAX_CANDIDATES, SIZES, Inputs
from gatar_edge.types import Floats

LARGEST_FILE = 64 << 20  # bytes
_SLOWER = ["NchwcTransformer"]  # reorders the channels of each convolution, which costs more than these few gain
MODELS = Path(__file__).parent / "models"
DEFAULT_MODEL = MODELS / "gatar-field.onnx"
GREEDY_MODEL = MODELS / "gatar-greedy.onnx"  # the one that imitates the paper's expert


@dataclass(frozen=True, slots=True)
class PolicyOutput:
    """What the network says of one view."""

    scores: Floats  # [N, M + 1], probability of each candidate; the last column: no target
    xy: Floats  # [2], ego's score-weighted mean candidate, cells from ego
    attention: Floats  # [N], ego's


class Policy:
    """One model file, loaded and checked. Raises ModelError where it cannot be used."""

    def __init__(self, path: Path | None = None) -> None:
        self.path = path or DEFAULT_MODEL
        self._session = _session(self.path)
        metadata = self._session.get_modelmeta().custom_metadata_map
        self.manifest = contract.parse(metadata.get(contract.KEY), self.path.name)
        found = {node.name for node in self._session.get_inputs()}
        if found != set(self.manifest.inputs):
            raise ModelError(
                f"{self.path.name}: field inputs is {sorted(self.manifest.inputs)}, the graph has {sorted(found)}"
            )
        fields = self.manifest.fields["inputs"]
        self._wanted = {name: (np.dtype(fields[name]["dtype"]), len(fields[name]["axes"])) for name in found}
        self._outputs = list(contract.OUTPUTS)
        if {node.name for node in self._session.get_outputs()} != set(self._outputs):
            raise ModelError(f"{self.path.name}: the graph's outputs are not {self._outputs}")

    def run(self, inputs: Inputs) -> PolicyOutput:
        """Evaluate one view (`features.features`). Raises ModelError on a wrong shape or a not finite number."""
        feed = {name: self._checked(name, inputs) for name in self.manifest.inputs}
        sizes = _sizes(feed)
        if not (1 <= sizes["N"] <= contract.MAX_ROBOTS and 1 <= sizes["M"] <= MAX_CANDIDATES):
            raise ModelError(
                f"{sizes['N']} robots and {sizes['M']} candidates: {self.path.name} takes 1 to {contract.MAX_ROBOTS} "
                f"and 1 to {MAX_CANDIDATES}"
            )
        try:
            values: list[Floats] = self._session.run(self._outputs, feed)
        except Exception as error:  # onnxruntime's errors have no common root
            raise ModelError(f"{self.path.name}: {_one_line(error)}") from None
        scores, xy, attention = values
        if scores.shape != (sizes["N"], sizes["M"] + 1) or not all(map(_finite, values)):
            raise ModelError(f"{self.path.name}: output of shape {scores.shape} is not finite or not as contracted")
        return PolicyOutput(scores, xy * np.float32(LENGTH_SCALE_CELLS), attention)

    def _checked(self, name: str, inputs: Inputs) -> npt.NDArray[Any]:
        array = inputs.get(name)
        if array is None:
            raise ModelError(f"{self.path.name}: input {name} is missing")
        dtype, axes = self._wanted[name]
        if array.dtype != dtype or array.ndim != axes:
            raise ModelError(
                f"input {name}: {array.dtype} with {array.ndim} axes, {self.path.name} needs {dtype} with {axes}"
            )
        if dtype.kind == "f" and not _finite(array):
            raise ModelError(f"input {name} holds a number that is not finite")
        return np.ascontiguousarray(array)


def _finite(array: npt.NDArray[Any]) -> bool:
    """Whether all its numbers are finite; counting takes a third of the time of all()."""
    return bool(np.count_nonzero(np.isfinite(array)) == array.size)


def _sizes(feed: dict[str, npt.NDArray[Any]]) -> dict[str, int]:
    """Size of every axis, the same in all inputs. Raises ModelError."""
    sizes: dict[str, int] = dict(SIZES)
    for name, array in feed.items():
        for axis, size in zip(AXES[name], array.shape, strict=True):
            if sizes.setdefault(axis, size) != size:
                raise ModelError(f"input {name}: axis {axis} has size {size}, expected {sizes[axis]}")
    return sizes


def _session(path: Path) -> Any:
    try:
        size = path.stat().st_size
        if size > LARGEST_FILE:
            raise ModelError(f"{path}: {size} bytes, at most {LARGEST_FILE} are read")
        data = path.read_bytes()
    except OSError as error:
        raise ModelError(f"cannot read the model {path}: {error.strerror or error}") from None
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.enable_mem_pattern = False  # sizes change with the view: planning them costs
    options.enable_cpu_mem_arena = True  # else some runs get their memory from the system anew, page by page
    options.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
    options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_ENABLE_ALL
    options.log_severity_level = 4  # errors come back as exceptions
    try:
        return onnxruntime.InferenceSession(
            data, options, providers=["CPUExecutionProvider"], disabled_optimizers=_SLOWER
        )
    except Exception as error:  # onnxruntime's errors have no common root
        raise ModelError(f"{path} is not a readable ONNX model: {_one_line(error)}") from None


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())[:200]
