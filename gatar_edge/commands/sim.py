"""`gatar sim`: a seeded mission with simulated autopilots, in virtual or real time."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from gatar_edge.commands._options import FiniteRange
from gatar_edge.commands._sim import fleet_config, open_fleet, progress
from gatar_edge.errors import ConfigError

if TYPE_CHECKING:
    from gatar_edge.sim_sitl.fleet_config import FleetConfig
    from gatar_edge.sim_sitl.tally import Result

STACKS = ("ardupilot", "px4", "mixed")
LIVE = ("listen", "speed_factor", "daemons", "base_port")  # options of --realtime


@click.command("sim")
@click.option("--team", default="3A3G", show_default=True, help="Aerial and ground robots, such as 3A3G.")
@click.option("--targets", type=click.IntRange(1, 10_000), help="Number of targets.  [default: 20 to 30, by the seed]")
@click.option("--size", type=click.IntRange(5, 256), default=15, show_default=True, help="Cells a side of the world.")
@click.option("--seed", type=click.IntRange(0), default=1, show_default=True, help="World, radio and autopilots.")
@click.option("--r-sense", type=FiniteRange(1, 64), default=4.0, show_default=True, help="Sight, in cells.")
@click.option("--r-comm", type=FiniteRange(0, 1e6), default=6.0, show_default=True, help="Radio range, in cells.")
@click.option("--allocator", default="gatar", show_default=True, help="gatar, gatar:FILE.onnx, nearest, greedy, ...")
@click.option("--stack", type=click.Choice(STACKS), default="ardupilot", show_default=True, help="Autopilot family.")
@click.option("--loss", type=FiniteRange(0, 0.95), default=0.0, help="Share of lost messages between robots.")
@click.option("--telemetry-loss", type=FiniteRange(0, 0.9), default=0.0, help="The same, robot to autopilot.")
@click.option("--faults", "faults_file", type=click.Path(path_type=Path, dir_okay=False), help="TOML: what goes wrong.")
@click.option("--max-steps", type=click.IntRange(1, 100_000), default=500, show_default=True, help="Give up after.")
@click.option(
    "--log", "log_path", type=click.Path(path_type=Path, dir_okay=False), help="Write an MCAP of the mission."
)
@click.option(
    "--out", type=click.Path(path_type=Path, file_okay=False), help="Folder for mission.mcap and report.html together."
)
@click.option("--realtime", is_flag=True, help="By the wall clock, with the vehicles on UDP for real clients.")
@click.option("--listen", default="udp:127.0.0.1:14550", show_default=True, help="With --realtime: the vehicles.")
@click.option("--speed-factor", type=FiniteRange(0.1, 100), default=1.0, show_default=True, help="With --realtime.")
@click.option(
    "--daemons",
    type=click.Path(path_type=Path, file_okay=False),
    help="With --realtime: leave the minds to `gatar vehicle` processes, and write their configurations here.",
)
@click.option(
    "--base-port",
    type=click.IntRange(1024, 65_000),
    default=14600,
    show_default=True,
    help="With --daemons: they use this UDP port and the 200 above it.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the result for machines.")
@click.pass_context
def command(context: click.Context, /, as_json: bool, log_path: Path | None, out: Path | None, **options: Any) -> None:
    """Fly a mission: every robot with its own mind, radio, bridge and simulated autopilot.

    Virtual time runs as fast as the machine can; the same seed gives the same decisions (see the digest).
    A step is the time in which a robot at cruise speed crosses one cell.

    \b
    Example:
      gatar sim --team 3A3G --targets 24 --size 15 --seed 1 --allocator gatar --log mission.mcap
      gatar sim --seed 1 --allocator greedy --json
      gatar sim --stack mixed --allocator greedy --faults examples/faults.toml
      gatar sim --realtime --listen udp:127.0.0.1:14550        # watch it from a ground station
      gatar sim --realtime --daemons runs/team                 # then: gatar vehicle --config runs/team/robot1.toml ...
    """
    if out is not None and log_path is not None:
        raise ConfigError("--log and --out exclude each other: --out already writes mission.mcap into its folder")
    live = {name: options.pop(name) for name in LIVE}
    realtime = options.pop("realtime")
    for name in LIVE:
        if not realtime and context.get_parameter_source(name) is ParameterSource.COMMANDLINE:
            raise ConfigError(f"--{name.replace('_', '-')} needs --realtime: it means nothing in virtual time")
    if live["daemons"] is not None and (log_path or out):
        raise ConfigError(f"--daemons excludes --log and --out: each daemon writes its log into {live['daemons']}/logs")
    if out is not None:
        log_path = _made(out) / "mission.mcap"
    allocator = options.pop("allocator")
    config = fleet_config(**options)
    if realtime:
        from gatar_edge.commands.sim_realtime import fly_live

        result = fly_live(config, allocator, log_path, quiet=as_json, **live)
    else:
        result = fly(config, allocator, log_path, quiet=as_json)
    report = _write_report(log_path) if out is not None and log_path is not None else None
    if as_json:
        click.echo(json.dumps(result.to_json()))
        return
    print_table(result)
    if log_path is not None:
        click.echo(f"\nlog     {log_path}")
    if (folder := live["daemons"]) is not None:
        click.echo(f"\nNext: end the daemons, then\n  gatar log merge {folder}/logs/*.mcap -o {folder}/merged.mcap")
    if report is not None:
        click.echo(f"report  {report}\n\nNext: open the report in a browser, or run\n  gatar log info {log_path}")


def fly(config: FleetConfig, allocator: str, log_path: Path | None, *, quiet: bool) -> Result:
    """Fly the mission in virtual time, with progress, into a log where one is wanted."""
    from gatar_edge.sim_sitl.fleet import lock_step

    with open_fleet(config, allocator, log_path) as fleet:
        with progress(fleet, quiet) as update:
            for _ in lock_step(fleet):
                update()
        return replace(fleet.result(), allocator=allocator)  # as it was asked for: a bound is not its rule


def print_table(result: Result) -> None:
    """The result for people."""
    figures = result.to_json()

    def show(value: Any) -> str:
        return "not reached" if value is None else f"{value:g}" if isinstance(value, float) else str(value)

    by_step = figures["localized_by"]
    rows = [
        ("team, seed, allocator", f"{result.team}, {result.seed}, {result.allocator}"),
        ("targets localized", f"{result.localized} of {result.reachable} reachable ({result.targets} in all)"),
        ("  by step 10 / 20 / 40", " / ".join(str(by_step[step]) for step in ("10", "20", "40"))),
        ("steps to 90 % / 100 %", f"{show(figures['steps_90'])} / {show(figures['steps_100'])}"),
        ("cells travelled, UAV / UGV", " / ".join(f"{figures['distance_cells'][kind]:g}" for kind in ("UAV", "UGV"))),
        ("messages, bytes a robot", f"{figures['messages_per_robot']:g}, {figures['bytes_per_robot']:g}"),
    ]
    if result.decision_ns:  # daemons decide out of sight: their logs and `gatar fleet` tell
        rows += [
            ("retasks", str(result.retasks)),
            ("decision p50 / p99", f"{figures['decision_p50_us']:g} / {figures['decision_p99_us']:g} us"),
            ("fallbacks", str(result.fallbacks)),
        ]
    width = max(len(name) for name, _ in rows)
    for name, value in rows:
        click.echo(f"{name:<{width}}  {value}")


def _made(folder: Path) -> Path:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"{folder} cannot be made: {error.strerror}") from error
    return folder


def _write_report(log_path: Path) -> Path:
    from gatar_edge.review.report import write_report

    report = log_path.with_name("report.html")
    write_report(log_path, report)
    return report
