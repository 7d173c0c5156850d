"""`gatar train`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from gatar_edge.commands._learn import bar, need
from gatar_edge.errors import ConfigError


@click.command("train")
@click.option("--network", default="gatar", show_default=True)
@click.option("--data", type=click.Path(path_type=Path, file_okay=False), required=True)
@click.option(
    "--out", type=click.Path(path_type=Path, file_okay=False), required=True, help="Run folder; goes on if cut off."
)
@click.option("--minutes", type=float, default=0.0, help="Stop after so long.")
@click.option("--epochs", type=float, default=0.0, help="Stop after so many views of the data; the same weights again.")
@click.option("--steps", type=int, default=0, help="Stop after so many batches; the same weights again.")
@click.option("--batch", type=click.IntRange(1, 65536), default=64, show_default=True, help="Views a step.")
@click.option("--rate", type=float, default=2e-3, show_default=True, help="Largest learning rate.")
@click.option("--seed", type=int, default=0, show_default=True)
@click.option("--threads", type=click.IntRange(1, 256), default=2, show_default=True)
@click.option("--set", "settings", multiple=True, metavar="NAME=JSON", help="A field of the network's config.")
def command(
    network: str, data: Path, out: Path, minutes: float, epochs: float, steps: int, batch: int, rate: float,
    seed: int, threads: int, settings: tuple[str, ...],
) -> None:  # fmt: skip
    """Train a network to choose as the labels of a data set do.

    \b
    Example:
      gatar train --network gatar --data data/greedy --minutes 20 --out runs/greedy
      gatar train --network gatar --data data/greedy --epochs 1 --set 'maps=false' --out runs/without-maps
    """
    need("gatar train", "torch", "safetensors", "numba")
    from gatar_edge.learn.dataset import load_manifest
    from gatar_edge.learn.train import Progress, Trainer, TrainOptions

    if epochs > 0:
        steps = max(1, round(epochs * load_manifest(data)["samples"] / batch))
    options = TrainOptions(
        network, str(data), seed, minutes, steps, batch, rate, threads=threads, settings=_parsed(settings),
    )  # fmt: skip
    trainer = Trainer(options, out)
    with bar("train", "") as show:
        mean = {"loss": 0.0, "exact": 0.0, "weight": 0.0}

        def report(progress: Progress) -> None:
            for name, value in (("loss", progress.loss), ("exact", progress.exact), ("weight", 1.0)):
                mean[name] = 0.98 * mean[name] + 0.02 * value
            loss, exact = (mean[name] / mean["weight"] for name in ("loss", "exact"))
            show(progress.done, f"step {progress.step}, loss {loss:.3f}, exact {exact:.3f}")

        weights = trainer.run(report)
    click.echo(f"{trainer.step} steps: {weights}")


def _parsed(settings: tuple[str, ...]) -> dict[str, Any]:
    parsed: dict[str, Any] = {}
    for text in settings:
        name, _, value = text.partition("=")
        try:
            parsed[name] = json.loads(value)
        except ValueError:
            raise ConfigError(f"--set {text!r} is not NAME=JSON, for example maps=false or width=48") from None
    return parsed
