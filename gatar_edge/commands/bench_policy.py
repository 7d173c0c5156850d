"""`gatar bench policy`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from gatar_edge.commands._options import FiniteRange


@click.command("policy")
@click.option("--model", type=click.Path(path_type=Path, dir_okay=False), help="The shipped one by default.")
@click.option(
    "--robots", multiple=True, type=click.IntRange(1, 64), default=(1, 4, 12, 64), show_default=True,
    help="Robots in the graph; may be given several times.",
)  # fmt: skip
@click.option("--targets", type=click.IntRange(1, 64), default=25, show_default=True, help="Known targets.")
@click.option("--repeats", type=click.IntRange(1, 10_000), default=30, show_default=True, help="For each of 10 scenes.")
@click.option("--seconds", type=FiniteRange(0.2, 600), default=5.0, show_default=True, help="Of the measured process.")
@click.option("--torch/--no-torch", "with_torch", default=True, help="Beside the network in torch, where installed.")
@click.option("--json", "as_json", is_flag=True, help="Print for machines.")
def command(
    model: Path | None, robots: tuple[int, ...], targets: int, repeats: int, seconds: float, with_torch: bool,
    as_json: bool,
) -> None:  # fmt: skip
    """Microseconds of one decision on one core, part by part, and what a whole process costs.

    view: the graph and all path lengths; features: the network's input; policy: onnxruntime; decode: the joint
    assignment; tick: all of it and more, from the bytes that arrived to the command. Each as median and 99th
    percentile of the wall clock and mean CPU time, over several scenes. torch: the same network, not exported.
    Then a fresh process at 5 Hz among 12 robots: seconds to its first decision, memory, share of a core.

    \b
    Example:
      gatar bench policy --json
      gatar bench policy --model runs/other.onnx --robots 12
    """
    from gatar_edge.allocators.gatar import Gatar
    from gatar_edge.policy_speed import eager_network, measure, measure_process

    allocator = Gatar(model)
    process = measure_process(model, 12, targets, seconds, rate_hz=5.0)
    eager = eager_network(allocator.policy) if with_torch else None
    rows = [measure(allocator, count, targets, repeats, eager) for count in robots]
    if as_json:
        click.echo(json.dumps({"model": allocator.policy.path.name, "sizes": rows, "process": process}))
        return
    _print_table(rows)
    click.echo(
        f"process at {process['rate_hz']:g} Hz among {process['robots']} robots: first decision after "
        f"{process['first_decision_s']} s, {process['rss_mb']} MiB, {process['percent_of_core']} % of a core"
    )


def _print_table(rows: list[dict[str, Any]]) -> None:
    from gatar_edge.policy_speed import PARTS

    parts = [part for part in PARTS if part in rows[0]]
    click.echo("microseconds, median / 99th percentile / CPU")
    click.echo("robots" + "".join(f"{part:>26}" for part in parts))
    for row in rows:
        cells = ("{p50_us:.0f} / {p99_us:.0f} / {cpu_us:.0f}".format(**row[part]) for part in parts)
        click.echo(f"{row['robots']:>6}" + "".join(f"{cell:>26}" for cell in cells))
