"""GATAR as an unrolled auction: every robot bids for every candidate, hears its neighbours' bids, and bids again.

Shapes: B views, N robots, M candidates, D width, H heads. The rounds run as the paper's V-cycle (eq. 9): down over
wider and wider hop masks, up again over the same, each upward round joined to the downward one of its level; rounds of
one direction and level share their parameters. Within a round, each robot attends to the robots in its mask for each
candidate apart (eq. 10). There is no absolute coordinate and no fixed N or M.

A robot outside the mask has weight exactly zero: masks are finite, and what they hide is zeroed before it is summed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from gatar_edge.features import CHANNELS, PAIR_FEATURES, PLACE_FEATURES, ROBOT_FEATURES, WINDOW

HIDDEN_SCORE = -1e4  # finite, so that nothing becomes NaN; far enough that exp() of it is exactly 0
SCORE_SCALE = 0.1
LEG_SCALE = 0.25
RANK = ROBOT_FEATURES.index("rank")
INSIDE = PAIR_FEATURES.index("inside")


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
class Outputs:
    """What the network says, and what it thought on the way."""

    scores: Tensor  # [B, N, M + 1], the last: no target
    xy: Tensor  # [B, 2], ego's score-weighted mean candidate, relative to ego
    attention: Tensor  # [B, N], ego's, averaged over heads and its own bids
    rounds: tuple[Tensor, ...]  # scores before each round, for deep supervision


class WindowEncoder(nn.Module):
    """The shared CNN over the four channels, read at each candidate's cell: [B, N, 4, 15, 15] -> [B, N, M, C]."""

    def __init__(self, channels: int, seen: tuple[bool, ...]) -> None:
        super().__init__()
        self.first = nn.Conv2d(len(CHANNELS), channels, 3, padding=1)
        self.second = nn.Conv2d(channels, channels, 3, padding=1)
        self.seen: Tensor
        self.register_buffer("seen", torch.tensor(seen, dtype=torch.float32)[:, None, None], persistent=False)
        self.channels = channels

    def forward(self, maps: Tensor, cells: Tensor) -> Tensor:
        views, robots = maps.shape[0], maps.shape[1]
        x = (maps * self.seen).flatten(0, 1)
        x = functional.relu(self.second(functional.relu(self.first(x))))
        x = x.reshape(views, robots, self.channels, WINDOW * WINDOW)
        index = cells.unsqueeze(2).expand(-1, -1, self.channels, -1)
        return x.gather(3, index).transpose(2, 3)


