"""`gatar vehicle`: the daemon of one vehicle, on a companion computer beside its autopilot."""

from __future__ import annotations

import logging
import os
from pathlib import Path

import click


@click.command("vehicle")
@click.option(
    "--config",
    "config_path",
    type=click.Path(path_type=Path, dir_okay=False),
    default=Path("vehicle.toml"),
    show_default=True,
    help="What `gatar init` wrote; paths in it are relative to its folder.",
)
@click.option(
    "--check", is_flag=True, help="Validate the configuration without opening a port, say what would be done, and end."
)
@click.option("--dry-run", is_flag=True, help="Shadow mode: hear, decide and log, but send the vehicle no command.")
@click.option("-v", "--verbose", is_flag=True, help="Log debug messages, too.")
def command(config_path: Path, check: bool, dry_run: bool, verbose: bool) -> None:
    """Run the daemon of one vehicle: it hears its autopilot, its perception and its neighbours, decides, and commands.

    Ends on SIGTERM or SIGINT, with the vehicle holding, or as vehicle.on_stop says. SIGUSR1 takes the vehicle back
    after a pilot has taken over. Exit code 2: the configuration cannot be used, or a port or device is not to be had.
    What happens when something fails in flight is told in docs/failsafe.md.

    \b
    Example:
      gatar init --id 3 --kind UAV --origin 47.397742,8.545594 --url udpin:127.0.0.1:14551
      gatar vehicle --config vehicle.toml --check
      gatar vehicle --config vehicle.toml --dry-run
    """
    import time

    from gatar_edge.preflight import anchored_clock, describe, prepare
    from gatar_edge.vehicle_config import read_config

    prepared = prepare(read_config(config_path), time.time_ns())
    if check:
        for line in describe(prepared, dry_run=dry_run):
            click.echo(line)
        click.echo(f"{config_path} is good")
        return
    from gatar_edge.run_vehicle import Orders, listening_to_signals, opened, serve

    _log_to_stderr(verbose)
    orders = Orders()
    with (
        opened(prepared, anchored_clock(), dry_run=dry_run) as process,
        listening_to_signals(orders, process.waiter),
    ):
        serve(process, orders)


def _log_to_stderr(verbose: bool) -> None:
    """Lines with a time on a terminal, with a priority for journald, which has its own clock."""
    under_systemd = "JOURNAL_STREAM" in os.environ
    handler = logging.StreamHandler()
    handler.setFormatter(_Priority() if under_systemd else logging.Formatter("%(asctime)s %(levelname)-7s %(message)s"))
    logging.basicConfig(level=logging.DEBUG if verbose else logging.INFO, handlers=[handler])


class _Priority(logging.Formatter):
    """The prefix of sd-daemon(3): <3> error, <4> warning, <6> information, <7> debug."""

    def format(self, record: logging.LogRecord) -> str:
        priority = {logging.ERROR: 3, logging.WARNING: 4, logging.INFO: 6}.get(record.levelno, 7)
        return f"<{priority}>{record.getMessage()}"
