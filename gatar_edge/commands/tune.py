"""`gatar tune`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from gatar_edge.commands._learn import bar, need
from gatar_edge.commands._options import FiniteRange

if TYPE_CHECKING:
    from gatar_edge.learn.tuning.tuner import Progress, Tuner


@click.command("tune")
@click.argument("run", type=click.Path(path_type=Path, file_okay=False))
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), required=True, help="Goes on if cut off.")
@click.option(
    "--team", "teams", multiple=True, default=("6A6G", "3A3G", "6A6G", "3A3G", "1A1G"), show_default=True,
    help="May be given several times: every round flies them all, one named twice twice as often.",
)  # fmt: skip
@click.option(
    "--size", "sizes", multiple=True, type=int, default=(15,), show_default=True, help="Of worlds, round by round."
)
@click.option(
    "--r-comm",
    "r_comms",
    multiple=True,
    type=FiniteRange(0, 1000),
    default=(6.0,),
    show_default=True,
    help="Drawn per mission.",
)
@click.option(
    "--r-sense",
    "r_senses",
    multiple=True,
    type=FiniteRange(0, 1000),
    default=(4.0,),
    show_default=True,
    help="As --r-comm.",
)
@click.option(
    "--loss",
    "losses",
    multiple=True,
    type=FiniteRange(0, 1),
    default=(0.0,),
    show_default=True,
    help="Of messages; as --r-comm.",
)
@click.option(
    "--kills",
    multiple=True,
    type=click.IntRange(0, 63),
    default=(0,),
    show_default=True,
    help="Robots that die in the first steps, at most half a team; as --r-comm.",
)
@click.option(
    "--show", "shown", multiple=True, type=click.Choice(["tasks", "ages"]),
    help="What the network could not see before: what robots are doing, or how old their news is.",
)  # fmt: skip
@click.option("--minutes", type=FiniteRange(0, 1e6), default=0.0, help="Stop after so long.")
@click.option(
    "--rounds", type=click.IntRange(0, 10**6), default=0, help="Stop after so many rounds; the same weights again."
)
@click.option("--missions", type=click.IntRange(1, 100_000), default=112, show_default=True, help="In each round.")
@click.option("--rate", type=FiniteRange(0, 1), default=5e-4, show_default=True, help="Largest learning rate.")
@click.option("--seed", type=click.IntRange(0, 2**16 - 1), default=0, show_default=True)
@click.option("--threads", type=click.IntRange(1, 256), default=1, show_default=True)
def command(run: Path, out: Path, **options: Any) -> None:
    """Fine-tune a trained network on how long missions take in which it decides.

    RUN is the folder of a finished `gatar train` or `gatar tune`, of a network that looks ahead and reads no window.
    Missions are flown in compiled code, in worlds of the training seeds and at the speeds of data sets; a critic that
    sees everything judges each step. `excess` is the steps that they took, as a ratio to tours by one who knows all. A
    run that was cut off or killed goes on with the round that it was in when the same command is given again.

    Under torchrun every rank flies its share of the missions, and all learn of all of them; rank 0 writes the run
    folder, which all ranks must see.

    \b
    Example:
      gatar tune runs/field --minutes 30 --out runs/tuned
      gatar tune runs/field --team 3A3G --size 15 --size 24 --rounds 60 --threads 1 --out runs/tuned
      torchrun --standalone --nproc-per-node 8 -m gatar_edge tune runs/field --rounds 60 --out runs/tuned
      gatar export runs/tuned -o tuned.onnx
    """
    need("gatar tune", "torch", "safetensors", "numba")
    from gatar_edge.learn.ranks import joined
    from gatar_edge.learn.tuning.tuner import TuneOptions, Tuner

    with joined("cpu") as ranks:
        tuner = Tuner(TuneOptions(str(run), **options, ranks=ranks.count), out, ranks)
        if ranks.rank > 0:
            tuner.run(lambda progress: None)
            return
        weights = _run(tuner)
    click.echo(f"{tuner.step} rounds: {weights}")


def _run(tuner: Tuner) -> Path:
    with bar("tune", "") as show:

        def report(progress: Progress) -> None:
            show(progress.done, f"round {progress.step}, excess {progress.excess:.3f}, change {progress.change:.4f}")

        return tuner.run(report)
