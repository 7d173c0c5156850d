"""From a configuration to a daemon: everything that can be checked without a socket, then everything that opens one.

`prepare` is what `gatar vehicle --check` does; `assemble` goes on from there. Both raise a GatarError of one line that
says what is wrong and how to mend it.
"""

from __future__ import annotations

import contextlib
import importlib.util
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gatar_edge.agent import Identity
from gatar_edge.allocators.base import Allocator
from gatar_edge.bridge.geo import self_crossing
from gatar_edge.bridge.link import check_url
from gatar_edge.bridge.settings import DriverConfig
from gatar_edge.bridge.signing import Signing, load_key, timestamp_of
from gatar_edge.errors import ConfigError, GatarError, MissingExtraError
from gatar_edge.keys import read_key
from gatar_edge.message import MESSAGE_BYTES, first_seq
from gatar_edge.own_ports import check_ports
from gatar_edge.perception_link import local_address, unix_path
from gatar_edge.persist import LoadOutcome, Restored, load
from gatar_edge.transports.budget import ByteBudget
from gatar_edge.transports.udp import parse_address, parse_group
from gatar_edge.types import CellState, RobotKind, RobotState
from gatar_edge.vehicle_config import VehicleConfig
from gatar_edge.view import build_view

SIGNING_LINK_ID = 0


@dataclass(frozen=True, slots=True)
class Prepared:
    """A configuration that has been found good, with what was read and made on the way."""

    config: VehicleConfig
    key: bytes
    allocator: Allocator
    driver: DriverConfig
    restored: Restored
    seq: int
    signing: Signing | None  # of the autopilot's link

    @property
    def flown(self) -> str:
        """The allocator as a replay of the log must make it."""
        return self.config.model.flown

    @property
    def identity(self) -> Identity:
        """Who the robot is."""
        return Identity(self.config.robot.id, self.config.kind, self.config.speed_cells_s)


def prepare(config: VehicleConfig, unix_ns: int) -> Prepared:
    """Check all that needs no socket. Raises the GatarError of the first thing that is wrong."""
    key = read_key(Path(config.net.key_file))
    signing_file = config.vehicle.signing_key_file
    signing_key = load_key(Path(signing_file)) if signing_file else None
    driver = driver_config(config)
    check_addresses(config)
    _check_peers(config)
    ByteBudget(config.net.bytes_per_s, sends=max(1, len(config.net.peers) + bool(config.net.group)))
    for name, folder in (("log.folder", config.log.folder), ("state.file", str(Path(config.state.file).parent))):
        if config.log.folder if name == "log.folder" else config.state.file:
            _check_folder(name, Path(folder))
    if Path(config.state.file).is_dir() and config.state.file:
        raise ConfigError(f"state.file {config.state.file} is a folder: give the name of a file in it")
    allocator = make_allocator(config)
    restored = Restored(LoadOutcome.ABSENT)
    if config.state.file:
        restored = load(Path(config.state.file), config.robot.id, config.agent, unix_ns, config.state.max_age_s)
    signing = None
    if signing_key is not None:
        signing = Signing(signing_key, SIGNING_LINK_ID, max(timestamp_of(unix_ns), restored.signing_timestamp))
    return Prepared(config, key, allocator, driver, restored, first_seq(unix_ns, restored.last_seq), signing)


def driver_config(config: VehicleConfig) -> DriverConfig:
    """The bridge's part. Raises ConfigError for what cannot be flown."""
    vehicle = config.vehicle
    plan = DriverConfig(
        robot_id=config.robot.id,
        kind=config.kind,
        grid=config.grid_spec,
        sysid=vehicle.sysid or config.robot.id,
        altitude_m=vehicle.altitude_m,
        altitude_band_m=vehicle.altitude_band_m,
        speed_m_s=config.robot.speed_m_s,
        fence_deg=tuple(vehicle.fence) or None,
        drive=vehicle.drive,
        targets=vehicle.targets,
        min_separation_m=vehicle.min_separation_m,
        auto_launch=False,  # the daemon decides, see assemble
        log_frames=bool(config.log.folder),
    )
    fence_m = plan.limits().fence_m
    if (crossing := self_crossing(fence_m)) is not None:
        after, other = (f"{i + 1} and {(i + 1) % len(fence_m) + 1}" for i in crossing)
        raise ConfigError(
            f"vehicle.fence crosses itself: the line between corners {after} meets the one between {other}; "
            "give its corners in order round the area"
        )
    east_m, north_m = zip(*fence_m, strict=True)
    width_m, height_m = config.grid.width * config.grid.cell_m, config.grid.height * config.grid.cell_m
    if max(east_m) <= 0 or max(north_m) <= 0 or min(east_m) >= width_m or min(north_m) >= height_m:
        raise ConfigError("vehicle.fence lies beside the grid: every goal would be refused; its corners are [LAT, LON]")
    return plan


