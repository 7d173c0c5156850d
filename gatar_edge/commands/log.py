"""`gatar log`: review a mission log."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from gatar_edge.commands._options import FiniteRange

FILE = click.Path(path_type=Path, dir_okay=False)
LOG = click.argument("log", type=FILE, metavar="LOG.mcap")
AS_JSON = click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")


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
@AS_JSON
def info(log: Path, as_json: bool) -> None:
    """Say what a log holds, how the mission went, and whether the recording is sound.

    \b
    Example:
      gatar log info mission.mcap --json
    """
    from gatar_edge.review.info import read_figures
    from gatar_edge.review.reader import LogReader
    from gatar_edge.review.summary import summarize
    from gatar_edge.review.tables import print_summary

    reader = LogReader(log)
    figures = read_figures(reader)
    summary = summarize(figures, reader.damage, log.stat().st_size)
    if as_json:
        _print_json(summary)
    else:
        print_summary(log, summary)


@command.command()
@LOG
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path, dir_okay=False),
    help="The page; LOG.html beside the log if not given.",
)
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


@command.command()
@LOG
@click.option("--robot", type=int, required=True, help="Number of the robot.")
@click.option(
    "--t", "t_s", type=FiniteRange(-1e9, 1e9), required=True, help="Seconds since the mission's first decision."
)
@AS_JSON
def explain(log: Path, robot: int, t_s: float, as_json: bool) -> None:
    """Say why a robot did what it did: what it knew, whom it heard, the candidates, and why this one.

    \b
    Example:
      gatar log explain mission.mcap --robot 3 --t 41.2
    """
    from gatar_edge.review.explain import words
    from gatar_edge.review.moment import explain_at
    from gatar_edge.review.reader import LogReader

    explanation = explain_at(LogReader(log), robot, t_s)
    if as_json:
        _print_json(explanation)
        return
    click.echo(f"At {explanation['t_s']:.1f} s (tick {explanation['tick']}):")
    click.echo("\n".join(words(explanation)))
    if explanation["since"] is not None:
        click.echo(f"\nIt took this task at {explanation['since']['t_s']:.1f} s (tick {explanation['since']['tick']}):")
        click.echo("\n".join(words(explanation["since"])))


@command.command()
@LOG
@click.option("--allocator", help="Ask another allocator what it would have done at each recorded moment.")
@click.option("--model", type=click.Path(path_type=Path), help="Ask another model; or name the one that flew.")
@click.option("--key", type=click.Path(path_type=Path), help="The team's key: verify signatures, too.")
@AS_JSON
@click.pass_context
def replay(
    ctx: click.Context, log: Path, allocator: str | None, model: Path | None, key: Path | None, as_json: bool
) -> None:
    """Run the same agents on the recorded inputs: do they decide the same? Exit code 1 where they do not.

    \b
    Example:
      gatar log replay mission.mcap
      gatar log replay mission.mcap --allocator greedy
    """
    from gatar_edge.keys import read_key
    from gatar_edge.review.models import allocator_for
    from gatar_edge.review.reader import LogReader
    from gatar_edge.review.replay import Replay

    reader = LogReader(log)
    make, otherwise = allocator_for(reader.run_info(), allocator, model)
    result = Replay(make, otherwise=otherwise, key=None if key is None else read_key(key)).run(reader)
    if as_json:
        _print_json(result.to_json())
    else:
        from gatar_edge.review.tables import replay_lines

        click.echo("\n".join(replay_lines(result.to_json(), allocator or (str(model) if otherwise else ""))))
    if not (result.same or otherwise):
        ctx.exit(1)


@command.command()
@LOG
@click.option("-o", "--output", type=FILE, help="LOG.recovered.mcap if not given.")
@AS_JSON
def recover(log: Path, output: Path | None, as_json: bool) -> None:
    """Save what can be read of a damaged or unfinished log into a complete one, and say what was lost.

    \b
    Example:
      gatar log recover crashed.mcap -o saved.mcap
    """
    from gatar_edge.review.recover import recover as save

    target = output or log.with_suffix(".recovered.mcap")
    result = save(log, target).to_json()
    if as_json:
        _print_json(result)
        return
    click.echo(f"{target}: {result['recovered']} messages of {result['duration_s']:.1f} s")
    for place in result["damage"]:
        click.echo(f"damage at byte {place['byte']}: {place['why']}")
    click.echo(f"lost at most {result['lost_s']:.1f} s" if result["lost_s"] else "nothing was lost")


@command.command()
@click.argument("logs", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="LOG.mcap...")
@click.option("-o", "--output", type=FILE, required=True, help="The merged log.")
@AS_JSON
def merge(logs: tuple[Path, ...], output: Path, as_json: bool) -> None:
    """Put the logs of several robots on one time line. Clock offsets come from the messages that they heard.

    \b
    Example:
      gatar log merge uav1.mcap uav2.mcap ugv3.mcap -o team.mcap
    """
    from gatar_edge.review.merge import merge as join

    result = join(logs, output).to_json()
    if as_json:
        _print_json(result)
        return
    click.echo(f"{output}: {result['messages']} messages")
    for name, offset_s in result["offsets_s"].items():
        unplaced = " (heard nobody both ways: taken as it is)" if name in result["unplaced"] else ""
        click.echo(f"{name}: {offset_s:+.6f} s{unplaced}")


@command.command()
@LOG
@click.option("--csv", "csv_folder", type=click.Path(path_type=Path), help="Write tables into this folder.")
@click.option("--tlog", "tlog_folder", type=click.Path(path_type=Path), help="Write one MAVLink .tlog a robot.")
def export(log: Path, csv_folder: Path | None, tlog_folder: Path | None) -> None:
    """Write a log as tables, or its MAVLink frames as telemetry logs.

    \b
    Example:
      gatar log export mission.mcap --csv tables/ --tlog telemetry/
    """
    from gatar_edge.errors import ConfigError
    from gatar_edge.review.export import export_csv, export_tlog
    from gatar_edge.review.reader import LogReader

    if csv_folder is None and tlog_folder is None:
        raise ConfigError("nothing to export: give --csv FOLDER, --tlog FOLDER or both")
    reader = LogReader(log)
    for folder, write in ((csv_folder, export_csv), (tlog_folder, export_tlog)):
        if folder is not None:
            for name, count in write(reader, folder).items():
                click.echo(f"{folder / name}: {count}")


@command.command()
@LOG
@click.option(
    "--from",
    "from_s",
    type=FiniteRange(0, 1e9),
    default=0.0,
    show_default=True,
    help="Seconds since the first decision.",
)
@click.option("--drop-robot", "drop", type=int, multiple=True, help="Number of a robot to leave out; may be repeated.")
@click.option("--r-comm", type=FiniteRange(0, 1e6), help="Another range of the radio, in cells.")
@click.option("--allocator", help="Another allocator.")
@AS_JSON
def whatif(
    log: Path, from_s: float, drop: tuple[int, ...], r_comm: float | None, allocator: str | None, as_json: bool
) -> None:
    """Go on from a moment of a simulated mission, as it was and changed, and compare the two.

    \b
    Example:
      gatar log whatif mission.mcap --from 30 --drop-robot 4 --r-comm 3
    """
    from gatar_edge.allocators.registry import make
    from gatar_edge.review.models import allocator_for
    from gatar_edge.review.reader import LogReader
    from gatar_edge.review.tables import print_comparison
    from gatar_edge.review.whatif import Change, what_if

    reader = LogReader(log)
    flown, _ = allocator_for(reader.run_info(), None, None)
    change = Change(from_s, drop, r_comm, None if allocator is None else make(allocator))
    result = what_if(reader, flown, change)
    if as_json:
        _print_json(result)
    else:
        print_comparison(result)


@command.command()
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--port", type=click.IntRange(0, 65535), default=8765, show_default=True, help="0 takes a free one.")
@click.option("--host", default="127.0.0.1", show_default=True, help="0.0.0.0 lets others on the network look.")
def serve(folder: Path, port: int, host: str) -> None:
    """Show the runs of a folder in the browser; a mission that is being recorded is shown live.

    \b
    Example:
      gatar log serve runs/
    """
    from gatar_edge.review.serve import open_server

    server = open_server(folder, host, port)
    click.echo(f"http://{host}:{server.server_port}/ shows {folder}; ctrl-c ends")
    try:
        server.serve_forever()
    except KeyboardInterrupt:
        click.echo("stopped")
    finally:
        server.server_close()


def _print_json(value: Any) -> None:
    import json

    click.echo(json.dumps(value, allow_nan=False))
