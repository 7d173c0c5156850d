"""A network that is being judged, as a rule over whole batches: decoded as the robot decodes its model file."""

from __future__ import annotations

import numpy as np
import torch
from torch import nn

from gatar_edge.allocators.base import Allocation
from gatar_edge.allocators.gatar import decode
from gatar_edge.grid import UNREACHABLE
from gatar_edge.learn.evaluate import BatchRule
from gatar_edge.learn.train import tensors_of
from gatar_edge.learn.views import Batch
from gatar_edge.types import Floats


def network_rule(network: nn.Module) -> BatchRule:
    """Decide with `network`, in evaluation mode."""
    inputs: tuple[str, ...] = network.inputs  # type: ignore[assignment]

    def decide(batch: Batch) -> list[Allocation]:
        with torch.inference_mode():
            outputs = network(**tensors_of(batch, inputs))
            scores, places = outputs.scores.softmax(dim=-1).numpy(), outputs.xy.numpy()
        return [_allocation(batch, index, scores[index], places[index]) for index in range(len(batch.chosen))]

    return decide


def _allocation(batch: Batch, index: int, scores: Floats, xy: Floats) -> Allocation:
    view = batch.view
    rows, listed = np.flatnonzero(view.present[index]), np.flatnonzero(view.listed[index])
    targets = view.targets[index, listed]
    lengths = view.distances[index][rows[:, None], targets[:, 0], targets[:, 1]]
    possible = lengths != UNREACHABLE
    shown = scores[np.ix_(rows, np.append(listed, -1))]
    order = np.argsort(view.ids[index, rows], kind="stable")
    place = view.robots[index, 0] + xy
    return Allocation(
        choices=decode(shown, possible, order),
        scores=np.where(possible, shown[:, :-1], -np.inf).astype(np.float32),
        xy=(float(place[0]), float(place[1])),
    )
