"""GATAR in the paper's shape: the V-cycle over graph attention."""

from __future__ import annotations

from dataclasses import dataclass

from torch import nn

from gatar_edge.learn.networks.gat import Attention
from gatar_edge.learn.networks.paper_shape import PaperConfig, PaperShaped
from gatar_edge.learn.networks.vcycle import Chain, VCycle


@dataclass(frozen=True, slots=True)
class GatarPaperConfig(PaperConfig):
    """See `PaperConfig`."""

    heads: int = 4
    bottom: int = 16  # numbers at the lowest level
    vcycle: bool = True  # without: the network `gat`


class GatarPaper(PaperShaped):
    """Attention down and up the levels."""

    def __init__(self, config: GatarPaperConfig | None = None) -> None:
        config = config or GatarPaperConfig()

        def layer(size: int, out: int) -> nn.Module:
            return Attention(size, out, config.heads)

        cycle = VCycle(layer, config.width, config.bottom) if config.vcycle else Chain(layer, config.width)
        super().__init__(config, cycle)
