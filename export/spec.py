"""The export contract as data: inputs, axes, bounds and tolerance."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn

from gatar_edge.features import AXES, LENGTH_SCALE_CELLS, MAX_CANDIDATES
from gatar_edge.manifest import MAX_ROBOTS

OPSET = 18  # in the range that onnxruntime 1.17 reads
IR_VERSION = 9
TOLERANCE = 1e-5  # largest difference of any float between torch and onnxruntime
DYNAMIC = {"N": MAX_ROBOTS, "M": MAX_CANDIDATES}
EXAMPLE = {"N": 5, "M": 7}  # never 0 or 1: torch.export would make these axes fixed


class SingleView(nn.Module):
    """What is exported: a network without its batch axis, its scores turned into probabilities, x-y in tens of cells.

    A probability is what a reviewer can read, and numbers near 1 are what single precision gives within `TOLERANCE`.
    """

    def __init__(self, network: nn.Module) -> None:
        super().__init__()
        self.network = network
        self.inputs: tuple[str, ...] = network.inputs  # type: ignore[assignment]

    def forward(self, *inputs: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Inputs in the order of the network's `inputs`; `scores`, `xy`, `attention` as in `manifest.OUTPUTS`."""
        named = zip(self.inputs, inputs, strict=True)
        outputs = self.network(**{name: value.unsqueeze(0) for name, value in named})
        xy = outputs.xy.squeeze(0) / LENGTH_SCALE_CELLS
        return outputs.scores.squeeze(0).softmax(dim=-1), xy, outputs.attention.squeeze(0)


def dynamic_shapes(inputs: tuple[str, ...]) -> tuple[tuple[dict[int, Any], ...]]:
    """For torch.export: which axes of which input are free, up to the bounds."""
    dims = {axis: torch.export.Dim(axis, min=1, max=most) for axis, most in DYNAMIC.items()}
    return (tuple({i: dims[axis] for i, axis in enumerate(AXES[name]) if axis in dims} for name in inputs),)