def make_allocator(config: VehicleConfig) -> Allocator:
    """The configured allocator, tried once: a model that cannot decide is found out here. Raises GatarError."""
    allocator = _load_allocator(config)
    belief = np.full((config.grid.width, config.grid.height), CellState.FREE, dtype=np.uint8)
    belief[-1, -1] = CellState.TARGET
    ego = RobotState(config.robot.id, config.kind, (0, 0), config.speed_cells_s)
    other = RobotState(config.robot.id + 1, RobotKind.UAV, (0, 0), config.speed_cells_s)
    team = config.team
    view = build_view(0, ego, [other], belief, team.r_comm, team.hop_limit, team.max_candidates)
    try:
        allocator.allocate(view)
    except GatarError:
        raise
    except Exception as error:  # of whatever library the model runs on
        raise ConfigError(f"allocator {allocator.name} cannot decide: {type(error).__name__}: {error}") from error
    return allocator


def _load_allocator(config: VehicleConfig) -> Allocator:
    model = config.model
    if model.allocator == "gatar":
        from gatar_edge.allocators.gatar import Gatar
        from gatar_edge.policy import DEFAULT_MODEL

        return Gatar(Path(model.file) if model.file else DEFAULT_MODEL, config.agent)
    from gatar_edge.allocators.registry import hears_all, make

    if hears_all(model.allocator):
        raise ConfigError(f"allocator {model.allocator} hears all robots at any distance: it is for simulations only")
    if model.file:
        raise ConfigError(f"model.file is for the allocator gatar, not {model.allocator}: leave one of them out")
    return make(model.allocator)()


def describe(prepared: Prepared, *, dry_run: bool) -> list[str]:
    """What the daemon would do, for people."""
    config, net, vehicle = prepared.config, prepared.config.net, prepared.config.vehicle
    reach = ", ".join([*net.peers, *([f"group {net.group}"] if net.group else [])]) or "whoever listens"
    share = MESSAGE_BYTES * config.loop.tick_hz * max(1, len(net.peers) + bool(net.group))
    grid = config.grid
    return [
        f"robot      {config.kind.name} {config.robot.id}, {config.robot.speed_m_s:g} m/s",
        f"grid       {grid.width} x {grid.height} cells of {grid.cell_m:g} m from {grid.origin_lat_deg:.7f}, "
        f"{grid.origin_lon_deg:.7f}, turned {grid.heading_deg:g} deg; team digest {config.agent.digest():08x}",
        f"decides    {prepared.allocator.name} {config.loop.tick_hz:g} times a second, "
        f"{config.loop.deadline_ms:g} ms each; then greedy decides",
        f"neighbours {net.transport} on {net.listen} to {reach}; own messages {share:.0f} of {net.bytes_per_s} bytes/s",
        f"vehicle    {vehicle.url}, system {prepared.driver.sysid}, {'signed, ' if prepared.signing else ''}"
        f"{_launching(config, dry_run)}",
        f"perception {config.perception.listen}; older than {config.team.perception_max_age_s:g} s: hold",
        f"on stop    {vehicle.on_stop}",
        f"log        {config.log.folder or 'none'}",
        f"state      {config.state.file or 'none'} ({prepared.restored.outcome.value}), next message {prepared.seq}",
        f"watch      {config.watch.http or 'none'}",
    ]


def anchored_clock() -> Callable[[], int]:
    """A clock that never jumps, yet tells the time of day as it was known at the start: nanoseconds since 1970.

    Ages and deadlines need the first, logs of several robots the second.
    """
    offset_ns = time.time_ns() - time.monotonic_ns()
    return lambda: time.monotonic_ns() + offset_ns


def _launching(config: VehicleConfig, dry_run: bool) -> str:
    starts = f"takes off to {config.vehicle.altitude_m:g} m" if config.kind is RobotKind.UAV else "drives off"
    if dry_run:
        return "shadow mode: no command is sent"
    if config.vehicle.launch == "auto":
        return f"ARMS BY ITSELF and {starts}"
    return f"{starts} when a person has armed it"


def check_addresses(config: VehicleConfig) -> None:
    """Of this machine and its vehicle; those of peers are for `prepare`, on the network where they are known."""
    check_url(config.vehicle.url)
    if config.perception.listen.startswith("unix:"):
        unix_path(config.perception.listen)
    else:
        local_address(config.perception.listen, allow_remote=config.perception.allow_remote)
    if config.watch.http:
        parse_address(config.watch.http, "watch.http")
    if config.net.transport == "udp":
        own = parse_address(config.net.listen, "net.listen")
        if config.net.group:
            parse_group(config.net.group, own, config.net.listen)
    check_ports(config)


def _check_peers(config: VehicleConfig) -> None:
    if config.net.transport == "zenoh" and importlib.util.find_spec("zenoh") is None:
        raise MissingExtraError("net.transport = 'zenoh'", "zenoh", "eclipse-zenoh")
    if config.net.transport == "udp":
        for peer in config.net.peers:
            parse_address(peer, "net.peers", lowest_port=1)


def _check_folder(name: str, folder: Path) -> None:
    """Make the folder where it is missing, and see that files can be made in it."""
    with contextlib.suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
    if not folder.is_dir() or not os.access(folder, os.W_OK | os.X_OK):
        raise ConfigError(f"{name}: folder {folder} cannot be written to: make it, or give another one")
