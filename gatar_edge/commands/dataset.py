"""`gatar dataset`."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from pathlib import Path

import click

from gatar_edge.commands._learn import Show, bar, need

RECENT = 16  # shards by which the rate is told


@click.command("dataset")
@click.option(
    "--team", "teams", multiple=True, default=("6A6G",), show_default=True, help="May be given several times."
)
@click.option(
    "--size", "sizes", multiple=True, type=int, default=(15,), show_default=True, help="Cells a side of a world."
)
@click.option(
    "--r-comm", "r_comms", multiple=True, type=float, default=(6.0,), show_default=True, help="Drawn per episode."
)
@click.option(
    "--r-sense", "r_senses", multiple=True, type=float, default=(4.0,), show_default=True, help="As --r-comm."
)
@click.option(
    "--loss", "losses", multiple=True, type=float, default=(0.0,), show_default=True, help="Of messages; as --r-comm."
)
@click.option(
    "--teacher", type=click.Choice(["greedy", "routing", "foresight"]), default="greedy", show_default=True,
    help="greedy: the paper's central expert; routing: whole tours on each robot's view; foresight: tours over what "
    "the unknown may hide, too, and frontiers among the candidates.",
)  # fmt: skip
@click.option("--samples", type=int, default=1_500_000, show_default=True, help="Robot-steps, at least.")
@click.option("--seed", type=int, default=0, show_default=True)
@click.option(
    "--workers", type=click.IntRange(1, 256), default=1, show_default=True, help="Processes; changes nothing else."
)
@click.option(
    "--scheduler", default="", metavar="tcp://HOST:PORT", help="Of a Dask cluster whose workers make the data."
)
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), required=True)
def command(
    teams: tuple[str, ...],
    sizes: tuple[int, ...],
    r_comms: tuple[float, ...],
    r_senses: tuple[float, ...],
    losses: tuple[float, ...],
    teacher: str,
    samples: int,
    seed: int,
    workers: int,
    scheduler: str,
    out: Path,
) -> None:
    """Make training data: episodes labelled by a teacher.

    Goes on where an earlier call with the same options was cut off. Worlds come from the training seeds only.

    \b
    Example:
      gatar dataset --team 6A6G --team 3A3G --r-comm 6 --r-comm 3 --samples 300000 --out data/greedy
      gatar dataset --teacher foresight --team 3A3G --size 15 --size 24 --samples 100000 --out data/field
      gatar dataset --samples 1500000 --scheduler tcp://10.0.0.1:8786 --out data/greedy
    """
    need("gatar dataset", "numba")
    if scheduler:
        need("gatar dataset --scheduler", "distributed", extra="cluster")
    from gatar_edge.learn.dataset import DataOptions, generate

    options = DataOptions(teams, sizes, r_comms, samples, seed, r_senses, teacher=teacher, losses=losses)
    with bar("dataset", "") as show:
        manifest = generate(options, out, workers, _with_rate(show), scheduler)
    click.echo(f"{manifest['samples']:,} robot-steps in {len(manifest['shards'])} shards: {out}")


def _with_rate(show: Show) -> Callable[[int, int], None]:
    """Robot-steps done of all, told with how many a second the last shards gave."""
    recent = deque([(time.monotonic(), 0)], maxlen=RECENT)

    def progress(done: int, of: int) -> None:
        recent.append((time.monotonic(), done))
        (then, before), (now, _) = recent[0], recent[-1]
        rate = (done - before) / max(now - then, 1e-3)
        show(done / of, f"{done:,} robot-steps, {rate:,.0f} a second")

    return progress
