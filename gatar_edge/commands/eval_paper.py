"""`gatar eval paper`."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from gatar_edge.commands._learn import bar, need
from gatar_edge.commands._options import FiniteRange
from gatar_edge.errors import ConfigError

FOLDER = click.Path(path_type=Path, file_okay=False)


@click.command("paper")
@click.option("--out", type=FOLDER, default=Path("docs/results"), show_default=True, help="Tables, pictures, page.")
@click.option("--runs", type=FOLDER, help="Trained networks.  [default: runs/paper; runs/paper-quick with --quick]")
@click.option("--data", type=FOLDER, help="Data set to train on.  [default: made under --runs]")
@click.option("--maps", type=click.Path(path_type=Path, file_okay=False, exists=True), help="Folder of *.map files.")
@click.option(
    "--minutes-per-network",
    "minutes",
    type=FiniteRange(0, min_open=True),
    help="Equal time in place of equal steps.",
)
@click.option("--steps", type=click.IntRange(1), help="Of training each network.  [default: 2500]")
@click.option("--missions", type=click.IntRange(1, 100_000), help="Of each allocator and team.  [default: 100]")
@click.option("--quick", is_flag=True, help="Everything small, in under three minutes: the numbers mean nothing.")
@click.option(
    "--workers",
    type=click.IntRange(1, 256),
    default=1,
    show_default=True,
    help="Processes: networks are trained, and missions flown, so many at a time.",
)
@click.option(
    "--device", type=click.Choice(["auto", "cpu", "cuda"]), default="auto", show_default=True,
    help="That trains. auto: the GPU where there is one.",
)  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="All tables on standard output.")
def command(
    out: Path, runs: Path | None, data: Path | None, maps: Path | None, minutes: float | None, steps: int | None,
    missions: int | None, quick: bool, workers: int, device: str, as_json: bool,
) -> None:  # fmt: skip
    """Reproduce the paper: train its networks at equal budget, and make its tables and figures beside its numbers.

    Networks, data and missions under --runs are kept: a call that was cut off goes on, and finished runs are not
    trained again.

    \b
    Examples:
      gatar eval paper --out docs/results --maps maps/ --workers 2
      gatar eval paper --quick --out /tmp/paper
    """
    need("gatar eval paper", "torch", "safetensors", "numba", "matplotlib", "onnx", "onnxscript", extra="export")
    from gatar_edge.learn.ranks import device_of
    from gatar_edge.paper.plan import QUICK, Scale
    from gatar_edge.paper.reproduce import PAGE, Places, reproduce

    if minutes and steps:
        raise ConfigError("give either --minutes-per-network or --steps")
    scale = QUICK if quick else Scale()
    if minutes or steps:
        scale = replace(scale, minutes=minutes or 0.0, steps=steps or 0)
    if missions:
        scale = replace(scale, missions=missions, curve_missions=max(1, missions // 2))
    places = Places(out, runs or Path("runs/paper-quick" if quick else "runs/paper"), data, maps)
    with bar("paper", "") as show:
        told = _told(out, data, maps, minutes, steps, missions, quick, device_of(device))
        results = reproduce(places, scale, workers, show, told, device)
    if as_json:
        click.echo(json.dumps(_tables(results), indent=1))
    else:
        click.echo(f"{out / PAGE}")


def _told(
    out: Path, data: Path | None, maps: Path | None, minutes: float | None, steps: int | None, missions: int | None,
    quick: bool, trains: str,
) -> str:  # fmt: skip
    """The command as the page shows it: what decides the numbers, without paths of this machine."""
    places = (("--out", out), ("--data", data), ("--maps", maps))
    options = [f"{name} {path.name if path.is_absolute() else path}" for name, path in places if path]
    options += ["--quick"] * quick
    options += [f"--minutes-per-network {minutes:g}"] if minutes else []
    options += [f"--steps {steps}"] if steps else []
    options += [f"--missions {missions}"] if missions else []
    options += ["--device cuda"] if trains != "cpu" else []  # sums come out a little different there
    return " ".join(["gatar eval paper", *options])


def _tables(results: Any) -> dict[str, Any]:
    judged, flown = results.judged, results.flown
    tables = [judged.table_2, judged.table_3, judged.ranges, judged.teams]
    tables += [flown.comparison, flown.loss, flown.delay, flown.kills, *([results.city] if results.city else [])]
    return {table.name: [dict(zip(table.columns, row, strict=True)) for row in table.rows] for table in tables}
