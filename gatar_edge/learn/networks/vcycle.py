"""The paper's V-cycle (eq. 9) over any kind of graph layer: down to wider hop masks and fewer numbers, and up again."""

from __future__ import annotations

from collections.abc import Callable

from torch import Tensor, nn
from torch.nn import functional

Layer = Callable[[int, int], nn.Module]  # (numbers in, numbers out) -> (x [B, N, in], mask [B, N, N]) -> x, attention


def within(hops: Tensor, level: int) -> Tensor:
    """Who is at most `level` hops away from whom, each robot itself among them: bool [B, N, N]."""
    return (hops >= 0) & (hops <= level)


class VCycle(nn.Module):
    """Widths D -> D -> `bottom` -> D -> D over masks of 1, 2, 2, 1 hops.

    Each way up is joined to the way down at its level by K_ll. At the top, K_00 would be as large as all the rest: what
    comes in is added as it is, which is the paper's residual connection from encoder to decoder.
    """

    def __init__(self, layer: Layer, width: int, bottom: int) -> None:
        super().__init__()
        self.down = nn.ModuleList([layer(width, width), layer(width, bottom)])
        self.up = nn.ModuleList([layer(bottom, width), layer(width, width)])
        self.shortcut = nn.Linear(width, width)

    def forward(self, x: Tensor, hops: Tensor) -> tuple[Tensor, Tensor]:
        near, far = within(hops, 1), within(hops, 2)
        first, _ = self.down[0](x, near)
        lowest, _ = self.down[1](first, far)
        risen, _ = self.up[0](lowest, far)
        risen = risen + functional.relu(self.shortcut(first))
        top, attention = self.up[1](risen, near)
        return x + top, attention


class Chain(nn.Module):
    """Without the V-cycle: two layers over the 1-hop graph, so that news travels as far as in the V-cycle's views."""

    def __init__(self, layer: Layer, width: int) -> None:
        super().__init__()
        self.layers = nn.ModuleList([layer(width, width), layer(width, width)])

    def forward(self, x: Tensor, hops: Tensor) -> tuple[Tensor, Tensor]:
        near = within(hops, 1)
        heard, _ = self.layers[0](x, near)
        heard, attention = self.layers[1](heard, near)
        return x + heard, attention
