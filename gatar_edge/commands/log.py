"""`gatar log`: review a mission log."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

LOG = click.argument("log", type=click.Path(path_type=Path), metavar="LOG.mcap")


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
def command() -> None:
    """Review a mission log.

    \b
    Example:
      gatar log info mission.mcap
      gatar log report mission.mcap
      gatar log explain mission.mcap --robot 3 --t 41.2
    """


@command.command()
@LOG
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def info(log: Path, as_json: bool) -> None:
    """Say what a log holds, how the mission went, and whether the recording is sound.

    \b
    Example:
      gatar log info mission.mcap --json
    """
    from gatar_edge.review.info import read_figures
    from gatar_edge.review.reader import LogReader
    from gatar_edge.review.summary import summarize

    reader = LogReader(log)
    figures = read_figures(reader)
    summary = summarize(figures, reader.damage, log.stat().st_size)
    if as_json:
        _print_json(summary)
    else:
        from gatar_edge.review.tables import print_summary

        print_summary(log, summary)


@command.command()
@LOG
@click.option("-o", "--output", type=click.Path(path_type=Path), help="The page; LOG.html beside the log if not given.")
@click.option(
    "--compare", type=click.Path(path_type=Path), metavar="OTHER.mcap", help="Show another mission beside it."
)
def report(log: Path, output: Path | None, compare: Path | None) -> None:
    """Write one HTML page that plays the mission. It needs no network and can be sent to anybody.

    \b
    Example:
      gatar log report mission.mcap -o mission.html
      gatar log report greedy.mcap --compare gatar.mcap
    """
    from gatar_edge.review.report import write_report

    path = write_report(log, output or log.with_suffix(".html"), compare)
    click.echo(f"{path} ({path.stat().st_size / 1e6:.1f} MB): open it in a browser")


def _print_json(value: Any) -> None:
    import json

    click.echo(json.dumps(value, allow_nan=False))
