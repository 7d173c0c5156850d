"""One round of GATAR's auction, and what can be set in the network. Shapes: see `gatar_edge.learn.networks.gatar`."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from gatar_edge.features import CHANNELS

MOST_SCORE = 10.0  # of a scaled score as it is told to others


@dataclass(frozen=True, slots=True)
class GatarConfig:
    """Every part of the network that an ablation may take away."""

    width: int = 32
    heads: int = 4
    levels: tuple[int, ...] = (1, 2, 2, 2, 2, 1)  # hop mask of each round; the second half is the way up
    conv_channels: int = 8
    maps: bool = True  # read the four channels through the CNN
    attention: bool = True
    competition: bool = True  # the largest bids and scores of the neighbours
    summary: bool = True  # the robot's own bid-weighted mean
    order: bool = True  # ranks of robots and targets, by which every robot breaks ties alike
    tasks: bool = False  # what robots are doing: off for imitation, where it would tell of the expert's past choices
    ages: bool = False  # how old the news of a robot is
    shortcuts: bool = True  # eq. 9b: K_ll
    ahead: bool = False  # frontiers among the candidates, and what they may hide (input `places`)
    tour: bool = False  # a robot sees what else lies near each candidate, by learned weights of the distance
    shared: bool = True  # one set of parameters for the rounds of one direction and level
    channels: tuple[bool, ...] = (True,) * len(CHANNELS)  # which of the four maps are seen


@dataclass(frozen=True, slots=True)
class Hearing:
    """Who hears whom at one level, as numbers to add before a maximum: 0 for who is heard, far below 0 for others."""

    attention: Tensor  # [B, 1, N, N]
    rivals: Tensor  # [B, G, 1, N, N, 1], in G groups: robots earlier in the order and those later, never itself


def pointwise(layer: nn.Linear, x: Tensor) -> Tensor:
    """`layer` over the features of x [B, D, N, M]: one product of matrices, with nothing to transpose."""
    return functional.conv2d(x, layer.weight[:, :, None, None], layer.bias)


class Round(nn.Module):
    """One exchange of bids over one hop mask: (h, bids, scores) -> what changes in h, and the attention.

    Robots attend to robots by what they want most; a head gathers, for every candidate, what those say of it. All
    heads weigh the same values, so that nothing large has to be cut up and put together again.
    """

    def __init__(self, config: GatarConfig) -> None:
        super().__init__()
        width, part = config.width, config.width // config.heads
        self.config = config
        self.ask = nn.Linear(width, 2 * width, bias=False) if config.attention else None
        self.value = nn.Linear(width + 2, part) if config.attention else None
        self.near = nn.Linear(width + 2, part) if config.tour else None
        size = width + 2 + part * config.heads * (config.attention + config.tour)
        size += config.competition * (4 if config.order else 2)
        self.update = nn.Linear(size, 2 * width)
        self.own = nn.Linear(width, 2 * width, bias=False) if config.summary else None
        self.out = nn.Linear(2 * width, width)
        self.least: Tensor  # bid and score of a group that nobody is in
        self.register_buffer("least", torch.tensor([0.0, -MOST_SCORE])[:, None, None], persistent=False)

    def forward(
        self, normed: Tensor, bids: Tensor, scores: Tensor, hearing: Hearing, valid: Tensor, legs: Tensor | None
    ) -> tuple[Tensor, Tensor]:
        """`normed` [B, D, N, M]; `bids`, `scores` (scaled) and `valid` [B, 1, N, M]; `legs` [B, H, M, M]."""
        told = torch.cat([bids, scores], dim=1)
        message = torch.cat([normed, told], dim=1)
        wanted = (normed * bids).sum(dim=3, keepdim=True)  # [B, D, N, 1]
        parts = [message]
        weights = hearing.attention.softmax(dim=-1)
        if self.ask is not None and self.value is not None:
            weights = self._attention(pointwise(self.ask, wanted), hearing)
            said = weights.unsqueeze(2) @ pointwise(self.value, message).unsqueeze(1)  # [B, H, P, N, M]
            parts.append(said.flatten(1, 2))
        if self.config.competition:
            parts.append(self._competition(told, hearing))
        if self.near is not None and legs is not None:
            parts.append(_around(pointwise(self.near, message) * valid, legs))
        changed = pointwise(self.update, torch.cat(parts, dim=1))
        if self.own is not None:
            changed = changed + pointwise(self.own, wanted)
        return pointwise(self.out, functional.relu(changed)), weights

    def _attention(self, asked: Tensor, hearing: Hearing) -> Tensor:
        """Eq. 10, receiver form: alpha_nm = softmax over m in N(n) of LeakyReLU(q_n k_m / sqrt d): [B, H, N, N]."""
        size = self.config.width // self.config.heads
        query, key = asked.reshape(asked.shape[0], 2 * self.config.heads, size, -1).chunk(2, dim=1)
        match = query.transpose(-2, -1) @ key / math.sqrt(size)
        return (functional.leaky_relu(match, 0.2) + hearing.attention).softmax(dim=-1)

    def _competition(self, told: Tensor, hearing: Hearing) -> Tensor:
        """Largest bid and score among the rivals of each group: told [B, 2, N, M] -> [B, 2 * G, N, M]."""
        largest = (told[:, None, :, None] + hearing.rivals).amax(dim=4)  # [B, G, 2, N, M]
        return torch.maximum(largest, self.least).flatten(1, 2)


def _around(values: Tensor, legs: Tensor) -> Tensor:
    """What lies near each candidate: values [B, P, N, M] weighed by legs [B, H, M, M] -> [B, H * P, N, M].

    Legs are the same there and back, so that they weigh from the right as from the left.
    """
    views, part, robots, candidates = values.shape
    gathered = values.reshape(views, 1, part * robots, candidates) @ legs
    return gathered.reshape(views, -1, robots, candidates)
