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

from gatar_edge.features import CHANNELS, PAIR_FEATURES, PLACE_FEATURES, RANK_SCALE, ROBOT_FEATURES, WINDOW
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
        window = ("maps", "cells") if config.maps else ()
        self.inputs = ("robots", "pairs", "valid", "offsets", "hops", *window, *(("places",) * config.ahead))
        width = config.width
        read = config.conv_channels if config.maps else 0
        self.window = WindowEncoder(read, config.channels) if config.maps else None
        size = len(PAIR_FEATURES) + len(ROBOT_FEATURES) + len(PLACE_FEATURES) * config.ahead + read
        self.slopes = nn.Parameter(_first_slopes(config.heads)) if config.tour else None
        self.encode = nn.Sequential(nn.Linear(size, 2 * width), nn.ReLU(), nn.Linear(2 * width, width))
        self.norm = nn.LayerNorm(width)
        self.score = nn.Linear(width, 1)
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
        self, robots: Tensor, pairs: Tensor, valid: Tensor, offsets: Tensor, hops: Tensor,
        maps: Tensor | None = None, cells: Tensor | None = None, places: Tensor | None = None,
    ) -> Outputs:  # fmt: skip
        views, count, candidates = valid.shape
        legs = self._legs(offsets)
        hearings = self._hearings(hops, robots[..., RANK])
        robots = robots * self.robot_scale
        rows = valid.reshape(-1, 1)
        hidden = (1 - valid) * HIDDEN_SCORE
        share = (valid / valid.sum(dim=2, keepdim=True).clamp(min=1)).unsqueeze(2)  # of each candidate in the mean

        def scores_of(normed: Tensor) -> Tensor:
            """[B, N, M + 1]: candidates that do not exist or cannot be reached score about `HIDDEN_SCORE`."""
            scores = self.score(normed).reshape(views, count, candidates) + hidden
            mean = (share @ normed.reshape(views, count, candidates, -1)).squeeze(2)
            none = self.none(torch.cat([mean, robots], dim=-1).flatten(0, 1))
            return torch.cat([scores, none.reshape(views, count, 1)], dim=-1)

        seen = self._seen(maps, cells, pairs[..., INSIDE])
        h = self._encode(robots, pairs * self.pair_scale, seen, places)
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
            normed = self.norm(h)
            every = scores_of(normed)
            history.append(every)
            bids = every.softmax(dim=-1)[..., :-1]
            told = every[..., :-1].clamp(-MOST_SCORE / SCORE_SCALE, MOST_SCORE / SCORE_SCALE) * SCORE_SCALE
            changed, weights = self.rounds[self.plan[index]](normed, bids, told, hearings[level], rows, legs)
            h = h + changed
        scores = scores_of(self.norm(h))
        return Outputs(scores, *self._ego(scores, valid, offsets, weights), tuple(history))

    def _hearings(self, hops: Tensor, ranks: Tensor) -> dict[int, Hearing]:
        """The masks of each level that a round asks for: hops [B, N, N], ranks [B, N]."""
        away = hops.to(ranks.dtype)
        gap = (ranks[:, None, :] - ranks[:, :, None]) * RANK_SCALE  # 1 or more for those later in the order
        groups = torch.stack([gap + 1, 1 - gap], dim=1) if self.config.order else torch.zeros_like(gap)[:, None]
        others = (groups.relu() + (1 - away.abs()).relu()[:, None]) * HIDDEN_SCORE  # never the robot itself
        found = {}
        for level in set(self.config.levels):
            beyond = torch.maximum(away - level, -away).relu() * HIDDEN_SCORE  # at level 1: of 2 hops, and of -1
            found[level] = Hearing(beyond[:, None], (others + beyond[:, None])[:, :, None, ..., None])
        return found

    def _legs(self, offsets: Tensor) -> Tensor | None:
        """Weights of one candidate for another by the way between them, exp(-way / reach): [B, 1, H * M, M].

        The way is taken as 4-connected with nothing between: only what is near counts.
        """
        if self.slopes is None:
            return None
        x, y = offsets[..., 0], offsets[..., 1]
        way = (x.unsqueeze(1) - x.unsqueeze(2)).abs() + (y.unsqueeze(1) - y.unsqueeze(2)).abs()  # [B, M, M]
        heads = torch.cat([way * -slope for slope in functional.softplus(self.slopes)], dim=1)
        others = torch.cat([(way > 0) * LEG_SCALE] * self.config.heads, dim=1)  # not the candidate itself
        return (torch.exp(heads) * others).unsqueeze(1)

    def _seen(self, maps: Tensor | None, cells: Tensor | None, inside: Tensor) -> Tensor | None:
        """What the window shows of each candidate, 0 for those outside: [B, N, M, C]."""
        if self.window is None or maps is None or cells is None:
            return None
        read: Tensor = self.window(maps, cells)
        return read * inside.unsqueeze(-1)

    def _encode(self, robots: Tensor, pairs: Tensor, seen: Tensor | None, places: Tensor | None) -> Tensor:
        parts = [pairs, robots.unsqueeze(2).expand(-1, -1, pairs.shape[2], -1)]
        if places is not None:
            parts.append(places.unsqueeze(1).expand(-1, pairs.shape[1], -1, -1))
        if seen is not None:
            parts.append(seen)
        table = torch.cat(parts, dim=-1)
        encoded: Tensor = self.encode(table.reshape(-1, table.shape[-1]))
        return encoded

    def _ego(self, scores: Tensor, valid: Tensor, offsets: Tensor, weights: Tensor) -> tuple[Tensor, Tensor]:
        """Ego's score-weighted mean cell (the paper's output) and its attention in the last round."""
        bids = scores[:, 0, :-1].softmax(dim=-1) * valid[:, 0]
        xy = (bids.unsqueeze(-1) * offsets).sum(dim=1)
        return xy, weights[:, :, 0].mean(dim=1)


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
