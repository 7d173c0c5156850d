"""One training loop for every network: imitation of the labels of a data set.

A run folder holds `run.json` (all options), `checkpoint.safetensors` (exact state), `log.jsonl` (curves) and at the end
`model.safetensors` with `model.json`. A run that was cut off goes on from its checkpoint with the same batches.

Under torchrun each rank draws its own batches, from the seed and its number; gradients are averaged; rank 0 writes.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor, nn
from torch.nn import functional
from torch.nn.parallel import DistributedDataParallel

from gatar_edge.errors import ConfigError
from gatar_edge.learn.checkpoint import claim, load_checkpoint, save_checkpoint
from gatar_edge.learn.curves import Curves
from gatar_edge.learn.loader import Loader
from gatar_edge.learn.networks import build, settings_of
from gatar_edge.learn.networks.paper_shape import XyOutputs
from gatar_edge.learn.ranks import ALONE, Ranks
from gatar_edge.learn.views import IGNORED, Batch, batches, load_groups

NEIGHBOUR_WEIGHT = 0.5  # of the rows that are not ego's: they matter when scores are decoded together
EARLIER_WEIGHT = 0.3  # of the rounds before the last: deep supervision


@dataclass(frozen=True, slots=True)
class TrainOptions:
    """All that decides a run. Either `minutes` or `steps` ends it; only `steps` gives the same weights again."""

    network: str
    data: str
    seed: int = 0
    minutes: float = 0.0
    steps: int = 0
    batch: int = 64
    rate: float = 2e-3
    warm_up: int = 200
    weight_decay: float = 1e-4
    clip: float = 1.0
    threads: int = 1  # of torch: how sums are split decides their last bits
    bf16: bool = False  # autocast
    ranks: int = 1
    settings: dict[str, Any] = field(default_factory=dict)  # fields of the network's config


@dataclass(frozen=True, slots=True)
class Progress:
    """What a display needs: a step's loss and share of right targets of ego, and how much of the run is done."""

    step: int
    loss: float
    exact: float
    done: float  # 0..1
    seconds: float
    rate: float = 0.0  # learning rate of the step


def loss_of(outputs: Any, batch: Batch) -> Tensor:
    """Cross-entropy over the candidates and "no target", of the last round and less of each earlier one."""
    device = outputs.xy.device
    labels = torch.from_numpy(_usable(batch)).to(device)
    shares = torch.from_numpy(_usable_shares(batch)).to(device)
    labels[:, 0] = torch.where(shares.sum(dim=-1) > 0, labels[:, 0].clamp(min=0), IGNORED)
    used = labels >= 0
    weight = torch.full(labels.shape, NEIGHBOUR_WEIGHT, device=device)
    weight[:, 0] = 1.0
    weight = weight * used
    if isinstance(outputs, XyOutputs):
        return outputs.squared_error(labels, weight, shares)
    total = weight.sum().clamp(min=1.0)

    def cross_entropy(scores: Tensor) -> Tensor:
        scores = scores.float()
        others = functional.cross_entropy(
            scores[:, 1:].flatten(0, 1), labels[:, 1:].clamp(min=0).flatten(), reduction="none"
        )
        ego = functional.cross_entropy(scores[:, 0], shares, reduction="none")
        each = torch.cat([ego[:, None], others.view(len(ego), -1)], dim=1)
        return (each * weight).sum() / total

    earlier = sum((cross_entropy(scores) for scores in outputs.rounds), start=torch.zeros((), device=device))
    return cross_entropy(outputs.scores) + EARLIER_WEIGHT * earlier


def _usable(batch: Batch) -> np.ndarray[Any, np.dtype[np.int64]]:
    """Labels, without those that ego believes unreachable: the network cannot score them."""
    valid: np.ndarray[Any, Any] = batch.inputs["valid"]
    labels: np.ndarray[Any, np.dtype[np.int64]] = batch.labels
    column = np.clip(labels, 0, valid.shape[2] - 1)
    known = np.take_along_axis(valid, column[..., None], axis=2)[..., 0] > 0
    return np.where((labels < 0) | (labels == valid.shape[2]) | known, labels, IGNORED)


def _usable_shares(batch: Batch) -> np.ndarray[Any, np.dtype[np.float32]]:
    """Ego's shares, without those of candidates that it believes unreachable; all 0 where little is left."""
    valid: np.ndarray[Any, Any] = batch.inputs["valid"]
    shares: np.ndarray[Any, np.dtype[np.float32]] = batch.shares.copy()
    shares[:, :-1] *= valid[:, 0]
    total = shares.sum(axis=-1, keepdims=True)
    return np.where(total > 0.5, shares / np.maximum(total, np.float32(1e-6)), np.float32(0))


def tensors_of(batch: Batch, names: Iterable[str]) -> dict[str, Tensor]:
    """Those of the batch's inputs that a network reads."""
    return {name: torch.from_numpy(np.ascontiguousarray(batch.inputs[name])) for name in names}


