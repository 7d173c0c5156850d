"""`gatar eval missions`."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from gatar_edge.commands._options import FiniteRange

if TYPE_CHECKING:
    from gatar_edge.campaign import Campaign, Figures, Flight

REFERENCE = "greedy"
DEFAULT = "gatar,greedy,hungarian,cbba,central-greedy"
LINE_EVERY_S = 10.0


@click.command("missions")
@click.option(
    "--allocators", default=DEFAULT, show_default=True, help="Names with commas between; gatar:MODEL.onnx too."
)
@click.option("--team", default="6A6G", show_default=True, help="Aerial and ground robots.")
@click.option("--missions", type=click.IntRange(1, 100_000), default=100, show_default=True)
@click.option("--seed", type=click.IntRange(0, None), default=9000, show_default=True, help="Of the first mission.")
@click.option("--size", type=int, default=15, show_default=True, help="Cells a side of a random world.")
@click.option("--targets", type=int, help="In each world.  [default: 20 to 30 by the seed; 40 on a map]")
@click.option(
    "--map", "map_file", type=click.Path(dir_okay=False), default="", help="City map (.map) to cut worlds from."
)
@click.option("--window", type=int, default=48, show_default=True, help="Cells a side of a world cut from --map.")
@click.option("--r-sense", type=FiniteRange(0, 100), default=4.0, show_default=True, help="Cells.")
@click.option("--r-comm", type=FiniteRange(0, 10_000), default=6.0, show_default=True, help="Cells.")
@click.option("--loss", type=FiniteRange(0, 1), default=0.0, show_default=True, help="Share of messages lost.")
@click.option("--delay-ticks", type=click.IntRange(0, 100), default=0, show_default=True, help="Of every message.")
@click.option("--kills", type=click.IntRange(0, 63), default=0, show_default=True, help="Robots lost on the way.")
@click.option(
    "--follow",
    is_flag=True,
    help="Follow the allocator at every tick; else tasks are kept, as on vehicles. No effect on the field model, which "
    "weighs what robots are doing itself.",
)
@click.option("--max-steps", type=click.IntRange(1, 100_000), default=500, show_default=True)
@click.option(
    "--workers", type=click.IntRange(1, 256), default=1, show_default=True, help="Processes; changes no figure."
)
@click.option("--results", type=click.Path(path_type=Path, dir_okay=False), help="JSON lines to add to and go on from.")
@click.option("--json", "as_json", is_flag=True, help="For machines, on standard output.")
def command(
    allocators: str,
    targets: int | None,
    map_file: str,
    workers: int,
    results: Path | None,
    as_json: bool,
    **conditions: Any,
) -> None:
    """Fly the same missions with every allocator, and compare steps and times.

    Intervals hold 95 % by bootstrap over missions; `ratio_to_greedy` compares steps to 100 % mission by mission. Seeds
    below 1000000 are for tests, the next million is for choosing settings. A file of --results belongs to one version
    of the program and its models.

    \b
    Examples:
      gatar eval missions --team 3A3G --missions 300 --seed 9000 --workers 4
      gatar eval missions --allocators greedy,routing --map Paris_0_256.map --window 48 --targets 40 --json
      gatar eval missions --loss 0.3 --delay-ticks 1 --results lossy.jsonl
    """
    from gatar_edge.campaign import Campaign, fly_all

    if map_file and targets is None:
        targets = 40
    campaign = Campaign(targets=targets, map_file=map_file, **conditions)
    names = tuple(dict.fromkeys(name.strip() for name in allocators.split(",") if name.strip()))
    flights = flights_of(campaign, names)
    with _progress(len(flights), quiet=as_json) as progress:
        figures = fly_all(flights, workers, results, progress)
    summary = summarize(names, figures)
    click.echo(json.dumps(summary, indent=1) if as_json else table(campaign, summary))


def flights_of(campaign: Campaign, names: Sequence[str]) -> list[Flight]:
    """All flights, mission by mission. Raises for bad names, models and worlds before anything flies."""
    from gatar_edge.allocators.registry import make
    from gatar_edge.campaign import Flight, deaths_of, world_of
    from gatar_edge.errors import ConfigError

    if not names:
        raise ConfigError("no allocator to fly with: --allocators greedy,hungarian")
    for name in names:
        make(name)
    world_of(campaign, campaign.seed)
    deaths_of(campaign, campaign.seed)
    return [Flight(campaign, name, seed) for seed in campaign.seeds for name in names]


def summarize(names: Sequence[str], figures: dict[Flight, Figures]) -> dict[str, dict[str, Any]]:
    """Per allocator: means with intervals over missions, and the ratio to greedy where that flew too, else null."""
    import numpy as np

    from gatar_edge.learn.statistics import mean_interval, ratio_interval

    def values(name: str, field: str) -> Any:
        return np.array([getattr(flown, field) for flight, flown in figures.items() if flight.allocator == name], float)

    summary: dict[str, dict[str, Any]] = {}
    for name in names:
        steps = values(name, "steps_100")
        summary[name] = {
            field: mean_interval(values(name, field)).to_json()
            for field in ("steps_100", "steps_90", "steps_50", "mean_time")
        } | {
            "localized": round(float(values(name, "localized").mean()), 4),
            "ratio_to_greedy": ratio_interval(steps, values(REFERENCE, "steps_100")).to_json()
            if REFERENCE in names
            else None,
            "missions": len(steps),
            **{
                field: round(float(values(name, field).mean()), 2)
                for field in ("retasks", "duplicates", "bytes_per_robot_step", "fallbacks")
            },
        }
    return summary


def table(campaign: Campaign, summary: dict[str, dict[str, Any]]) -> str:
    """The summary for people."""
    place = f"{campaign.window}-cell windows of {campaign.map_file}" if campaign.map_file else f"size {campaign.size}"
    name_width = max(20, *(len(name) + 2 for name in summary))
    lines = [
        f"{campaign.missions} missions of {campaign.team}, seeds {campaign.seed}.., {place}",
        f"r_sense {campaign.r_sense:g}, r_comm {campaign.r_comm:g}, loss {campaign.loss:g}, "
        f"delay {campaign.delay_ticks}, kills {campaign.kills}, tasks "
        f"{'follow the allocator' if campaign.follow else 'kept'}; 95 % intervals",
        f"{'allocator':<{name_width}}{'steps to 100 %':<26}{'to 90 %':<26}{'mean time':<26}{'localized':<11}"
        "against greedy",
    ]
    for name, row in summary.items():
        columns = (row["steps_100"], row["steps_90"], row["mean_time"])
        spans = [f"{span['mean']:.2f} [{span['lo']:.2f}, {span['hi']:.2f}]" for span in columns]
        ratio = row["ratio_to_greedy"]
        against = f"{ratio['mean']:.3f} [{ratio['lo']:.3f}, {ratio['hi']:.3f}]" if ratio else "-"
        told = "".join(f"{span:<26}" for span in spans)
        lines.append(f"{name:<{name_width}}{told}{row['localized']:<11.1%}{against}")
    return "\n".join(lines)


@contextmanager
def _progress(total: int, *, quiet: bool) -> Iterator[Callable[[int], None]]:
    """A bar with the time left on a terminal, a line every ten seconds elsewhere; nothing on standard output."""
    if quiet and not sys.stderr.isatty():
        yield lambda done: None
    elif sys.stderr.isatty():
        from rich.console import Console
        from rich.progress import Progress

        with Progress(console=Console(stderr=True)) as bar:
            task = bar.add_task("missions", total=total)
            yield lambda done: bar.update(task, completed=done)
    else:
        yield _lines(total)


def _lines(total: int) -> Callable[[int], None]:
    started = last = time.monotonic()
    first: int | None = None

    def show(done: int) -> None:
        nonlocal first, last
        now = time.monotonic()
        if first is None:
            first = done  # found in the file of results
        if now - last >= LINE_EVERY_S and done > first:
            last = now
            left_s = (now - started) / (done - first) * (total - done)
            click.echo(f"missions: {done} of {total} flights, {left_s:.0f} s left", err=True)

    return show
