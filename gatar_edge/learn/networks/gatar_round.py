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

    attention: Tensor  # [B, 1, 1, N, N]
    rivals: (
        Tensor  # [B, G, 1, N, N, 1], in G groups: robots earlier in the order and those later, never the robot itself
    )


class Round(nn.Module):
    """One exchange of bids over one hop mask: (h, bids, scores) -> h, and ego's attention.

    `h` and all that goes through a linear layer are rows [B * N * M, D], so that a layer is one product of matrices.
    """

    def __init__(self, config: GatarConfig) -> None:
        super().__init__()
        width = config.width
        self.config = config
        self.norm = nn.LayerNorm(width)
        self.query = nn.Linear(width + 2, width, bias=False)
        self.key = nn.Linear(width + 2, width, bias=False)
        self.value = nn.Linear(width + 2, width)
        self.near = nn.Linear(width + 2, width) if config.tour else None
        extra = (
            2
            + width * (config.attention + config.summary + config.tour)
            + config.competition * (4 if config.order else 2)
        )
        self.update = nn.Sequential(nn.Linear(width + extra, 2 * width), nn.ReLU(), nn.Linear(2 * width, width))
        self.least: Tensor  # bid and score of a group that nobody is in
        self.register_buffer("least", torch.tensor([0.0, -MOST_SCORE])[:, None, None], persistent=False)

    def forward(
        self, h: Tensor, bids: Tensor, scores: Tensor, hearing: Hearing, valid: Tensor, legs: Tensor | None
    ) -> tuple[Tensor, Tensor]:
        """`bids` and `scores` [B, N, M], the scores scaled; `valid` as rows [B * N * M, 1]."""
        width = self.config.width
        views, robots, candidates = bids.shape
        normed = self.norm(h)
        message = torch.cat([normed, bids.reshape(-1, 1), scores.reshape(-1, 1)], dim=-1)
        parts = [message]
        weights = hearing.attention.exp()
        if self.config.attention:
            heard, weights = self._attend(message, hearing, (views, robots, candidates))
            parts.append(heard)
        if self.config.competition:
            parts.append(self._competition(torch.stack([bids, scores], dim=1), hearing))
        if self.config.summary:
            mean = bids.unsqueeze(2) @ normed.reshape(views, robots, candidates, width)
            parts.append(mean.expand(-1, -1, candidates, -1).reshape(-1, width))
        if self.near is not None and legs is not None:
            parts.append(self._around(self.near(message) * valid, legs, (views, robots, candidates)))
        changed: Tensor = self.update(torch.cat(parts, dim=-1))
        return h + changed, weights

    def _split(self, x: Tensor, shape: tuple[int, int, int]) -> Tensor:
        """Rows by head: [B, N, M, H, D / H]."""
        return x.reshape(*shape, self.config.heads, self.config.width // self.config.heads)

    def _around(self, values: Tensor, legs: Tensor, shape: tuple[int, int, int]) -> Tensor:
        """What lies near each candidate: rows of values weighed by legs [B, H, M, M]."""
        views, robots, candidates = shape
        heads, width = self.config.heads, self.config.width
        split = self._split(values, shape).permute(0, 3, 2, 1, 4)  # [B, H, M, N, D / H]
        gathered = legs @ split.reshape(views, heads, candidates, robots * (width // heads))
        return gathered.reshape(split.shape).permute(0, 3, 2, 1, 4).reshape(-1, width)

    def _attend(self, message: Tensor, hearing: Hearing, shape: tuple[int, int, int]) -> tuple[Tensor, Tensor]:
        """Eq. 10, receiver form: alpha_nm = softmax over m in N(n) of LeakyReLU(q_n k_m / sqrt d), per candidate."""
        width = self.config.width
        scale = 1 / math.sqrt(width // self.config.heads)
        query = self._split(functional.linear(message, self.query.weight * scale), shape).permute(0, 2, 3, 1, 4)
        key = self._split(self.key(message), shape).permute(0, 2, 3, 4, 1)
        value = self._split(self.value(message), shape).permute(0, 2, 3, 1, 4)
        alpha = (functional.leaky_relu(query @ key, 0.2) + hearing.attention).softmax(dim=-1)  # [B, M, H, N, N]
        return (alpha @ value).permute(0, 3, 1, 2, 4).reshape(-1, width), alpha

    def _competition(self, told: Tensor, hearing: Hearing) -> Tensor:
        """Largest bid and score among the rivals of each group: told [B, 2, N, M] -> rows of 2 for each group."""
        largest = (told[:, None, :, None] + hearing.rivals).amax(dim=4)  # [B, G, 2, N, M]
        largest = torch.maximum(largest, self.least)
        return largest.permute(0, 3, 4, 1, 2).reshape(-1, 4 if self.config.order else 2)
