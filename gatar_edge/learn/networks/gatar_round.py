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


class Round(nn.Module):
    """One exchange of bids over one hop mask: (h, bids, scores) -> what changes in h, and the attention.

    `h` (normed) and all that goes through a linear layer are rows [B * N * M, D]: a layer is one product of matrices.
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
        """`bids` and `scores` [B, N, M], the scores scaled; `valid` as rows [B * N * M, 1]."""
        views, robots, candidates = bids.shape
        message = torch.cat([normed, bids.reshape(-1, 1), scores.reshape(-1, 1)], dim=-1)
        wanted = bids.unsqueeze(2) @ normed.reshape(views, robots, candidates, -1)  # [B, N, 1, D]
        parts = [message]
        weights = hearing.attention.softmax(dim=-1)
        if self.ask is not None and self.value is not None:
            weights = self._attention(self.ask(wanted.reshape(-1, self.config.width)), hearing, views)
            said = self.value(message).reshape(views, 1, robots, -1)
            parts.append(self._rows(weights @ said, bids))
        if self.config.competition:
            parts.append(self._competition(torch.stack([bids, scores], dim=1), hearing))
        if self.near is not None and legs is not None:
            values = (self.near(message) * valid).reshape(views, robots, candidates, -1)
            parts.append(self._around(values, legs, bids))
        changed = self.update(torch.cat(parts, dim=-1))
        if self.own is not None:
            changed = changed.reshape(views, robots, candidates, -1) + self.own(wanted)
        return self.out(functional.relu(changed).reshape(-1, 2 * self.config.width)), weights

    def _attention(self, asked: Tensor, hearing: Hearing, views: int) -> Tensor:
        """Eq. 10, receiver form: alpha_nm = softmax over m in N(n) of LeakyReLU(q_n k_m / sqrt d): [B, H, N, N]."""
        size = self.config.width // self.config.heads
        split = asked.reshape(views, -1, 2, self.config.heads, size).permute(2, 0, 3, 1, 4)
        match = split[0] @ split[1].transpose(-2, -1) / math.sqrt(size)
        return (functional.leaky_relu(match, 0.2) + hearing.attention).softmax(dim=-1)

    def _around(self, values: Tensor, legs: Tensor, bids: Tensor) -> Tensor:
        """What lies near each candidate: values [B, N, M, P] weighed by legs [B, 1, H * M, M], as rows."""
        gathered = legs @ values
        return self._rows(gathered.reshape(*bids.shape[:2], self.config.heads, -1).transpose(1, 2), bids)

    def _rows(self, heads: Tensor, bids: Tensor) -> Tensor:
        """[B, H, N, M * P] -> [B * N * M, H * P]."""
        split = heads.reshape(*heads.shape[:3], bids.shape[2], -1).permute(0, 2, 3, 1, 4)
        return split.reshape(-1, self.config.width)

    def _competition(self, told: Tensor, hearing: Hearing) -> Tensor:
        """Largest bid and score among the rivals of each group: told [B, 2, N, M] -> rows of 2 for each group."""
        largest = (told[:, None, :, None] + hearing.rivals).amax(dim=4)  # [B, G, 2, N, M]
        largest = torch.maximum(largest, self.least)
        return largest.permute(0, 3, 4, 1, 2).reshape(-1, 4 if self.config.order else 2)
