"""Eight-bit integers instead of floats, as an experiment: is the model faster or smaller for it, and does it still
decide alike?

Static quantization (QDQ) by onnxruntime, calibrated on scenes other than those on which the two are compared.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import onnx

from gatar_edge import manifest as contract
from gatar_edge.allocators.gatar import Gatar
from gatar_edge.allocators.greedy import Greedy
from gatar_edge.errors import ModelError
from gatar_edge.features import Inputs
from gatar_edge.policy import Policy
from gatar_edge.scenes import CONFIG, inputs_of, make_scene
from gatar_edge.view import View

# The masks' -1e4 would leave no code for the scores themselves: only the layers that multiply are quantized.
QUANTIZED = ("Conv", "Gemm", "MatMul")
SIZES = ((1, 5), (4, 12), (8, 20), (12, 25))  # robots, targets
CALIBRATION_SEED, JUDGED_SEED = 10_000, 20_000  # first ones
ENOUGH_AGREEMENT = 0.999  # of all robots' choices
ENOUGH_GAIN = 0.9  # of the float model's time
ROUNDS = 15  # of timing; the least counts, because nothing makes a run shorter than it is


@dataclass(frozen=True, slots=True)
class Comparison:
    """A model and its quantized twin, side by side."""

    model: str
    float_kib: float
    int8_kib: float
    float_us: dict[str, float]  # CPU time of one run by number of robots, least of many
    int8_us: dict[str, float]
    states: int
    agreement: float  # share of robots for which both choose alike
    ego_agreement: float
    largest_difference: float  # of a probability

    @property
    def recommended(self) -> bool:
        """Whether the quantized model is worth taking: it must decide alike and be faster for every team."""
        faster = all(self.int8_us[size] <= ENOUGH_GAIN * self.float_us[size] for size in self.float_us)
        return faster and self.agreement >= ENOUGH_AGREEMENT

    def as_json(self) -> dict[str, Any]:
        """Plain values."""
        return {**asdict(self), "recommended": self.recommended}


def quantize(path: Path, out: Path, scenes: int = 30) -> None:
    """Write the quantized twin of `path`, calibrated on so many scenes of each size. Raises ModelError."""
    from onnxruntime.quantization import CalibrationDataReader, QuantFormat, QuantType, quantize_static
    from onnxruntime.quantization.shape_inference import quant_pre_process

    policy = Policy(path)
    if out.exists() and out.samefile(path):
        raise ModelError(f"{out}: the quantized model would take the place of the model itself: choose another file")
    feeds = (
        {name: inputs[name] for name in policy.manifest.inputs}
        for _, inputs in states(scenes, CALIBRATION_SEED, policy.manifest.looks_ahead)
    )

    class Reader(CalibrationDataReader):  # type: ignore[misc]
        def get_next(self) -> dict[str, Any] | None:
            return next(feeds, None)

    with TemporaryDirectory() as folder, _quiet():
        prepared = Path(folder) / "prepared.onnx"
        try:
            quant_pre_process(path, prepared, skip_symbolic_shape=True)
            quantize_static(
                prepared, out, Reader(), quant_format=QuantFormat.QDQ, per_channel=True,
                activation_type=QuantType.QUInt8, weight_type=QuantType.QInt8, reduce_range=True,
                op_types_to_quantize=list(QUANTIZED),
            )  # fmt: skip
        except Exception as error:  # its errors have no common root
            raise ModelError(f"{path.name} cannot be quantized: {' '.join(str(error).split())[:200]}") from None
    _keep_contract(path, out)


@contextmanager
def _quiet() -> Iterator[None]:
    """Without the advice that onnxruntime gives on the root logger, to do what is done here."""
    root = logging.getLogger()
    level = root.level
    root.setLevel(logging.ERROR)
    try:
        yield
    finally:
        root.setLevel(level)


def compare(path: Path, quantized: Path, scenes: int = 30) -> Comparison:
    """Run both on the same states."""
    pair = [Gatar(each, CONFIG) for each in (path, quantized)]
    same = robots = same_ego = count = 0
    worst = 0.0
    for view, inputs in states(scenes, JUDGED_SEED, pair[0].policy.manifest.looks_ahead):
        ours, theirs = (allocator.allocate(view).choices for allocator in pair)
        same, robots = same + int((ours == theirs).sum()), robots + len(ours)
        same_ego, count = same_ego + int(ours[0] == theirs[0]), count + 1
        scores = [allocator.policy.run(inputs).scores for allocator in pair]
        worst = max(worst, float(np.abs(scores[0] - scores[1]).max()))
    float_us, int8_us = _times([allocator.policy for allocator in pair])
    float_kib, int8_kib = (each.stat().st_size / 1024 for each in (path, quantized))
    return Comparison(path.name, float_kib, int8_kib, float_us, int8_us, count, same / robots, same_ego / count, worst)


def states(scenes: int, first_seed: int, ahead: bool) -> Iterator[tuple[View, Inputs]]:
    """Views of scenes, and the network's input for each."""
    for robots, targets in SIZES:
        for seed in range(first_seed, first_seed + scenes):
            view = _view(robots, targets, seed)
            yield view, inputs_of(view, ahead)


def _view(robots: int, targets: int, seed: int) -> View:
    scene = make_scene(robots, targets, seed)
    agent = scene.agent(Greedy())
    now_ns = scene.observation.t_ns
    for data in scene.datagrams(1)[1]:
        agent.hear(data, now_ns)
    return agent.view(now_ns, scene.observation)


def _times(policies: list[Policy]) -> list[dict[str, float]]:
    """Turn by turn, so that both meet the same disturbances."""
    found: list[dict[str, float]] = [{}, {}]
    for robots, targets in SIZES:
        inputs = inputs_of(_view(robots, targets, JUDGED_SEED), policies[0].manifest.looks_ahead)
        best = [float("inf"), float("inf")]
        for _ in range(ROUNDS):
            for index, policy in enumerate(policies):
                start_ns = time.process_time_ns()
                policy.run(inputs)
                best[index] = min(best[index], (time.process_time_ns() - start_ns) / 1e3)
        for index, least in enumerate(best):
            found[index][str(robots)] = round(least, 1)
    return found


def _keep_contract(path: Path, out: Path) -> None:
    fields = {entry.key: entry.value for entry in onnx.load(path).metadata_props}
    model = onnx.load(out)
    model.producer_name, model.producer_version = "gatar-edge", ""
    onnx.helper.set_model_props(model, {contract.KEY: fields[contract.KEY]})
    onnx.save_model(model, out)
