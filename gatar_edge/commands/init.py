"""`gatar init`: write a commented vehicle.toml, and the team's key where there is none."""

from __future__ import annotations

import json
import os
import secrets
from pathlib import Path
from typing import Any, TypeVar

import click

from gatar_edge.errors import ConfigError, LinkError

Number = TypeVar("Number", int, float)


def corner_of(answer: str | tuple[float, float]) -> tuple[float, float]:
    """LAT,LON in degrees within the limits of `vehicle_config`; click hands an answer in twice."""
    import msgspec

    from gatar_edge.vehicle_config import GridSection

    corner = _pair(answer, ",", float) if isinstance(answer, str) else answer
    if corner is None:
        raise click.BadParameter(f"{answer!r} is not of the form 47.397742,8.545594")
    try:
        msgspec.convert({"origin_lat_deg": corner[0], "origin_lon_deg": corner[1]}, GridSection)
    except msgspec.ValidationError as error:
        raise click.BadParameter(f"{answer!r} is not LAT,LON in degrees: {error}") from error
    return corner


def sides_of(text: str | tuple[int, int]) -> tuple[int, int]:
    """Cells east x north."""
    sides = _pair(text.lower(), "x", int) if isinstance(text, str) else text
    if sides is None:
        raise click.BadParameter(f"{text!r} is not of the form 15x15")
    return sides


def url_of(answer: str) -> str:
    """The URL of an autopilot, as `bridge.link` takes it."""
    from gatar_edge.bridge.link import check_url

    try:
        check_url(answer)
    except LinkError as error:
        raise click.BadParameter(str(error)) from error
    return answer


def _pair(text: str, separator: str, kind: type[Number]) -> tuple[Number, Number] | None:
    try:
        first, second = (kind(part) for part in text.split(separator))
    except ValueError:
        return None
    return first, second


def _unused(context: click.Context, param: click.Parameter, value: Any) -> Any:
    """Tell that the file exists before any question: of --config and --force, whichever comes last."""
    given = context.params | {param.name: value}
    path = given.get("path")
    if path is not None and given.get("force") is False and path.exists():
        raise ConfigError(f"{path} exists: --force overwrites it, --config writes another")
    return value


TEMPLATE = """\
# One robot of a gatar-edge team. `gatar vehicle --config {name} --check` says what it would do.
# Only [robot], [vehicle] and net.peers differ between the robots of one team; what is commented out is the default.

[robot]
id = {id}                  # 1 to 65535, unique in the team
kind = {kind}             # "UAV" flies over obstacles, "UGV" drives round them
speed_m_s = {speed}         # at cruise: neighbours weigh ways by it, and the vehicle is told it

[grid]                     # the same on each robot
origin_lat_deg = {lat}     # outer south-west corner of cell (0, 0)
origin_lon_deg = {lon}
width = {width}               # cells to the east
height = {height}              # cells to the north
cell_m = {cell}
# heading_deg = 0.0        # turns the grid's y axis clockwise from north

[team]                     # the same on each robot
r_sense = {r_sense}            # cells that perception sees
r_comm = {r_comm}             # cells within which robots count as neighbours
# hop_limit = 2            # how often a message is passed on
# max_age_s = 3.0          # a neighbour silent for longer leaves the team; its target goes to somebody else
# perception_max_age_s = 3.0  # without an observation for longer the vehicle holds

[model]
allocator = {allocator}        # "gatar", or a classical rule: "greedy", "nearest", "hungarian", "routing"
# file = "model.onnx"      # another model than the one that is shipped

[net]
key_file = {key}    # 32 bytes, mode 0600, the same file on each robot
transport = "udp"
listen = {listen}
{reach}
# bytes_per_s = 32768      # never exceeded; relays give way first

[vehicle]
url = {url}  # udpin:host:port, udpout:host:port, tcp:host:port, serial:device:baud
# sysid = 0                # MAVLink system of the autopilot; 0: the robot's id
altitude_m = {altitude}        # above home; give each UAV its own layer
# altitude_band_m = [2.0, 120.0]
# fence = [[47.0, 8.0], [47.0, 8.1], [47.1, 8.1]]  # corners; without it the grid's rectangle
# signing_key_file = ""    # 32 bytes, mode 0600, as the autopilot was given it; empty: nothing is signed
# drive = "mission"        # how a UGV is driven: "mission" or "guided"
# targets = "reposition"   # guided ones by DO_REPOSITION; "setpoint": SET_POSITION_TARGET_GLOBAL_INT (ArduPilot alone)
launch = {launch}          # "armed": take over, and take off, once a person has armed it; "auto": arm it, too
# min_separation_m = 0.0   # of ground robots: from where another rests or is to rest; 0: not asked
# on_stop = "hold"         # SIGTERM stops it; "return": a UAV returns to launch; "leave" leaves it to its last order

[perception]
listen = {perception}  # or "unix:/run/gatar/robot3/perception.sock"; format: docs/observation.schema.json

[loop]
# tick_hz = 5.0
# deadline_ms = 100.0      # for the model; then greedy decides

[log]
folder = "logs"            # "" for none
# rotate_min = 60.0        # begin another file after this long
# rotate_mb = 64.0         # or when it is this large
# keep_mb = 2000.0         # of this robot in all: the oldest files are deleted
# keep_files = 500

[state]
file = "state-{id}.bin"       # belief, task and message sequence: a restarted daemon goes on where it was
# max_age_s = 600.0        # older knowledge is of another mission

[watch]
http = {http}                  # /healthz and /metrics, such as "127.0.0.1:9100"
"""


