"""What the networks of the paper's comparison share: maps in, x-y out; they differ in how robots are aggregated alone.

Shapes: B views, N robots, M candidates, D width, C conv channels. CNN and MLP encode each robot's four channels, the
aggregation lets robots tell each other, CNN and MLP decode what was heard beside the robot's own maps (fig. 2 of the
paper). Each robot gets the x-y of its target, relative to itself; the loss is the squared error (eq. 11). A candidate's
score is minus its distance from that place, so that the same decoder serves these networks and those that score; in
tens of cells, because sharper probabilities would come so near to 0 and 1 that single precision could not rank them.

The paper's maps are the whole world; ours are windows round each robot, so a robot also tells where it is.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from gatar_edge.features import CHANNELS, LENGTH_SCALE_CELLS, PAIR_FEATURES, WINDOW
from gatar_edge.learn.networks.gatar import HIDDEN_SCORE, Outputs

GAUSSIAN = CHANNELS.index("gaussian_target")
DX = PAIR_FEATURES.index("dx")  # and dy behind it
NO_TARGET_SCORE = -1e3  # these networks never say "no target": it is worse than any distance, better than impossible
LIFTED = 2  # maps that carry what was heard into the decoder's CNN
SIDE = WINDOW // 2 + 1  # of the maps behind the first convolution: at full size they cost five times the rest


@dataclass(frozen=True, slots=True)
class PaperConfig:
    """Encoder and decoder; each network adds what its aggregation has."""

    width: int = 128  # of what a robot tells
    conv_channels: int = 8
    hidden: int = 64  # of the decoder's MLP
    channels: tuple[bool, ...] = (True,) * len(CHANNELS)  # without the Gaussian, the bare target cells are seen


@dataclass(frozen=True, slots=True)
class XyOutputs(Outputs):
    """What an x-y network says of every robot, in tens of cells."""

    places: Tensor  # [B, N, 2], where each robot is sent, relative to itself
    ways: Tensor  # [B, N, M, 2], candidates relative to each robot

    def squared_error(self, labels: Tensor, weight: Tensor) -> Tensor:
        """Weighted mean of the squared error over robots with a target; `labels` as in `Batch`, `weight` [B, N]."""
        count = self.ways.shape[2]
        given = (labels >= 0) & (labels < count)
        index = labels.clamp(0, count - 1)[..., None, None].expand(-1, -1, 1, 2)
        wanted = self.ways.gather(2, index).squeeze(2)
        weight = weight * given
        error = (self.places - wanted).square().sum(dim=-1)
        return (error * weight).sum() / weight.sum().clamp(min=1.0)


class Encoder(nn.Module):
    """[R, 4, 15, 15] and places [R, 2] -> the robot's maps after the CNN [R, C, 8, 8] and what it tells [R, D]."""

    def __init__(self, config: PaperConfig) -> None:
        super().__init__()
        channels = config.conv_channels
        self.convolve = nn.Sequential(
            nn.Conv2d(len(CHANNELS), 2 * channels, 3, stride=2, padding=1), nn.ReLU(),
            nn.Conv2d(2 * channels, channels, 3, padding=1), nn.ReLU(),
        )  # fmt: skip
        self.tell = nn.Sequential(nn.Linear(channels * SIDE * SIDE + 2, config.width), nn.ReLU())
        self.seen: Tensor
        seen = torch.tensor(config.channels, dtype=torch.float32)[:, None, None]
        self.register_buffer("seen", seen, persistent=False)
        self.bare_targets = not config.channels[GAUSSIAN]

    def forward(self, maps: Tensor, places: Tensor) -> tuple[Tensor, Tensor]:
        shown = maps * self.seen
        if self.bare_targets:  # the Gaussian is 1 at a target and nowhere else
            bare = (maps[:, GAUSSIAN : GAUSSIAN + 1] >= 1).to(maps.dtype)
            shown = torch.cat([shown[:, :GAUSSIAN], bare, shown[:, GAUSSIAN + 1 :]], dim=1)
        own = self.convolve(shown.contiguous(memory_format=torch.channels_last))  # half the time of few channels
        return own, self.tell(torch.cat([own.flatten(1), places], dim=1))


class Decoder(nn.Module):
    """The robot's maps [R, C, 8, 8] and what it heard [R, D] -> x-y [R, 2]."""

    def __init__(self, config: PaperConfig) -> None:
        super().__init__()
        channels, width = config.conv_channels, config.width
        self.lift = nn.Linear(width, LIFTED * SIDE * SIDE)
        self.convolve = nn.Sequential(
            nn.Conv2d(channels + LIFTED, channels, 3, padding=1), nn.ReLU(),
            nn.Conv2d(channels, channels, 3, padding=1), nn.ReLU(),
        )  # fmt: skip
        self.place = nn.Sequential(
            nn.Linear(channels * SIDE * SIDE + width, config.hidden), nn.ReLU(), nn.Linear(config.hidden, 2)
        )

    def forward(self, own: Tensor, heard: Tensor) -> Tensor:
        lifted = self.lift(heard).reshape(-1, LIFTED, SIDE, SIDE)
        joined = self.convolve(torch.cat([own, lifted], dim=1).contiguous(memory_format=torch.channels_last))
        place: Tensor = self.place(torch.cat([joined.flatten(1), heard], dim=1))
        return place


class PaperShaped(nn.Module):
    """Encoder, aggregation, decoder. `aggregate` takes [B, N, D] and hops [B, N, N] and gives [B, N, D] and ego's
    attention [B, N].
    """

    inputs = ("maps", "pairs", "valid", "offsets", "hops")

    def __init__(self, config: PaperConfig, aggregate: nn.Module) -> None:
        super().__init__()
        self.config = config
        self.encode = Encoder(config)
        self.aggregate = aggregate
        self.decode = Decoder(config)

    def forward(self, maps: Tensor, pairs: Tensor, valid: Tensor, offsets: Tensor, hops: Tensor) -> XyOutputs:
        """Inputs as `gatar_edge.features.AXES`, with one batch axis in front."""
        views, robots = maps.shape[0], maps.shape[1]
        shown = valid > 0
        ways = pairs[..., DX : DX + 2]
        places = _places(ways, offsets, shown)
        own, told = self.encode(maps.flatten(0, 1), places.flatten(0, 1))
        heard, attention = self.aggregate(told.reshape(views, robots, self.config.width), hops)
        sent = self.decode(own, heard.flatten(0, 1)).reshape(views, robots, 2)
        gap = (sent.unsqueeze(2) - ways).square().sum(dim=-1).sqrt()
        scores = torch.where(shown, -gap, HIDDEN_SCORE)
        scores = torch.cat([scores, torch.full_like(scores[..., :1], NO_TARGET_SCORE)], dim=-1)
        return XyOutputs(scores, sent[:, 0] * LENGTH_SCALE_CELLS, attention, (), sent, ways)


def _places(ways: Tensor, offsets: Tensor, shown: Tensor) -> Tensor:
    """Where each robot is, relative to ego, in tens of cells: [B, N, 2]; 0 for one that can reach no candidate.

    A candidate lies at `offsets` from ego and at `ways` from the robot: the difference is the same for all of them.
    """
    gaps = (offsets.unsqueeze(1) / LENGTH_SCALE_CELLS - ways) * shown.unsqueeze(-1)
    return gaps.sum(dim=2) / shown.sum(dim=2, keepdim=True).clamp(min=1)
