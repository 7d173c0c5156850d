"""`gatar train`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from gatar_edge.commands._learn import bar, need
from gatar_edge.commands._options import FiniteRange
from gatar_edge.errors import ConfigError

if TYPE_CHECKING:
    from gatar_edge.learn.train import Progress, Trainer


@click.command("train")
@click.option("--network", default="gatar", show_default=True)
@click.option("--data", type=click.Path(path_type=Path, file_okay=False), help="Made by `gatar dataset`.")
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), help="Run folder; goes on if cut off.")
@click.option("--minutes", type=FiniteRange(0, 1e6), default=0.0, help="Stop after so long.")
@click.option(
    "--epochs",
    type=FiniteRange(0, 1e6),
    default=0.0,
    help="Stop after so many views of the data; the same weights again.",
)
@click.option(
    "--steps", type=click.IntRange(0, 10**9), default=0, help="Stop after so many batches; the same weights again."
)
@click.option("--batch", type=click.IntRange(1, 65536), default=64, show_default=True, help="Views a step and rank.")
@click.option(
    "--rate", type=FiniteRange(0, 1, min_open=True), default=2e-3, show_default=True, help="Largest learning rate."
)
@click.option("--seed", type=click.IntRange(0, 2**32 - 1), default=0, show_default=True)
@click.option("--threads", type=click.IntRange(1, 256), default=2, show_default=True)
@click.option(
    "--device",
    type=click.Choice(["auto", "cpu", "cuda"]),
    default="auto",
    show_default=True,
    help="auto: the GPU where there is one.",
)
@click.option(
    "--precision",
    type=click.Choice(["auto", "float32", "bf16"]),
    default="auto",
    show_default=True,
    help="auto: bf16 on a GPU, float32 on a CPU, where bf16 was measured to be slower.",
)
@click.option("--set", "settings", multiple=True, metavar="NAME=JSON", help="A field of the network's config.")
@click.option("--plot", type=click.Path(path_type=Path, file_okay=False), help="Draw the curves of this run instead.")
@click.option("-o", "plot_file", type=click.Path(path_type=Path, dir_okay=False), help="With --plot: .svg or .png.")
def command(
    network: str,
    data: Path | None,
    out: Path | None,
    minutes: float,
    epochs: float,
    steps: int,
    batch: int,
    rate: float,
    seed: int,
    threads: int,
    device: str,
    precision: str,
    settings: tuple[str, ...],
    plot: Path | None,
    plot_file: Path | None,
) -> None:
    """Train a network to choose as the labels of a data set do.

    Under torchrun every rank draws its own batches, by the seed and its number, and gradients are averaged: over NCCL
    between GPUs, over gloo between CPUs. Rank 0 writes the run folder, which all ranks must see. A run that was cut off
    or killed goes on from its last checkpoint (one a minute) when the same command is given again.

    \b
    Example:
      gatar train --network gatar --data data/greedy --minutes 20 --out runs/greedy
      gatar train --network gatar --data data/greedy --epochs 1 --set 'maps=false' --out runs/without-maps
      torchrun --standalone --nproc-per-node 2 -m gatar_edge train --data data/greedy --epochs 1 --out runs/two
      gatar train --plot runs/greedy -o greedy.svg
    """
    if plot is not None:
        _plot(plot, plot_file or plot / "curves.svg")
        return
    if data is None or out is None:
        raise ConfigError("train needs --data and --out, or --plot RUN")
    need("gatar train", "torch", "safetensors", "numba")
    from gatar_edge.learn.dataset import load_manifest
    from gatar_edge.learn.ranks import joined, uses_bf16
    from gatar_edge.learn.train import Trainer, TrainOptions

    with joined(device) as ranks:
        if epochs > 0:
            steps = max(1, round(epochs * load_manifest(data)["samples"] / (batch * ranks.count)))
        options = TrainOptions(
            network,
            str(data),
            seed,
            minutes,
            steps,
            batch,
            rate,
            threads=threads,
            settings=_parsed(settings),
            bf16=uses_bf16(precision, ranks.device),
            ranks=ranks.count,
        )
        trainer = Trainer(options, out, ranks.device, ranks)
        if ranks.rank > 0:
            trainer.run(lambda progress: None)
            return
        weights = _run(trainer)
    click.echo(f"{trainer.step} steps: {weights}")


def _run(trainer: Trainer) -> Path:
    with bar("train", "") as show:
        mean = {"loss": 0.0, "exact": 0.0, "weight": 0.0}

        def report(progress: Progress) -> None:
            for name, value in (("loss", progress.loss), ("exact", progress.exact), ("weight", 1.0)):
                mean[name] = 0.98 * mean[name] + 0.02 * value
            loss, exact = (mean[name] / mean["weight"] for name in ("loss", "exact"))
            show(progress.done, f"step {progress.step}, loss {loss:.3f}, exact {exact:.3f}")

        return trainer.run(report)


def _plot(run: Path, out: Path) -> None:
    need("gatar train --plot", "matplotlib")
    from gatar_edge.learn.curves import plot

    plot(run, out)
    click.echo(out)


def _parsed(settings: tuple[str, ...]) -> dict[str, Any]:
    parsed: dict[str, Any] = {}
    for text in settings:
        name, _, value = text.partition("=")
        try:
            parsed[name] = json.loads(value)
        except ValueError:
            raise ConfigError(f"--set {text!r} is not NAME=JSON, for example maps=false or width=48") from None
    return parsed
