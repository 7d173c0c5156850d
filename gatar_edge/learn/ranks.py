"""One process, or several that `torchrun` started: who is who, on which device, and what they must agree on."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from torch import distributed, nn

from gatar_edge.errors import ConfigError

Array = npt.NDArray[np.float64]

DEVICES = ("auto", "cpu", "cuda")
PRECISIONS = ("auto", "float32", "bf16")


@dataclass(frozen=True, slots=True)
class Ranks:
    """This process among all of a run."""

    rank: int = 0
    count: int = 1
    device: str = "cpu"

    def of_first(self, value: float) -> float:
        """Rank 0's value, on every rank: all must end at the same step, with the same learning rate."""
        if self.count == 1:
            return value
        shared = torch.tensor([value], dtype=torch.float64, device=self.device)
        distributed.broadcast(shared, src=0)
        return float(shared)

    def sum(self, values: Array) -> Array:
        """Of all ranks' values, on every rank."""
        if self.count == 1:
            return values
        total = torch.from_numpy(values.copy())
        distributed.all_reduce(total)
        return total.numpy()

    def add_gradients(self, network: nn.Module) -> None:
        """Make every gradient the sum of all ranks'; a parameter without one counts as 0 where another rank has one."""
        if self.count == 1:
            return
        parameters = list(network.parameters())
        flat = torch.cat([(torch.zeros_like(p) if p.grad is None else p.grad).flatten() for p in parameters])
        distributed.all_reduce(flat)
        first = 0
        for parameter in parameters:
            parameter.grad = flat[first : first + parameter.numel()].view_as(parameter)
            first += parameter.numel()

    def check_alike(self, network: nn.Module) -> None:
        """Raises ConfigError where the ranks do not hold the same weights, to the bit."""
        if self.count == 1:
            return
        flat = torch.cat([p.detach().flatten() for p in network.parameters()])
        first = flat.clone()
        distributed.broadcast(first, src=0)
        if not torch.equal(first.view(torch.int32), flat.view(torch.int32)):
            gap = float((first - flat).abs().max())
            raise ConfigError(f"rank {self.rank} holds other weights than rank 0, by up to {gap:.1e}: unlike machines?")


ALONE = Ranks()


@contextmanager
def joined(device: str) -> Iterator[Ranks]:
    """The ranks of this run, by torchrun's environment: NCCL between GPUs, gloo between CPUs. Raises ConfigError."""
    count = int(os.environ.get("WORLD_SIZE", "1"))
    local = int(os.environ.get("LOCAL_RANK", "0"))
    chosen = device_of(device, local)
    if chosen != "cpu":
        os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")  # else its sums differ from run to run
        torch.cuda.set_device(chosen)
    if count == 1:
        yield Ranks(device=chosen)
        return
    distributed.init_process_group("gloo" if chosen == "cpu" else "nccl")
    try:
        yield Ranks(distributed.get_rank(), count, chosen)
    finally:
        distributed.destroy_process_group()


def device_of(name: str, local_rank: int = 0) -> str:
    """`cpu`, or the GPU of this rank: with `auto`, wherever there is one. Raises ConfigError."""
    there = torch.cuda.device_count() if name != "cpu" and torch.cuda.is_available() else 0
    if name == "cpu" or (name == "auto" and there == 0):
        return "cpu"
    if local_rank >= there:
        raise ConfigError(f"rank {local_rank} of this machine needs a GPU, {there} can be used: take --device cpu")
    return f"cuda:{local_rank}"


def uses_bf16(precision: str, device: str) -> bool:
    """Whether to compute in bfloat16: `auto` does on a GPU, not on a CPU.

    Measured on a CPU without instructions for it (AVX2), a step takes 3.8 times as long.
    """
    return precision == "bf16" or (precision == "auto" and device != "cpu")
