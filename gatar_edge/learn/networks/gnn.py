"""Graph filters of two taps (Zhou et al., "Graph neural networks for decentralized multi-robot target tracking")."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from gatar_edge.learn.networks.paper_shape import PaperConfig, PaperShaped
from gatar_edge.learn.networks.vcycle import Chain


class GraphFilter(nn.Module):
    """Y = ReLU(X H_0 + S X H_1 + b), S the 0/1 adjacency of the mask without the robot itself."""

    def __init__(self, size_in: int, size_out: int) -> None:
        super().__init__()
        self.own = nn.Linear(size_in, size_out)
        self.others = nn.Linear(size_in, size_out, bias=False)

    def forward(self, x: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
        alone = torch.eye(mask.shape[1], dtype=torch.bool, device=mask.device)
        adjacency = (mask & ~alone).to(x.dtype)
        heard = functional.relu(self.own(x) + adjacency @ self.others(x))
        shown = mask[:, 0].to(x.dtype)
        return heard, shown / shown.sum(dim=-1, keepdim=True).clamp(min=1)


class Gnn(PaperShaped):
    """Two filters over the 1-hop graph."""

    def __init__(self, config: PaperConfig | None = None) -> None:
        config = config or PaperConfig()
        super().__init__(config, Chain(GraphFilter, config.width))
