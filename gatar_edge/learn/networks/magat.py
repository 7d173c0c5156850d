"""Message-aware graph attention (Li et al. 2021): key-query attention in the place of a filter's adjacency."""

from __future__ import annotations

from torch import Tensor, nn
from torch.nn import functional

from gatar_edge.learn.networks.gat import GatConfig, attention_weights, by_head
from gatar_edge.learn.networks.paper_shape import PaperShaped
from gatar_edge.learn.networks.vcycle import Chain


class KeyQueryFilter(nn.Module):
    """y_n = ReLU(H_0 x_n + H_1 sum over m of A_nm x_m + b), the heads' results side by side."""

    def __init__(self, size_in: int, size_out: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.query = nn.Linear(size_in, size_out, bias=False)
        self.key = nn.Linear(size_in, size_out, bias=False)
        self.own = nn.Linear(size_in, size_out)
        self.others = nn.Linear(size_in, size_out, bias=False)

    def forward(self, x: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
        alpha = attention_weights(self.query(x), self.key(x), mask, self.heads)
        told = (alpha @ by_head(self.others(x), self.heads)).transpose(1, 2).flatten(2)
        return functional.relu(self.own(x) + told), alpha[:, :, 0].mean(dim=1)


class Magat(PaperShaped):
    """Two such filters over the 1-hop graph."""

    def __init__(self, config: GatConfig | None = None) -> None:
        config = config or GatConfig()
        super().__init__(config, Chain(lambda size, out: KeyQueryFilter(size, out, config.heads), config.width))
