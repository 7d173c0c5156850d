"""Proof that an ONNX file equals its network: names, axes, shapes, values, decisions, in this order.

The network runs in double precision, so that the difference is the file's error alone and not the sum of two roundings.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import onnx
import torch
from safetensors import SafetensorError
from safetensors.torch import load_file

from gatar_edge.allocators.base import Choices, in_id_order
from gatar_edge.allocators.gatar import decode, in_hand
from gatar_edge.errors import GatarError, ModelError
from gatar_edge.export.spec import DYNAMIC, TOLERANCE, SingleView
from gatar_edge.export.states import CONNECTED, ISOLATED, flown_views, random_view
from gatar_edge.features import LENGTH_SCALE_CELLS, MAX_CANDIDATES, Inputs, arrays_of, features_of
from gatar_edge.grid import UNREACHABLE
from gatar_edge.learn.networks import build
from gatar_edge.manifest import MAX_ROBOTS, OUTPUTS
from gatar_edge.policy import Policy, PolicyOutput
from gatar_edge.view import View, with_absent

MOST_IR, OPSETS = 10, range(17, 21)
RANGES = (ISOLATED, 6.0, CONNECTED)
CANDIDATES = (0, 1, 2, 7, 30, 64)
HEAVY = 400  # robots x candidates from which one range, and each number of candidates in turn, is enough


class ProofError(GatarError):
    """The file and its network differ."""


class NameMismatchError(ProofError):
    """Names of inputs or outputs."""


class AxisMismatchError(ProofError):
    """An axis that must be free is fixed, or the file is of a format that the robot may not read."""


class ShapeMismatchError(ProofError):
    """Shapes of outputs."""


class ValueMismatchError(ProofError):
    """Numbers."""


class DecisionMismatchError(ProofError):
    """Chosen targets."""


@dataclass(frozen=True, slots=True)
class Proof:
    """What was compared, and the largest difference seen."""

    model: str
    ok: bool
    states: int
    decisions: int
    max_difference: float
    tolerance: float
    robots: tuple[int, int]
    candidates: tuple[int, int]
    error: str = ""

    def as_json(self) -> dict[str, Any]:
        """Plain values."""
        return asdict(self)


def verify(
    path: Path,
    progress: Callable[[float, str], None] = lambda share, text: None,
    states_of: Callable[[], Iterable[tuple[int, int, float]]] | None = None,
    flown: int = 0,
) -> Proof:
    """Compare the file with the network whose weights lie beside it. A difference is told by the proof.

    `states_of` gives robots, candidates and r_comm of each random state; by default all of `all_states`. So many
    `flown` states, as robots met them in missions, come after them. Raises ModelError where file or weights cannot be
    read at all.
    """
    policy = Policy(path)
    network = network_of(path, policy)
    states = decisions = 0
    worst = 0.0
    error = ""
    try:
        _check_graph(path, policy)
        drawn = list((states_of or all_states)())
        every = (random_view(n, m, index, r_comm) for index, (n, m, r_comm) in enumerate(drawn))
        for view in chain(every, flown_views(flown)):
            worst = max(worst, _compare(policy, network, view))
            states, decisions = states + 1, decisions + len(view.robots)
            progress(states / (len(drawn) + flown), f"{states} states, largest difference {worst:.1e}")
    except ProofError as found:
        error = f"{type(found).__name__}: {found}"
    return Proof(path.name, not error, states, decisions, worst, TOLERANCE, (1, MAX_ROBOTS), (0, MAX_CANDIDATES), error)


def all_states() -> Iterator[tuple[int, int, float]]:
    """Every number of robots with several of candidates, and the reverse, isolated to connected."""
    for robots in range(1, MAX_ROBOTS + 1):
        for index, candidates in enumerate(CANDIDATES):
            if robots * candidates <= HEAVY:
                yield from ((robots, candidates, r_comm) for r_comm in RANGES)
            elif robots % len(CANDIDATES) == index:
                yield robots, candidates, RANGES[robots % len(RANGES)]
    for candidates in range(MAX_CANDIDATES + 1):
        yield 4, candidates, RANGES[candidates % len(RANGES)]


def network_of(path: Path, policy: Policy) -> SingleView:
    """The network of a model file in double precision, from the weights beside it. Raises ModelError."""
    weights = path.with_suffix(".safetensors")
    fields = policy.manifest.fields
    network = build(fields["network"], fields["settings"])
    try:
        network.load_state_dict(load_file(weights))
    except (OSError, RuntimeError, ValueError, SafetensorError) as error:
        raise ModelError(f"cannot read the weights {weights}: {' '.join(str(error).split())[:200]}") from None
    return SingleView(network).eval().double()


def _check_graph(path: Path, policy: Policy) -> None:
    """Names and free axes, and the format that an older onnxruntime must still read."""
    model = onnx.load(path)
    names = [value.name for value in model.graph.output]
    if names != list(OUTPUTS):
        raise NameMismatchError(f"outputs {names}, expected {list(OUTPUTS)}")
    for value in model.graph.input:
        axes = policy.manifest.fields["inputs"][value.name]["axes"]
        for axis, dim in zip(axes, value.type.tensor_type.shape.dim, strict=True):
            if (axis in DYNAMIC) != bool(dim.dim_param):
                raise AxisMismatchError(f"input {value.name}, axis {axis}: {dim.dim_param or dim.dim_value}")
    opset = max(entry.version for entry in model.opset_import if entry.domain in ("", "ai.onnx"))
    if model.ir_version > MOST_IR or opset not in OPSETS:
        raise AxisMismatchError(f"IR {model.ir_version}, opset {opset}: at most IR {MOST_IR}, opset 17 to 20")


def _compare(policy: Policy, network: SingleView, view: View) -> float:
    ahead = policy.manifest.looks_ahead
    view = with_absent(view) if ahead else view
    arrays = arrays_of(view, with_frontiers=ahead)
    inputs = features_of(arrays)
    ours = _as_exported(policy.run(inputs))
    with torch.inference_mode():
        theirs = PolicyOutput(*(output.numpy() for output in network(*_double(inputs, network.inputs))))
    where = f"{len(view.robots)} robots, {len(view.targets)} candidates"
    worst = 0.0
    for name in OUTPUTS:
        left, right = getattr(ours, name), getattr(theirs, name)
        if left.shape != right.shape:
            raise ShapeMismatchError(f"{name} with {where}: {left.shape} in the file, {right.shape} in torch")
        gap = float(np.abs(left - right).max(initial=0.0))
        if gap > TOLERANCE:
            raise ValueMismatchError(f"{name} with {where}: differs by {gap:.2e}, tolerance {TOLERANCE:.0e}")
        worst = max(worst, gap)
    places = arrays.targets[arrays.listed]
    held = in_hand(view, places) if ahead else None
    chosen, expected = _decide(view, places, held, ours), _decide(view, places, held, theirs)
    if not np.array_equal(chosen, expected):
        raise DecisionMismatchError(f"{where}: {chosen.tolist()} from the file, {expected.tolist()} from torch")
    return worst


def _double(inputs: Inputs, names: tuple[str, ...]) -> list[torch.Tensor]:
    arrays = (np.ascontiguousarray(inputs[name]) for name in names)
    return [torch.from_numpy(array.astype(np.float64) if array.dtype.kind == "f" else array) for array in arrays]


def _as_exported(output: PolicyOutput) -> PolicyOutput:
    """In the units of the file, in which the tolerance is meant."""
    return replace(output, xy=output.xy / np.float32(LENGTH_SCALE_CELLS))


def _decide(
    view: View,
    places: npt.NDArray[np.int64],
    held: npt.NDArray[np.bool_] | None,
    output: PolicyOutput,
) -> Choices:
    scores = output.scores[:, [*range(len(places)), -1]]
    possible = view.distances[:, places[:, 0], places[:, 1]] != UNREACHABLE
    return decode(scores, possible, in_id_order(view), held)