class Round(nn.Module):
    """One exchange of bids over one hop mask: (h, bids, scores) -> h, and ego's attention."""

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

    def forward(
        self, h: Tensor, bids: Tensor, scores: Tensor, mask: Tensor, before: Tensor, shown: Tensor, legs: Tensor | None
    ) -> tuple[Tensor, Tensor]:
        normed = self.norm(h)
        told = torch.stack([bids, scores * SCORE_SCALE], dim=-1)
        message = torch.cat([normed, told], dim=-1)
        parts = [message]
        weights = mask.to(h.dtype)[:, None, None]
        if self.config.attention:
            heard, weights = self._attend(message, mask)
            parts.append(heard)
        if self.config.competition:
            parts.append(self._competition(bids, scores, mask, before))
        if self.config.summary:
            mean = (bids.unsqueeze(-1) * normed).sum(dim=2, keepdim=True)
            parts.append(mean.expand_as(h))
        if self.near is not None and legs is not None:
            parts.append(self._around(self.near(message) * shown, legs))
        return h + self.update(torch.cat(parts, dim=-1)), weights

    def _around(self, values: Tensor, legs: Tensor) -> Tensor:
        """What lies near each candidate: values [B, N, M, D] weighed by legs [B, H, M, M]."""
        views, robots, candidates, width = values.shape
        heads = self.config.heads
        split = values.reshape(views, robots, candidates, heads, width // heads).permute(0, 3, 2, 1, 4)
        gathered = legs @ split.reshape(views, heads, candidates, robots * (width // heads))
        gathered = gathered.reshape(views, heads, candidates, robots, width // heads)
        return gathered.permute(0, 3, 2, 1, 4).reshape(views, robots, candidates, width)

    def _attend(self, message: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
        """Eq. 10, receiver form: alpha_nm = softmax over m in N(n) of LeakyReLU(q_n k_m / sqrt d), per candidate."""
        heads, width = self.config.heads, self.config.width
        views, robots, candidates = message.shape[0], message.shape[1], message.shape[2]

        def split(x: Tensor) -> Tensor:  # [B, N, M, D] -> [B, M, H, N, D / H]
            return x.reshape(views, robots, candidates, heads, width // heads).permute(0, 2, 3, 1, 4)

        query, key, value = split(self.query(message)), split(self.key(message)), split(self.value(message))
        logits = functional.leaky_relu(query @ key.transpose(-1, -2) / math.sqrt(width // heads), 0.2)
        shown = mask[:, None, None]
        alpha = torch.where(shown, logits, HIDDEN_SCORE).softmax(dim=-1)
        alpha = torch.where(shown, alpha, 0.0)
        heard = (alpha @ value).permute(0, 3, 1, 2, 4).reshape(views, robots, candidates, width)
        return heard, alpha

    def _competition(self, bids: Tensor, scores: Tensor, mask: Tensor, before: Tensor) -> Tensor:
        """Largest bid and score of the neighbours, of those earlier and of those later in the order apart."""
        others = mask & ~torch.eye(mask.shape[1], dtype=torch.bool, device=mask.device)
        groups = [others & before, others & ~before] if self.config.order else [others]
        found = []
        for group in groups:
            shown = group.unsqueeze(-1)  # [B, N, N, 1] against [B, 1, N, M]
            found.append(torch.where(shown, bids.unsqueeze(1), 0.0).amax(dim=2))
            found.append(torch.where(shown, scores.unsqueeze(1), -10.0 / SCORE_SCALE).amax(dim=2) * SCORE_SCALE)
        return torch.stack(found, dim=-1)


class Gatar(nn.Module):
    """See the module's docstring. Inputs as `gatar_edge.features.AXES`, with one batch axis in front."""

    def __init__(self, config: GatarConfig | None = None) -> None:
        super().__init__()
        self.config = config = config or GatarConfig()
        self.inputs = ("maps", "robots", "pairs", "cells", "valid", "offsets", "hops", *(("places",) * config.ahead))
        width = config.width
        read = config.conv_channels if config.maps else 0
        self.window = WindowEncoder(read, config.channels) if config.maps else None
        size = len(PAIR_FEATURES) + len(ROBOT_FEATURES) + len(PLACE_FEATURES) * config.ahead + read
        self.slopes = nn.Parameter(_first_slopes(config.heads)) if config.tour else None
        self.encode = nn.Sequential(nn.Linear(size, 2 * width), nn.ReLU(), nn.Linear(2 * width, width))
        self.score = nn.Sequential(nn.LayerNorm(width), nn.Linear(width, 1))
        self.none = nn.Sequential(nn.Linear(width + len(ROBOT_FEATURES), width), nn.ReLU(), nn.Linear(width, 1))
        self.plan = _round_plan(config)
        self.rounds = nn.ModuleList(Round(config) for _ in range(max(self.plan) + 1))
        turn = len(config.levels) // 2
        self.shortcut = nn.ModuleList(nn.Linear(width, width) for _ in set(config.levels[turn:]) if config.shortcuts)
        hidden = {"robot_rank", "target_rank", "rank"} if not config.order else set()
        hidden |= {"task", "busy"} if not config.tasks else set()
        hidden |= {"age"} if not config.ages else set()
        self.pair_scale: Tensor
        self.robot_scale: Tensor
        for name, features in (("pair_scale", PAIR_FEATURES), ("robot_scale", ROBOT_FEATURES)):
            self.register_buffer(name, torch.tensor([float(f not in hidden) for f in features]), persistent=False)

    def forward(
        self, maps: Tensor, robots: Tensor, pairs: Tensor, cells: Tensor, valid: Tensor, offsets: Tensor, hops: Tensor,
        places: Tensor | None = None,
    ) -> Outputs:  # fmt: skip
        shown = valid > 0
        legs = self._legs(offsets)
        before = robots[..., None, :, RANK] < robots[..., :, None, RANK]
        robots = robots * self.robot_scale
        h = self._encode(maps, robots, pairs * self.pair_scale, cells, pairs[..., INSIDE], places)
        h = torch.where(shown.unsqueeze(-1), h, 0.0)
        weight = shown.unsqueeze(-1).to(h.dtype)
        levels = self.config.levels
        turn = len(levels) // 2
        down: dict[int, Tensor] = {}
        history: list[Tensor] = []
        weights = h
        for index, level in enumerate(levels):
            if index >= turn and self.config.shortcuts and level in down:
                h = h + self.shortcut[sorted(set(levels[turn:])).index(level)](down.pop(level))
            every = self._scores(h, robots, shown)
            history.append(every)
            bids = every.softmax(dim=-1)[..., :-1]
            bids = torch.where(shown, bids, 0.0)
            mask = (hops >= 0) & (hops <= level)
            if index < turn:
                down[level] = h
            clipped = every[..., :-1].clamp(-10.0 / SCORE_SCALE, 10.0 / SCORE_SCALE)
            h, weights = self.rounds[self.plan[index]](h, bids, clipped, mask, before, weight, legs)
            h = torch.where(shown.unsqueeze(-1), h, 0.0)
        scores = self._scores(h, robots, shown)
        return Outputs(scores, *self._ego(scores, shown, offsets, weights), tuple(history))

    def _legs(self, offsets: Tensor) -> Tensor | None:
        """Weights of one candidate for another by the way between them, exp(-way / reach): [B, H, M, M].

        The way is taken as 4-connected with nothing between: only what is near counts.
        """
        if self.slopes is None:
            return None
        way = (offsets.unsqueeze(1) - offsets.unsqueeze(2)).abs().sum(dim=-1)  # [B, M, M]
        weights = torch.exp(-way.unsqueeze(1) * functional.softplus(self.slopes)[:, None, None])
        return weights * (LEG_SCALE - LEG_SCALE * torch.eye(way.shape[1], dtype=way.dtype, device=way.device))

    def _encode(
        self, maps: Tensor, robots: Tensor, pairs: Tensor, cells: Tensor, inside: Tensor, places: Tensor | None
    ) -> Tensor:
        parts = [pairs, robots.unsqueeze(2).expand(-1, -1, pairs.shape[2], -1)]
        if places is not None:
            parts.append(places.unsqueeze(1).expand(-1, pairs.shape[1], -1, -1))
        if self.window is not None:
            parts.append(self.window(maps, cells) * inside.unsqueeze(-1))
        encoded: Tensor = self.encode(torch.cat(parts, dim=-1))
        return encoded

    def _scores(self, h: Tensor, robots: Tensor, shown: Tensor) -> Tensor:
        """[B, N, M + 1]: candidates that do not exist or cannot be reached score `HIDDEN_SCORE`."""
        scores = torch.where(shown, self.score(h).squeeze(-1), HIDDEN_SCORE)
        mean = h.sum(dim=2) / shown.sum(dim=2, keepdim=True).clamp(min=1)
        none = self.none(torch.cat([mean, robots], dim=-1))
        return torch.cat([scores, none], dim=-1)

    def _ego(self, scores: Tensor, shown: Tensor, offsets: Tensor, weights: Tensor) -> tuple[Tensor, Tensor]:
        """Ego's score-weighted mean cell (the paper's output) and its attention in the last round."""
        bids = torch.where(shown[:, 0], scores[:, 0, :-1].softmax(dim=-1), 0.0)
        xy = (bids.unsqueeze(-1) * offsets).sum(dim=1)
        heads = weights[..., 0, :].mean(dim=2)  # [B, M or 1, N]
        if self.config.attention:
            share = bids / bids.sum(dim=-1, keepdim=True).clamp(min=1e-6)
            return xy, (share.unsqueeze(-1) * heads).sum(dim=1)
        return xy, heads.mean(dim=1)


def _first_slopes(heads: int) -> Tensor:
    """Slopes before training, [H]: from candidates side by side to all of a window, as softplus takes them."""
    slopes = torch.tensor([1.0 / reach for reach in (1.0, 2.0, 4.0, 8.0)]).repeat(-(-heads // 4))[:heads]
    return torch.log(torch.expm1(slopes))


def _round_plan(config: GatarConfig) -> list[int]:
    """Which set of parameters each round uses."""
    if not config.shared:
        return list(range(len(config.levels)))
    turn = len(config.levels) // 2
    keys = [(index >= turn, level) for index, level in enumerate(config.levels)]
    known = list(dict.fromkeys(keys))
    return [known.index(key) for key in keys]