@click.command("init")
@click.option(
    "--config",
    "path",
    type=click.Path(path_type=Path, dir_okay=False),
    default=Path("vehicle.toml"),
    show_default=True,
    is_eager=True,
    callback=_unused,
    help="The file to write; other paths in it are relative to its folder.",
)
@click.option(
    "--id",
    "robot_id",
    type=click.IntRange(1, 255),  # a larger one needs vehicle.sysid, which is not asked for
    prompt="Robot's number in the team",
    help="Unique in the team; also the MAVLink system of its autopilot.",
)
@click.option(
    "--kind",
    type=click.Choice(["UAV", "UGV"], case_sensitive=False),
    prompt="Kind of vehicle",
    help="UAV: flies; UGV: drives.",
)
@click.option(
    "--origin",
    type=corner_of,
    metavar="LAT,LON",
    prompt="South-west corner of the grid, LAT,LON in degrees",
    help="South-west corner of the grid, in degrees; the same on each robot.",
)
@click.option("--size", type=sides_of, metavar="WxH", default="15x15", show_default=True, help="Cells east x north.")
@click.option("--cell-m", type=float, default=10.0, show_default=True, help="Side of a cell, in metres.")
@click.option("--speed-m-s", type=float, default=5.0, show_default=True, help="Cruise speed.")
@click.option(
    "--altitude-m", type=float, default=20.0, show_default=True, help="Above home; each UAV needs its own layer."
)
@click.option("--r-sense", type=float, default=4.0, show_default=True, help="Sight of the perception, in cells.")
@click.option(
    "--r-comm",
    type=float,
    default=6.0,
    show_default=True,
    help="Cells within which robots count as neighbours; at most what the radio reaches.",
)
@click.option(
    "--url",
    type=url_of,
    metavar="URL",
    prompt="Autopilot (such as udpin:127.0.0.1:14551 or serial:/dev/ttyAMA0:921600)",
    help="The autopilot: udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT or serial:DEVICE[:BAUD].",
)
@click.option(
    "--allocator",
    default="gatar",
    show_default=True,
    help="What decides: gatar, gatar:MODEL.onnx, greedy, nearest, hungarian, routing, ...",
)
@click.option(
    "--listen",
    metavar="HOST:PORT",
    default="0.0.0.0:14600",
    show_default=True,
    help="Where neighbours are heard.",
)
@click.option(
    "--peer", "peers", metavar="HOST:PORT", multiple=True, help="A neighbour; may be repeated. None: multicast."
)
@click.option(
    "--group",
    metavar="HOST:PORT",
    default="239.255.71.1:14600",
    show_default=True,
    help="Multicast group, where no peer is given; the port is that of --listen.",
)
@click.option(
    "--perception",
    metavar="HOST:PORT",
    default="127.0.0.1:14700",
    show_default=True,
    help="Where observations come in; or unix:PATH.",
)
@click.option(
    "--launch",
    type=click.Choice(["armed", "auto"]),
    default="armed",
    show_default=True,
    help="armed: takes over once a person has armed it; auto: arms it by itself, for simulators only.",
)
@click.option(
    "--http", metavar="HOST:PORT", default="", help="Where /healthz and /metrics are served.  [default: nowhere]"
)
@click.option(
    "--key-file", default="team.key", show_default=True, help="The team's key, beside the file; made where none is."
)
@click.option(
    "--force",
    is_flag=True,
    is_eager=True,
    callback=_unused,
    help="Overwrite an existing configuration; a key is never overwritten.",
)
def command(
    path: Path, force: bool, key_file: str, origin: tuple[float, float], size: tuple[int, int], **options: Any
) -> None:
    """Write a commented vehicle.toml, and the team's key where there is none. Asks for what is not given.

    \b
    Example:
      gatar init --id 3 --kind UAV --origin 47.397742,8.545594 --url udpin:127.0.0.1:14551
    """
    from gatar_edge.allocators.registry import make
    from gatar_edge.keys import read_key
    from gatar_edge.preflight import check_addresses, driver_config
    from gatar_edge.vehicle_config import parse_config, resolved

    text = configuration(path.name, origin, size, key_file, options)
    config = resolved(parse_config(text, "what you gave"), path.absolute().parent)
    check_addresses(config)
    driver_config(config)
    make(config.model.flown)
    key_path = path.parent / key_file
    made = make_key(key_path)
    read_key(key_path)
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{path} cannot be written: {error.strerror}") from error
    click.echo(f"wrote  {path}")
    click.echo(
        f"{'made ' if made else 'kept '}  {key_path}" + ("  (copy it to each robot of the team)" if made else "")
    )
    click.echo(f"\nNext: gatar vehicle --config {path} --check")


