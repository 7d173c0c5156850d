"""`gatar doctor`: is this vehicle set up right, and what would it do without its companion?"""

from __future__ import annotations

from pathlib import Path

import click

from gatar_edge.commands._options import FiniteRange

COLORS = {"OK": "green", "WARN": "yellow", "FAIL": "red"}


@click.command("doctor")
@click.option(
    "--vehicle",
    "url",
    metavar="URL",
    help="udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT or serial:DEVICE[:BAUD].  [default: the configuration's]",
)
@click.option("--sysid", type=click.IntRange(1, 255), help="MAVLink system of the vehicle, where several are heard.")
@click.option(
    "--config",
    "config_path",
    type=click.Path(path_type=Path, dir_okay=False),
    help="The vehicle.toml of its daemon: gives link and system, and adds checks of grid, fence and altitude.",
)
@click.option(
    "--timeout-s",
    type=FiniteRange(1, 600),
    default=15.0,
    show_default=True,
    help="End after this long with what was heard; a vehicle that answers takes 8 to 10.",
)
@click.option("--json", "as_json", is_flag=True, help="Print for machines.")
@click.pass_context
def command(
    context: click.Context,
    url: str | None,
    sysid: int | None,
    config_path: Path | None,
    timeout_s: float,
    as_json: bool,
) -> None:
    """Check a vehicle before its mission: OK, WARN or FAIL, each with one sentence and how to mend it.

    Needs --vehicle or --config. Asks for messages and parameters only: nothing is armed, moved or set. Run it while
    the daemon is not running: it reads the same link.
    Exit code 0: no FAIL; 1: a FAIL; 2: no link, or options that cannot be.

    \b
    Example:
      gatar doctor --vehicle udpin:0.0.0.0:14550
      gatar doctor --config vehicle.toml --json
    """
    import json
    import secrets

    from gatar_edge.bridge.doctor import examine
    from gatar_edge.bridge.survey import Survey
    from gatar_edge.commands._guest import call_on, target
    from gatar_edge.preflight import anchored_clock

    url, sysid, plan = target(url, sysid, config_path)
    clock_ns = anchored_clock()
    shared = not url.startswith("serial:")
    survey = Survey(sysid, clock_ns(), plan=plan, shared_link=shared, seed=secrets.randbits(32))
    call_on(url, survey, timeout_s, clock_ns)
    report = examine(survey.facts(clock_ns()))
    if as_json:
        click.echo(json.dumps({"vehicle": url, "good": report.good, "checks": report.as_list()}, indent=2))
    else:
        for name, finding in report.findings.items():
            click.echo(f"{click.style(f'{finding.level:4}', fg=COLORS[finding.level])}  {name:14}  {finding.text}")
            if finding.mend:
                click.echo(f"{'':22}-> {finding.mend}")
    context.exit(0 if report.good else 1)
