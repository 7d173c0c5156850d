"""`gatar fleet`: the team, live in a terminal, by listening only."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from gatar_edge.commands._options import FiniteRange
from gatar_edge.errors import ConfigError

if TYPE_CHECKING:
    from rich.table import Table

    from gatar_edge.team_view import TeamRow, TeamView
    from gatar_edge.transports.base import Transport

SILENT_S = 3.0


@click.command("fleet")
@click.option(
    "--config",
    "config_path",
    type=click.Path(path_type=Path, dir_okay=False),
    help="A vehicle.toml of the team: gives key, address and group.",
)
@click.option(
    "--key",
    "key_path",
    type=click.Path(path_type=Path, dir_okay=False),
    help="The team's key.  [default: the configuration's]",
)
@click.option(
    "--listen",
    metavar="HOST:PORT",
    help="Where messages arrive.  [default: the configuration's, or 0.0.0.0:14600]",
)
@click.option("--group", metavar="HOST:PORT", help="Multicast group to hear.  [default: the configuration's, or none]")
@click.option("--seconds", type=FiniteRange(0.1, 1e9), help="End after this long.  [default: never]")
@click.option("--json", "as_json", is_flag=True, help="One JSON object a second instead of a table.")
def command(
    config_path: Path | None,
    key_path: Path | None,
    listen: str | None,
    group: str | None,
    seconds: float | None,
    as_json: bool,
) -> None:
    """Show who is there, where, on what task, how old, over how many hops, and how much is lost. Sends nothing.

    Needs --config or --key. Hears UDP: a multicast group beside the daemons; where robots send to a list of peers, add
    this machine to their lists, and give --listen a port that no daemon on it has.

    \b
    Example:
      gatar fleet --config vehicle.toml
      gatar fleet --key team.key --group 239.255.71.1:14600 --seconds 5 --json
    """
    from gatar_edge.keys import read_key
    from gatar_edge.team_view import TeamView
    from gatar_edge.transports.udp import UdpTransport

    if config_path is not None:
        from gatar_edge.vehicle_config import read_config

        net = read_config(config_path).net
        if net.transport != "udp":
            raise ConfigError(
                f"{config_path}: net.transport is {net.transport!r}, and the fleet is heard over udp only"
            )
        key_path = key_path or Path(net.key_file)
        listen, group = listen or net.listen, group or net.group
    if key_path is None:
        raise ConfigError("give --config vehicle.toml, or --key with the team's key")
    view = TeamView(read_key(key_path))
    transport = UdpTransport(listen or "0.0.0.0:14600", (), group or None)
    with contextlib.closing(transport), contextlib.suppress(KeyboardInterrupt):
        show = _print_json if as_json else _show_table
        show(view, _heard(view, transport, seconds))


def _heard(view: TeamView, transport: Transport, seconds: float | None) -> Iterator[list[TeamRow]]:
    """The team's rows, about once a second."""
    import select

    start_s = shown_s = time.monotonic()
    while seconds is None or time.monotonic() - start_s < seconds:
        select.select([transport.fileno()], [], [], 0.2)
        now_ns = time.monotonic_ns()
        for data in transport.receive():
            view.hear(data, now_ns)
        if time.monotonic() - shown_s >= 1.0:
            shown_s = time.monotonic()
            yield view.rows(now_ns)
    yield view.rows(time.monotonic_ns())


def _print_json(view: TeamView, updates: Iterator[list[TeamRow]]) -> None:
    import msgspec

    for rows in updates:
        report = {"robots": rows, "refused": view.refused, "repeated": view.repeated}
        click.echo(msgspec.json.encode(report).decode())


def _show_table(view: TeamView, updates: Iterator[list[TeamRow]]) -> None:
    from rich.console import Console
    from rich.live import Live

    console = Console()
    if not console.is_terminal:
        for rows in updates:
            console.print(table(rows, view))
        return
    with Live(console=console, auto_refresh=False) as live:
        for rows in updates:
            live.update(table(rows, view), refresh=True)


def table(rows: list[TeamRow], view: TeamView) -> Table:
    """The rows for people."""
    from rich.table import Table

    teams, silent = {row.team for row in rows}, sum(map(_silent, rows))
    title = f"{len(rows)} robot" if len(rows) == 1 else f"{len(rows)} robots"
    if silent:
        title += f", {silent} silent"
    if len(teams) > 1:
        title += f"; {len(teams)} CONFIGURATIONS DIFFER, such robots do not hear each other"
    shown = Table(title=title, caption=f"{view.refused} refused, {view.repeated} repeated datagrams")
    for name in ("robot", "cell", "task", "way", "age", "hops", "loss", "rate", "team"):
        shown.add_column(name, justify="left" if name in {"robot", "task", "team"} else "right")
    for row in rows:
        shown.add_row(
            f"{row.kind} {row.robot_id}",
            _cell(row.cell),
            _task(row),
            f"{row.cost:.0f}" if row.moves and row.task != "HOLD" else "-",
            f"{row.age_s:.1f} s",
            str(row.hops),
            f"{row.loss:.0%}",
            "-" if _silent(row) else f"{row.rate_hz:.1f} Hz",
            row.team,
            style="red" if _silent(row) else None,
        )
    return shown


def _silent(row: TeamRow) -> bool:
    return row.age_s > SILENT_S


def _task(row: TeamRow) -> str:
    if _silent(row):
        return "silent"
    if not row.moves:
        return "stands still"
    return "hold" if row.task == "HOLD" else f"{row.task.lower()} {_cell(row.task_cell)}"


def _cell(cell: tuple[int, int]) -> str:
    return "-" if cell == (-1, -1) else f"{cell[0]},{cell[1]}"
