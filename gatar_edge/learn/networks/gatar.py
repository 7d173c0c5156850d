"""GATAR as an unrolled auction: every robot bids for every candidate, hears its neighbours' bids, and bids again.

Shapes: B views, N robots, M candidates, D width, H heads. The rounds run as the paper's V-cycle (eq. 9): down over
wider and wider hop masks, up again over the same, each upward round joined to the downward one of its level; rounds of
one direction and level share their parameters. Within a round, each robot attends to the robots in its mask for each
candidate apart (eq. 10). There is no absolute coordinate and no fixed N or M.

A robot outside the mask has weight exactly zero: what is hidden lies so far below all else that exp() of it is 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from gatar_edge.features import CHANNELS, PAIR_FEATURES, PLACE_FEATURES, ROBOT_FEATURES, WINDOW
from gatar_edge.learn.networks.gatar_round import MOST_SCORE, GatarConfig, Hearing, Round

HIDDEN_SCORE = -1e4  # finite, so that nothing becomes NaN; far enough that exp() of it is exactly 0
SCORE_SCALE = 0.1
LEG_SCALE = 0.25
RANK = ROBOT_FEATURES.index("rank")
INSIDE = PAIR_FEATURES.index("inside")


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
        views, count, candidates = valid.shape
        legs = self._legs(offsets)
        hearings = self._hearings(hops, robots[..., RANK])
        robots = robots * self.robot_scale
        rows = valid.reshape(-1, 1)
        hidden = (1 - valid) * HIDDEN_SCORE
        share = 1 / valid.sum(dim=2, keepdim=True).clamp(min=1)  # of a candidate in the mean

        def scores_of(h: Tensor) -> Tensor:
            """[B, N, M + 1]: candidates that do not exist or cannot be reached score `HIDDEN_SCORE`."""
            scores = self.score(h).reshape(views, count, candidates) * valid + hidden
            mean = h.reshape(views, count, candidates, self.config.width).sum(dim=2) * share
            none = self.none(torch.cat([mean, robots], dim=-1).flatten(0, 1))
            return torch.cat([scores, none.reshape(views, count, 1)], dim=-1)

        h = self._encode(maps, robots, pairs * self.pair_scale, cells, pairs[..., INSIDE], places) * rows
        levels = self.config.levels
        turn = len(levels) // 2
        down: dict[int, Tensor] = {}
        history: list[Tensor] = []
        weights = h
        for index, level in enumerate(levels):
            if index >= turn and self.config.shortcuts and level in down:
                h = h + self.shortcut[sorted(set(levels[turn:])).index(level)](down.pop(level))
            if index < turn:
                down[level] = h
            every = scores_of(h)
            history.append(every)
            bids = every.softmax(dim=-1)[..., :-1]
            told = every[..., :-1].clamp(-MOST_SCORE / SCORE_SCALE, MOST_SCORE / SCORE_SCALE) * SCORE_SCALE
            h, weights = self.rounds[self.plan[index]](h, bids, told, hearings[level], rows, legs)
            h = h * rows
        scores = scores_of(h)
        return Outputs(scores, *self._ego(scores, valid, offsets, weights), tuple(history))

    def _hearings(self, hops: Tensor, ranks: Tensor) -> dict[int, Hearing]:
        """The masks of each level that a round asks for: hops [B, N, N], ranks [B, N]."""
        before = ranks[:, None, :] < ranks[:, :, None]
        groups = torch.stack([before, ~before] if self.config.order else [torch.ones_like(before)], dim=1)
        groups = groups & (hops != 0)[:, None]
        found = {}
        for level in set(self.config.levels):
            heard = (hops >= 0) & (hops <= level)
            rivals = groups & heard[:, None]
            found[level] = Hearing(_far_below(heard)[:, None, None], _far_below(rivals)[:, :, None, ..., None])
        return found

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
        table = torch.cat(parts, dim=-1)
        encoded: Tensor = self.encode(table.reshape(-1, table.shape[-1]))
        return encoded

    def _ego(self, scores: Tensor, valid: Tensor, offsets: Tensor, weights: Tensor) -> tuple[Tensor, Tensor]:
        """Ego's score-weighted mean cell (the paper's output) and its attention in the last round."""
        bids = scores[:, 0, :-1].softmax(dim=-1) * valid[:, 0]
        xy = (bids.unsqueeze(-1) * offsets).sum(dim=1)
        heads = weights[..., 0, :].mean(dim=2)  # [B, M or 1, N]
        if self.config.attention:
            share = bids / bids.sum(dim=-1, keepdim=True).clamp(min=1e-6)
            return xy, (share.unsqueeze(-1) * heads).sum(dim=1)
        return xy, heads.mean(dim=1)


def _far_below(seen: Tensor) -> Tensor:
    """0 where `seen`, `HIDDEN_SCORE` elsewhere."""
    return (~seen).to(torch.float32) * HIDDEN_SCORE


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
