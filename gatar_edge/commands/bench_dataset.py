"""`gatar bench dataset`."""

from __future__ import annotations

import json

import click

from gatar_edge.commands._learn import need
from gatar_edge.commands._options import FiniteRange


@click.command("dataset")
@click.option("--team", default="6A6G", show_default=True)
@click.option("--size", type=click.IntRange(5, 254), default=15, show_default=True, help="Cells a side of a world.")
@click.option("--r-comm", type=FiniteRange(0, 1000), default=6.0, show_default=True, help="Cells.")
@click.option("--shards", type=click.IntRange(1, 1000), default=3, show_default=True, help="Of 1024 team-steps each.")
@click.option("--json", "as_json", is_flag=True)
def command(team: str, size: int, r_comm: float, shards: int, as_json: bool) -> None:
    """Labelled robot-samples per second of CPU time, one process, compilation not counted.

    \b
    Example:
      gatar bench dataset --team 6A6G
    """
    need("gatar bench dataset", "numba")
    from gatar_edge.learn.dataset import DataOptions
    from gatar_edge.learn.speed import measure

    speed = measure(DataOptions((team,), (size,), (r_comm,), 1, 0).checked(), shards)
    if as_json:
        click.echo(json.dumps(speed.to_json()))
        return
    click.echo(
        f"{team}, {size} x {size}, greedy teacher: {speed.labelled_per_s:,.0f} labelled robot-samples per CPU-second "
        f"({speed.samples_per_s:,.0f} with robots that the teacher gives nothing), "
        f"{speed.bytes_per_sample:.0f} bytes each"
    )
