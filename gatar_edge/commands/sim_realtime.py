"""`gatar sim --realtime`: the wall clock, real ground stations, and daemons as separate processes."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import TYPE_CHECKING

import click

from gatar_edge.commands._options import anchored
from gatar_edge.errors import LinkError

if TYPE_CHECKING:
    from gatar_edge.sim_sitl.fleet import Fleet
    from gatar_edge.sim_sitl.fleet_config import FleetConfig
    from gatar_edge.sim_sitl.realtime import UdpSocket
    from gatar_edge.sim_sitl.tally import Result
    from gatar_edge.sim_sitl.yard import Yard

HOST = "127.0.0.1"
EYES_OFFSET = 100  # daemon i hears at the base port + i, and looks at that + 100
LISTENER_OFFSET = 99  # `gatar fleet` hears at the base port + 99: a team has at most 64 robots
SLICE_S = 0.05


def fly_live(
    config: FleetConfig,
    allocator: str,
    log_path: Path | None,
    *,
    quiet: bool,
    listen: str,
    speed_factor: float,
    daemons: Path | None,
    base_port: int,
) -> Result:
    """Fly by the wall clock until the mission is over or Ctrl-C; the vehicles listen at `listen`."""
    from gatar_edge.sim_sitl.realtime import UdpSocket

    with contextlib.closing(UdpSocket(listen)) as vehicles:
        count = len(config.world.team.kinds)
        served = f"{count} vehicles, system ids 1 to {count}, at {listen}"
        if daemons is not None:
            return _with_daemons(config, allocator, vehicles, daemons, base_port, speed_factor, quiet, served)
        if not quiet:
            click.echo(served, err=True)
        return _with_minds(config, allocator, log_path, vehicles, speed_factor, quiet)


def _with_minds(
    config: FleetConfig, allocator: str, log_path: Path | None, vehicles: UdpSocket, speed_factor: float, quiet: bool
) -> Result:
    """Everything in this process; ground stations may look on and interfere."""
    from gatar_edge.commands._sim import open_fleet
    from gatar_edge.sim_sitl.realtime import Gateway

    with open_fleet(config, allocator, log_path, Gateway(vehicles)) as fleet:
        _run(fleet, speed_factor, quiet)
        return fleet.result()


def _with_daemons(
    config: FleetConfig,
    allocator: str,
    vehicles: UdpSocket,
    folder: Path,
    base_port: int,
    speed_factor: float,
    quiet: bool,
    served: str,
) -> Result:
    """The vehicles here, the minds in processes of their own."""
    from gatar_edge.sim_sitl.realtime import UdpSocket
    from gatar_edge.sim_sitl.yard import Sockets, Yard

    ids = config.world.team.ids
    with contextlib.closing(UdpSocket(f"{HOST}:{base_port}")) as radio:
        eyes = {robot_id: (HOST, base_port + EYES_OFFSET + robot_id) for robot_id in ids}
        ears = {robot_id: (HOST, base_port + robot_id) for robot_id in ids}
        yard = Yard(config, Sockets(vehicles, radio, eyes, ears, (HOST, base_port + LISTENER_OFFSET)))
        paths = write_configurations(config, allocator, vehicles.port, folder, base_port)
        if not quiet:
            click.echo(served, err=True)
            click.echo("Now start the minds, each in a shell of its own or in the background:", err=True)
            for path in paths:
                click.echo(f"  gatar vehicle --config {path}", err=True)
            listener = f"{HOST}:{base_port + LISTENER_OFFSET}"
            click.echo(
                f"and, to see the team:\n  gatar fleet --key {folder / 'team.key'} --listen {listener}", err=True
            )
        _run(yard, speed_factor, quiet)
        return yard.result()


def _run(fleet: Fleet | Yard, speed_factor: float, quiet: bool) -> None:
    """Until the mission is over or the user has seen enough: Ctrl-C is a good end."""
    from gatar_edge.commands._sim import progress
    from gatar_edge.sim_sitl.realtime import paced

    with progress(fleet, quiet) as update, contextlib.suppress(KeyboardInterrupt):
        for now_ns in paced(SLICE_S, speed_factor):
            fleet.advance(now_ns)
            update()
            if fleet.over:
                return


def write_configurations(
    config: FleetConfig, allocator: str, vehicles_port: int, folder: Path, base_port: int
) -> list[Path]:
    """One vehicle.toml a robot, and the team's key: all that the daemons of this mission need.

    What daemons of an earlier mission knew is removed: it is of another world. Raises GatarError.
    """
    from gatar_edge.commands.init import configuration, make_key
    from gatar_edge.preflight import make_allocator
    from gatar_edge.vehicle_config import parse_config

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise LinkError(f"{folder} cannot be made: {error.strerror}") from error
    grid = config.agent.grid
    texts = {}
    for robot_id, kind in zip(config.world.team.ids, config.world.team.kinds, strict=True):
        options = {
            "robot_id": robot_id,
            "kind": kind.name,
            "speed_m_s": config.speed_m_s,
            "cell_m": grid.cell_m,
            "r_sense": config.agent.r_sense,
            "r_comm": config.agent.r_comm,
            "altitude_m": config.altitude_m + config.altitude_step_m * robot_id,
            "allocator": anchored(allocator),
            "url": f"udpout:{HOST}:{vehicles_port}",
            "listen": f"{HOST}:{base_port + robot_id}",
            "peers": [f"{HOST}:{base_port}"],
            "perception": f"{HOST}:{base_port + EYES_OFFSET + robot_id}",
            "launch": "auto",
            "http": "",
        }
        path = folder / f"robot{robot_id}.toml"
        corner, sides = (grid.origin_lat_deg, grid.origin_lon_deg), (grid.width, grid.height)
        texts[path] = configuration(path.name, corner, sides, "team.key", options)
    make_allocator(parse_config(next(iter(texts.values()))))  # what the daemons would refuse is refused here
    make_key(folder / "team.key")
    for robot_id in config.world.team.ids:
        (folder / f"state-{robot_id}.bin").unlink(missing_ok=True)
    for path, text in texts.items():
        path.write_text(text, encoding="utf-8")
    return list(texts)
