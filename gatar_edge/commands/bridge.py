"""`gatar bridge`: look after what is on board of one vehicle."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import click

from gatar_edge.commands._options import FiniteRange
from gatar_edge.errors import ConfigError

if TYPE_CHECKING:
    from gatar_edge.bridge.errands import MissionErrand
    from gatar_edge.bridge.mission_items import Items
    from gatar_edge.bridge.settings import DriverConfig
    from gatar_edge.bridge.visit import Visit
    from gatar_edge.types import Cell

MAX_CELLS_BYTES = 100_000
ALTITUDE_M = (-500.0, 9000.0)


@click.group("bridge")
def command() -> None:
    """Look after what is on board of one vehicle, while its daemon is not running.

    \b
    Example:
      gatar bridge download --vehicle udpin:0.0.0.0:14550
      gatar bridge verify --config vehicle.toml --cells cells.json
      gatar bridge set-origin --vehicle serial:/dev/ttyAMA0:921600 --at 47.397742,8.545594,488
    """


def _vehicle_options(function: Callable[..., None]) -> Callable[..., None]:
    """--vehicle, --sysid, --config and --timeout-s."""
    options = (
        click.option("--vehicle", "url", help="udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT, serial:DEVICE[:BAUD]"),
        click.option("--sysid", type=click.IntRange(1, 255), help="Of the vehicle, where several are heard."),
        click.option(
            "--config",
            "config_path",
            type=click.Path(path_type=Path, dir_okay=False),
            help="The vehicle.toml of its daemon: gives link, system and grid.",
        ),
        click.option("--timeout-s", type=FiniteRange(1, 600), default=60.0, show_default=True),
    )
    return functools.reduce(lambda f, option: option(f), reversed(options), function)


@command.command("download")
@_vehicle_options
@click.option("--json", "as_json", is_flag=True, help="For machines.")
@click.pass_context
def download(context: click.Context, /, as_json: bool, **vehicle: Any) -> None:
    """Print the mission that is on board; with --config each waypoint's cell too.

    \b
    Example:
      gatar bridge download --vehicle udpin:0.0.0.0:14550 --json
    """
    errand, plan = _mission(context, clear=False, **vehicle)
    _print(errand.items, plan, as_json)


@command.command("verify")
@_vehicle_options
@click.option(
    "--cells",
    "cells_path",
    type=click.Path(path_type=Path, allow_dash=True),
    help="JSON [[x, y], ...], the corners of a path; - is standard input. Needs --config. Without it: print.",
)
@click.pass_context
def verify(context: click.Context, /, cells_path: Path | None, **vehicle: Any) -> None:
    """Compare the mission on board with a list of cells, within the vehicle's rounding.

    Exit code 0: the same; 1: another, with the first difference.

    \b
    Example:
      gatar bridge verify --config vehicle.toml --cells cells.json
      echo '[[3, 4], [3, 9]]' | gatar bridge verify --config vehicle.toml --cells -
    """
    cells = _read_cells(cells_path) if cells_path is not None else None
    if cells is not None and vehicle["config_path"] is None:
        raise ConfigError("cells mean nothing without a grid: give --config vehicle.toml")
    if cells is not None:
        _check_inside(cells, vehicle["config_path"])
    errand, plan = _mission(context, clear=False, **vehicle)
    if cells is None or plan is None:
        _print(errand.items, plan, False)
        return
    difference = _difference(errand, plan, cells)
    click.echo(difference or f"the {len(cells)} waypoints on board are the given ones")
    context.exit(1 if difference else 0)


@command.command("clear")
@_vehicle_options
@click.pass_context
def clear(context: click.Context, /, **vehicle: Any) -> None:
    """Remove the mission on board. Refused while armed: it is no way to stop a vehicle, only a mode is.

    \b
    Example:
      gatar bridge clear --vehicle udpin:0.0.0.0:14550
    """
    errand, _ = _mission(context, clear=True, **vehicle)
    assert errand.visit.vehicle is not None
    click.echo(f"the mission of vehicle {errand.visit.vehicle[0]} is cleared")


@command.command("set-origin")
@_vehicle_options
@click.option("--at", required=True, help="LAT,LON or LAT,LON,ALT: degrees, metres above mean sea level.")
@click.pass_context
def set_origin(
    context: click.Context, at: str, url: str | None, sysid: int | None, config_path: Path | None, timeout_s: float
) -> None:
    """Give the estimator of a vehicle without GPS its origin, and wait until the vehicle tells it back.

    It is not home: that the vehicle sets by itself once it knows where it is. Refused while armed.

    \b
    Example:
      gatar bridge set-origin --vehicle udpin:0.0.0.0:14550 --at 47.397742,8.545594,488
    """
    from gatar_edge.bridge.errands import OriginErrand, OriginOutcome
    from gatar_edge.bridge.geo import deg_e7
    from gatar_edge.bridge.wire import GlobalOrigin
    from gatar_edge.commands._guest import call_on, target
    from gatar_edge.preflight import anchored_clock

    lat, lon, alt_m = _place(at)
    url, sysid, _ = target(url, sysid, config_path)
    clock_ns = anchored_clock()
    errand = OriginErrand(sysid, clock_ns(), GlobalOrigin(deg_e7(lat), deg_e7(lon), round(alt_m * 1000)))
    call_on(url, errand, timeout_s, clock_ns)
    if errand.outcome is OriginOutcome.SET and errand.told is not None:
        click.echo(f"its origin is {errand.told.lat_e7 / 1e7:.7f}, {errand.told.lon_e7 / 1e7:.7f}")
        return
    text = errand.outcome.value if errand.outcome is not None else _why_not(errand.visit)
    if errand.outcome is OriginOutcome.KEPT and errand.told is not None:
        text += f": {errand.told.lat_e7 / 1e7:.7f}, {errand.told.lon_e7 / 1e7:.7f}; one from a GPS is never replaced"
    _give_up(context, text)


def _mission(
    context: click.Context,
    url: str | None,
    sysid: int | None,
    config_path: Path | None,
    timeout_s: float,
    *,
    clear: bool,
) -> tuple[MissionErrand, DriverConfig | None]:
    """Run the transfer; ends with exit code 1 and one line where it failed."""
    import secrets

    from gatar_edge.bridge.errands import MissionErrand
    from gatar_edge.commands._guest import call_on, target
    from gatar_edge.preflight import anchored_clock

    url, sysid, plan = target(url, sysid, config_path)
    clock_ns = anchored_clock()
    errand = MissionErrand(sysid, clock_ns(), clear=clear, seed=secrets.randbits(32))
    call_on(url, errand, timeout_s, clock_ns)
    if errand.refused:
        _give_up(context, "it is armed: nothing was cleared; stop it by a mode and disarm it first")
    if errand.result is None or not errand.result.ok:
        text = errand.result.value if errand.result is not None else _why_not(errand.visit)
        _give_up(context, text)
    return errand, plan


def _why_not(visit: Visit) -> str:
    if visit.vehicle is None and not visit.unsupported and visit.autopilots:
        return f"system {visit.sysid} is not heard, but {', '.join(map(str, visit.autopilots))}"
    return visit.unsupported or "out of time"


def _give_up(context: click.Context, text: str) -> NoReturn:
    click.echo(f"gatar: {text}", err=True)
    context.exit(1)


def _print(items: Items, plan: DriverConfig | None, as_json: bool) -> None:
    import json

    from gatar_edge.bridge.geo import wgs84_to_cell

    rows: list[dict[str, object]] = []
    for seq, item in enumerate(items):
        lat, lon = item.lat_e7 / 1e7, item.lon_e7 / 1e7
        row: dict[str, object] = {"seq": seq, "command": item.command, "frame": item.frame}
        row |= {"lat_deg": lat, "lon_deg": lon, "alt_m": item.alt_m}
        if plan is not None:
            row["cell"] = wgs84_to_cell(plan.grid, lat, lon)
        rows.append(row)
    if as_json:
        click.echo(json.dumps(rows, indent=2))
        return
    for row in rows:
        cell = f"  cell {row['cell']}" if row.get("cell") else ""
        click.echo(
            f"{row['seq']:>4}  command {row['command']}  frame {row['frame']}  "
            f"{row['lat_deg']:.7f}, {row['lon_deg']:.7f}  {row['alt_m']:.2f} m{cell}"
        )
    if not rows:
        click.echo("no mission is on board")


def _difference(errand: MissionErrand, plan: DriverConfig, cells: tuple[Cell, ...]) -> str:
    """The first one, "" where there is none."""
    from gatar_edge.bridge.geo import cell_to_wgs84
    from gatar_edge.bridge.mission_items import build, same_item
    from gatar_edge.types import RobotKind

    profile = errand.visit.profile
    assert profile is not None
    altitude_m = plan.altitude_m if plan.kind is RobotKind.UAV else 0.0
    wanted = build(profile, tuple(cell_to_wgs84(plan.grid, cell) for cell in cells), altitude_m)
    first, items = profile.first_item_seq, errand.items
    if len(items) != len(wanted):
        return f"{max(0, len(items) - first)} waypoints are on board, {len(cells)} were given"
    for seq in range(first, len(wanted)):
        if not same_item(wanted[seq], items[seq], profile):
            item = items[seq]
            return (
                f"waypoint {seq - first + 1}, cell {cells[seq - first]}, is another: command {item.command}, frame "
                f"{item.frame}, {item.lat_e7 / 1e7:.7f}, {item.lon_e7 / 1e7:.7f}, {item.alt_m:.2f} m"
            )
    return ""


def _read_cells(path: Path) -> tuple[Cell, ...]:
    """A non-empty list of pairs of whole numbers. Raises ConfigError."""
    import msgspec

    from gatar_edge.bridge.mission_items import MAX_ITEMS

    try:
        with click.open_file(str(path), "rb") as file:
            data = file.read(MAX_CELLS_BYTES + 1)
        cells = msgspec.json.decode(data, type=list[tuple[int, int]])
    except OSError as error:
        raise ConfigError(f"{path} cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise ConfigError(f"{path} is no list of cells, like [[3, 4], [3, 9]]: {error}") from error
    if not 0 < len(cells) < MAX_ITEMS:
        raise ConfigError(f"{path} has {len(cells)} cells, must be 1 to {MAX_ITEMS - 1}")
    return tuple(cells)


def _check_inside(cells: tuple[Cell, ...], config_path: Path) -> None:
    from gatar_edge.bridge.geo import inside_grid
    from gatar_edge.vehicle_config import read_config

    grid = read_config(config_path).grid_spec
    for cell in cells:
        if not inside_grid(grid, cell):
            raise ConfigError(f"cell {cell} is outside of the grid of {grid.width} x {grid.height} cells")


def _place(text: str) -> tuple[float, float, float]:
    parts = text.split(",")
    try:
        numbers = [float(part) for part in parts]
    except ValueError:
        numbers = []
    if len(numbers) == 2:
        numbers.append(0.0)
    good = len(numbers) == 3 and abs(numbers[0]) <= 90 and abs(numbers[1]) <= 180
    if not good or not ALTITUDE_M[0] <= numbers[2] <= ALTITUDE_M[1]:
        raise ConfigError(f"--at {text!r} is no place, must be LAT,LON or LAT,LON,ALT like 47.397742,8.545594,488")
    return numbers[0], numbers[1], numbers[2]