def configuration(
    name: str, corner: tuple[float, float], sides: tuple[int, int], key_file: str, options: dict[str, Any]
) -> str:
    """The text of vehicle.toml."""
    peers = list(options["peers"])
    reach = f"peers = {_quoted(peers)}" if peers else f"group = {_quoted(options['group'])}"
    quoted = {key: _quoted(options[key]) for key in ("url", "allocator", "listen", "perception", "launch", "http")}
    return TEMPLATE.format(
        name=name,
        id=options["robot_id"],
        kind=_quoted(str(options["kind"]).upper()),
        speed=options["speed_m_s"],
        lat=corner[0],
        lon=corner[1],
        width=sides[0],
        height=sides[1],
        cell=options["cell_m"],
        r_sense=options["r_sense"],
        r_comm=options["r_comm"],
        altitude=options["altitude_m"],
        key=_quoted(key_file),
        reach=reach,
        **quoted,
    )


def _quoted(value: Any) -> str:
    """As TOML writes it: like JSON, but that it takes no halves of characters."""
    return json.dumps(value, ensure_ascii=False)


def make_key(path: Path) -> bool:
    """Make a key of mode 0600 where there is none; true if one was made. Raises ConfigError."""
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except FileExistsError:
        return False
    except OSError as error:
        raise ConfigError(f"key file {path} cannot be made: {error.strerror}") from error
    with os.fdopen(descriptor, "wb") as file:
        file.write(secrets.token_bytes(32))
    return True
