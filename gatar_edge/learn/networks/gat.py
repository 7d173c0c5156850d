"""Plain graph attention (eq. 10) without the V-cycle."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from gatar_edge.learn.networks.gatar import HIDDEN_SCORE
from gatar_edge.learn.networks.paper_shape import PaperConfig, PaperShaped
from gatar_edge.learn.networks.vcycle import Chain


@dataclass(frozen=True, slots=True)
class GatConfig(PaperConfig):
    """See `PaperConfig`."""

    heads: int = 4


def attention_weights(query: Tensor, key: Tensor, mask: Tensor, heads: int) -> Tensor:
    """alpha_nm = softmax over m in N(n) of LeakyReLU(q_n k_m / sqrt d): [B, H, N, N], exactly 0 outside the mask."""
    size = query.shape[-1] // heads
    left, right = by_head(query, heads), by_head(key, heads)
    logits = functional.leaky_relu(left @ right.transpose(-1, -2) / math.sqrt(size), 0.2)
    shown = mask.unsqueeze(1)
    alpha = torch.where(shown, logits, HIDDEN_SCORE).softmax(dim=-1)
    return torch.where(shown, alpha, 0.0)


def by_head(x: Tensor, heads: int) -> Tensor:
    """[B, N, D] -> [B, H, N, D / H]."""
    return x.reshape(x.shape[0], x.shape[1], heads, x.shape[2] // heads).transpose(1, 2)


class Attention(nn.Module):
    """Multi-head graph attention with the heads' results side by side."""

    def __init__(self, size_in: int, size_out: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.query = nn.Linear(size_in, size_out, bias=False)
        self.key = nn.Linear(size_in, size_out, bias=False)
        self.value = nn.Linear(size_in, size_out)

    def forward(self, x: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
        alpha = attention_weights(self.query(x), self.key(x), mask, self.heads)
        heard = (alpha @ by_head(self.value(x), self.heads)).transpose(1, 2).flatten(2)
        return functional.relu(heard), alpha[:, :, 0].mean(dim=1)


class Gat(PaperShaped):
    """Two layers of attention over the 1-hop graph."""

    def __init__(self, config: GatConfig | None = None) -> None:
        config = config or GatConfig()
        super().__init__(config, Chain(lambda size, out: Attention(size, out, config.heads), config.width))