class Trainer:
    """One run: options, network, optimizer, and where it stands.

    The same seed, steps, threads and ranks give the same weights on a CPU, and nearly the same on a GPU.
    """

    def __init__(self, options: TrainOptions, folder: Path, device: str = "cpu", ranks: Ranks = ALONE) -> None:
        if (options.minutes > 0) == (options.steps > 0):
            raise ConfigError("give either minutes or steps (or epochs), and more than 0")
        if options.ranks != ranks.count:
            raise ConfigError(f"a run of {options.ranks} ranks was started with {ranks.count}")
        self.options = options
        self.folder = folder
        self.device = torch.device(device)
        self.ranks = ranks
        self.groups, self.manifest = load_groups(Path(options.data))
        torch.set_num_threads(options.threads)
        torch.manual_seed(options.seed)
        torch.use_deterministic_algorithms(True, warn_only=self.device.type != "cpu")
        self.network: nn.Module = build(options.network, options.settings).to(self.device)
        self.optimizer = torch.optim.AdamW(
            self.network.parameters(), lr=options.rate, weight_decay=options.weight_decay, fused=True
        )
        self.step = 0
        self.seconds = 0.0
        self._claim()
        self._forward: nn.Module = self.network
        if ranks.count > 1:
            self._forward = DistributedDataParallel(self.network, find_unused_parameters=self._leaves_some_unused())

    def run(self, report: Callable[[Progress], None], checkpoint_every_s: float = 60.0) -> Path:
        """Train to the end; returns the path of the finished weights."""
        saved_s = self.seconds  # by rank 0's clock: all save at the same step
        seed = self.options.seed + (self.ranks.rank << 32)  # no other rank, nor another seed, draws these batches
        windows = "maps" in self.network.inputs  # type: ignore[operator]
        loader = Loader(self.groups, self.options.batch, seed, self.step, windows)
        try:
            with Curves(self.folder, self.step, self.ranks.rank == 0) as curves:
                while self.done < 1:
                    started = time.monotonic()
                    progress = self._train(next(loader), started)
                    report(progress)
                    curves.add(asdict(progress))
                    if self.seconds - saved_s > checkpoint_every_s:
                        self.save()
                        saved_s = self.seconds
        finally:
            loader.close()
        self.save()
        return self._finish()

    @property
    def done(self) -> float:
        """How much of the run is behind: 0..1."""
        options = self.options
        return self.step / options.steps if options.steps else self.seconds / (options.minutes * 60)

    def _train(self, batch: Batch, started: float) -> Progress:
        rate = self.options.rate * self._schedule()
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        inputs = tensors_of(batch, self.network.inputs)  # type: ignore[arg-type]
        with torch.autocast(self.device.type, torch.bfloat16, enabled=self.options.bf16):
            outputs = self._forward(**{name: value.to(self.device) for name, value in inputs.items()})
            loss = loss_of(outputs, batch)
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(self.network.parameters(), self.options.clip)
        self.optimizer.step()
        self.step += 1
        self.seconds = self.ranks.of_first(self.seconds + time.monotonic() - started)
        judged = batch.shares[:, :-1].sum(axis=-1) > 0
        right = outputs.scores[:, 0, :-1].argmax(dim=-1).cpu().numpy() == batch.shares[:, :-1].argmax(axis=-1)
        exact = float(right[judged].mean()) if judged.any() else 1.0
        return Progress(self.step, float(loss.detach()), exact, min(1.0, self.done), self.seconds, rate)

    def _leaves_some_unused(self) -> bool:
        """Whether an ablation left parameters without a gradient: ranks would wait for those for ever."""
        batch = next(batches(self.groups, 2, self.options.seed))
        inputs = tensors_of(batch, self.network.inputs)  # type: ignore[arg-type]
        loss = loss_of(self.network(**{name: value.to(self.device) for name, value in inputs.items()}), batch)
        loss.backward()  # type: ignore[no-untyped-call]
        unused = any(parameter.grad is None for parameter in self.network.parameters())
        self.network.zero_grad(set_to_none=True)
        return unused

    def _schedule(self) -> float:
        warm = min(1.0, (self.step + 1) / self.options.warm_up)
        return warm * (0.5 + 0.5 * math.cos(math.pi * min(1.0, self.done)))

    def save(self) -> None:
        """Write the exact state, whole or not at all. Raises ConfigError where ranks have drifted apart."""
        self.ranks.check_alike(self.network)
        if self.ranks.rank > 0:
            return
        save_checkpoint(self.folder, self.network, self.optimizer, {"step": self.step, "seconds": self.seconds})

    def _claim(self) -> None:
        """Start a folder, or go on with the run that it holds. Raises ConfigError if that is another run."""
        options = {name: value for name, value in asdict(self.options).items() if name != "data"}
        wanted = {"options": options, "data_sha256": self.manifest["sha256"]}
        claim(self.folder, wanted, writes=self.ranks.rank == 0)
        saved = load_checkpoint(self.folder, self.network, self.optimizer, str(self.device))
        if saved is not None:
            self.step, self.seconds = int(saved[0]["step"]), float(saved[0]["seconds"])

    def _finish(self) -> Path:
        path = self.folder / "model.safetensors"
        if self.ranks.rank > 0:
            return path
        save_file(self.network.state_dict(), path)
        description = {
            "network": self.options.network,
            "settings": settings_of(self.network),
            "parameters": sum(p.numel() for p in self.network.parameters()),
            "steps": self.step,
            "data": {"sha256": self.manifest["sha256"], "options": self.manifest["options"]},
            "train": asdict(self.options),
        }
        (self.folder / "model.json").write_text(json.dumps(description, indent=1) + "\n")
        return path


def load_model(folder: Path) -> tuple[nn.Module, dict[str, Any]]:
    """The network of a finished run, in evaluation mode, and its `model.json`. Raises ConfigError."""
    try:
        description: dict[str, Any] = json.loads((folder / "model.json").read_text())
        network = build(description["network"], description["settings"])
        network.load_state_dict(load_file(folder / "model.safetensors"))
    except (OSError, ValueError, SafetensorError) as error:
        raise ConfigError(f"{folder} is not a finished training run: {error}") from None
    except (KeyError, RuntimeError) as error:
        raise ConfigError(f"{folder}: model.json and its weights are not of one run: {_one_line(error)}") from None
    return network.eval(), description


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())[:200]
