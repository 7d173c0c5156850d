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
from gatar_edge.learn.networks.gatar_round import MOST_SCORE, GatarConfig, Hearing, Round, pointwise

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
    """The shared CNN over the four channels, read at each candidate's cell: [B, N, 4, 15, 15] -> [B, C, N, M]."""

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
        return x.gather(3, index).transpose(1, 2)


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
        self.groups: Tensor  # times the gap of ranks: hides later robots from the first group, earlier from the second
        signs = torch.tensor([1.0, -1.0])[:, None, None]
        self.register_buffer("groups", signs * RANK_SCALE * HIDDEN_SCORE, persistent=False)
        self.pair_scale: Tensor
        self.robot_scale: Tensor
        for name, features in (("pair_scale", PAIR_FEATURES), ("robot_scale", ROBOT_FEATURES)):
            self.register_buffer(name, torch.tensor([float(f not in hidden) for f in features]), persistent=False)

    def forward(
        self, robots: Tensor, pairs: Tensor, valid: Tensor, offsets: Tensor, hops: Tensor,
        maps: Tensor | None = None, cells: Tensor | None = None, places: Tensor | None = None,
    ) -> Outputs:  # fmt: skip
        valid = valid.unsqueeze(1)
        robots = robots.unsqueeze(3).transpose(1, 2)  # [B, F, N, 1]
        pairs = pairs.permute(0, 3, 1, 2)
        legs = self._legs(offsets)
        hearings = self._hearings(hops, robots[:, RANK : RANK + 1])
        robots = robots * self.robot_scale[:, None, None]
        hidden = (1 - valid) * HIDDEN_SCORE
        first, last = _linears(self.none)
        weight_of_mean, weight_of_robots = _split(first, self.config.width, robots.shape[1])
        of_robots = functional.conv2d(robots, weight_of_robots)  # the same in all rounds
        share = valid / valid.sum(dim=3, keepdim=True).clamp(min=1)  # of each candidate in the mean

        def scores_of(normed: Tensor) -> tuple[Tensor, Tensor]:
            """[B, 1, N, M], about `HIDDEN_SCORE` where a candidate does not exist or cannot be reached, and the same
            with the score of no target behind.
            """
            scores = pointwise(self.score, normed) + hidden
            mean = (normed * share).sum(dim=3, keepdim=True)
            none = functional.relu(functional.conv2d(mean, weight_of_mean, first.bias) + of_robots)
            return scores, torch.cat([scores, pointwise(last, none)], dim=3)

        seen = self._seen(maps, cells, pairs[:, INSIDE : INSIDE + 1])
        h = self._encode(robots, pairs, seen, places)
        levels = self.config.levels
        turn = len(levels) // 2
        down: dict[int, Tensor] = {}
        history: list[Tensor] = []
        weights = h
        for index, level in enumerate(levels):
            if index >= turn and self.config.shortcuts and level in down:
                h = h + self._shortcut(level, down.pop(level))
            if index < turn:
                down[level] = h
            normed = self._normed(h)
            scores, every = scores_of(normed)
            history.append(every.squeeze(1))
            bids = every.softmax(dim=3)[..., :-1]
            told = scores.clamp(-MOST_SCORE / SCORE_SCALE, MOST_SCORE / SCORE_SCALE) * SCORE_SCALE
            changed, weights = self.rounds[self.plan[index]](normed, bids, told, hearings[level], valid, legs)
            h = h + changed
        scores, every = scores_of(self._normed(h))
        xy = _ego_xy(scores, valid, offsets)
        return Outputs(every.squeeze(1), xy, weights[:, :, 0].mean(dim=1), tuple(history))

    def shows_more_than(self, before: Gatar) -> None:
        """Start from the weights of `before`, a network of the same size that hides features which this one sees.

        Those count nothing at first, so that both say the same.
        """
        self.load_state_dict(before.state_dict())
        pairs, robots = (
            torch.nonzero(new > old).flatten()
            for new, old in ((self.pair_scale, before.pair_scale), (self.robot_scale, before.robot_scale))
        )
        with torch.no_grad():
            _linears(self.encode)[0].weight[:, pairs] = 0
            _linears(self.encode)[0].weight[:, len(PAIR_FEATURES) + robots] = 0
            _linears(self.none)[0].weight[:, self.config.width + robots] = 0

    def _shortcut(self, level: int, before: Tensor) -> Tensor:
        """K_ll of eq. 9b: what the way up at `level` takes from the way down."""
        ups = sorted(set(self.config.levels[len(self.config.levels) // 2 :]))
        return pointwise(self.shortcut[ups.index(level)], before)  # type: ignore[arg-type]

    def _normed(self, h: Tensor) -> Tensor:
        """`norm` over the features of h [B, D, N, M]."""
        normed: Tensor = self.norm(h.movedim(1, 3)).movedim(3, 1)
        return normed

    def _hearings(self, hops: Tensor, ranks: Tensor) -> dict[int, Hearing]:
        """The masks of each level that a round asks for: hops [B, N, N], ranks [B, 1, N, 1]."""
        away = hops.unsqueeze(1).to(ranks.dtype)
        if self.config.order:
            gap = ranks.transpose(2, 3) - ranks  # above 0 for those later in the order, 0 for the robot itself
            others = (gap * self.groups + HIDDEN_SCORE).clamp(max=0)
        else:
            others = (1 - away.abs()).relu() * HIDDEN_SCORE
        near = away * HIDDEN_SCORE
        found = {}
        for level in set(self.config.levels):
            beyond = torch.minimum(near - level * HIDDEN_SCORE, -near).clamp(max=0)  # at level 1: of 2 hops, and of -1
            found[level] = Hearing(beyond, (others + beyond)[:, :, None, ..., None])
        return found

    def _legs(self, offsets: Tensor) -> Tensor | None:
        """Weights of one candidate for another by the way between them, exp(-way / reach): [B, H, M, M].

        The way is taken as 4-connected with nothing between: only what is near counts.
        """
        if self.slopes is None:
            return None
        x_y = offsets.unsqueeze(3).transpose(1, 2)  # [B, 2, M, 1]
        way = (x_y.transpose(2, 3) - x_y).abs().sum(dim=1, keepdim=True)  # [B, 1, M, M]
        others = way.clamp(max=1) * LEG_SCALE  # ways are whole numbers: 0 for the candidate itself, 1 for the others
        return torch.exp(way * -functional.softplus(self.slopes)[:, None, None]) * others

    def _seen(self, maps: Tensor | None, cells: Tensor | None, inside: Tensor) -> Tensor | None:
        """What the window shows of each candidate, 0 for those outside: [B, C, N, M]; `inside` [B, 1, N, M]."""
        if self.window is None or maps is None or cells is None:
            return None
        read: Tensor = self.window(maps, cells)
        return read * inside

    def _encode(self, robots: Tensor, pairs: Tensor, seen: Tensor | None, places: Tensor | None) -> Tensor:
        """The first layer adds up what it makes of pairs [B, P, N, M], robots [B, F, N, 1], places [B, M, C] and the
        window [B, C, N, M]: none has to be as large as all together.
        """
        first, last = _linears(self.encode)
        parts = [pairs, robots]
        if places is not None:
            parts.append(places.unsqueeze(1).permute(0, 3, 1, 2))
        if seen is not None:
            parts.append(seen)
        weights = _split(first, *(part.shape[1] for part in parts))
        table = functional.conv2d(pairs, weights[0] * self.pair_scale[:, None, None], first.bias)
        rest = sum(functional.conv2d(part, weight) for part, weight in zip(parts[1:], weights[1:], strict=True))
        return pointwise(last, functional.relu(table + rest))


def _split(layer: nn.Linear, *sizes: int) -> tuple[Tensor, ...]:
    """The layer's weights for parts of so many features each, as `conv2d` takes them."""
    return torch.split(layer.weight[:, :, None, None], [*sizes], dim=1)


def _linears(layers: nn.Sequential) -> tuple[nn.Linear, nn.Linear]:
    """The first and the last of (linear, ReLU, linear)."""
    first, _, last = layers
    return first, last  # type: ignore[return-value]


def _ego_xy(scores: Tensor, valid: Tensor, offsets: Tensor) -> Tensor:
    """Ego's score-weighted mean cell (the paper's output): scores and valid [B, 1, N, M], offsets [B, M, 2]."""
    bids = scores[:, :, 0].softmax(dim=-1) * valid[:, :, 0]
    return (bids @ offsets).squeeze(1)


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
