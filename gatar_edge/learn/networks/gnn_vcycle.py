"""The V-cycle with graph filters in place of attention."""

from __future__ import annotations

from dataclasses import dataclass

from gatar_edge.learn.networks.gnn import GraphFilter
from gatar_edge.learn.networks.paper_shape import PaperConfig, PaperShaped
from gatar_edge.learn.networks.vcycle import VCycle


@dataclass(frozen=True, slots=True)
class GnnVcycleConfig(PaperConfig):
    """See `PaperConfig`."""

    bottom: int = 16  # numbers at the lowest level


class GnnVcycle(PaperShaped):
    """Filters down and up the levels."""

    def __init__(self, config: GnnVcycleConfig | None = None) -> None:
        config = config or GnnVcycleConfig()
        super().__init__(config, VCycle(GraphFilter, config.width, config.bottom))
