"""The daemon's configuration: one TOML file -> one frozen value. Every error is one line that names the field's path.

Paths in the file are relative to the folder of the file, also those within a value: the model in "gatar:FILE", the
socket in "unix:PATH". Checks that need more than the file (keys, models, addresses)
are made by `preflight`.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Literal

import msgspec
from msgspec import Meta, field

from gatar_edge.config import AgentConfig
from gatar_edge.errors import ConfigError
from gatar_edge.message import MAX_SPEED_CELLS_S
from gatar_edge.types import GridSpec, RobotKind

MAX_CONFIG_BYTES = 1_000_000

_AGENT = AgentConfig()
_Path = Annotated[str, Meta(pattern=r"^[^\0]*$")]
_Side = Annotated[int, Meta(ge=1, le=1024)]
_Latitude = Annotated[float, Meta(ge=-89, le=89)]
_Longitude = Annotated[float, Meta(ge=-180, le=180)]
_Positive = Annotated[float, Meta(gt=0, le=1e6)]


class _Section(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One table of the file."""


class RobotSection(_Section, frozen=True, kw_only=True):
    """Who this robot is."""

    id: Annotated[int, Meta(ge=1, le=0xFFFF)]  # unique in the team
    kind: Literal["UAV", "UGV"]
    speed_m_s: Annotated[float, Meta(gt=0, le=100)] = 5.0  # at cruise; neighbours weigh ways by it


class GridSection(_Section, frozen=True, kw_only=True):
    """The shared grid, the same on each robot of the team: see `types.GridSpec`."""

    origin_lat_deg: _Latitude
    origin_lon_deg: _Longitude
    width: _Side = 15
    height: _Side = 15
    cell_m: Annotated[float, Meta(ge=0.1, le=1000)] = 10.0
    heading_deg: Annotated[float, Meta(ge=-360, le=360)] = 0.0


class TeamSection(_Section, frozen=True, kw_only=True):
    """What else all robots of the team must agree on: the fields of `config.AgentConfig`, with its defaults."""

    r_sense: _Positive = _AGENT.r_sense
    r_comm: _Positive = _AGENT.r_comm
    hop_limit: Annotated[int, Meta(ge=1, le=8)] = _AGENT.hop_limit
    max_age_s: _Positive = _AGENT.max_age_s
    perception_max_age_s: _Positive = _AGENT.perception_max_age_s
    keep_task: bool = _AGENT.keep_task
    max_neighbors: Annotated[int, Meta(ge=1, le=63)] = _AGENT.max_neighbors
    max_candidates: Annotated[int, Meta(ge=1, le=1024)] = _AGENT.max_candidates


class ModelSection(_Section, frozen=True, kw_only=True):
    """What decides."""

    allocator: _Path = "gatar"  # by name; "gatar:FILE" is the name and the file in one
    file: _Path = ""  # an ONNX file; empty: the one that is shipped

    def __post_init__(self) -> None:
        if self.file and ":" in self.allocator:
            raise ValueError(
                f"allocator {self.allocator!r} and file {self.file!r} both name a model: leave one of them out"
            )

    @property
    def flown(self) -> str:
        """The allocator as `allocators.registry.make` takes it."""
        return f"{self.allocator}:{self.file}" if self.file else self.allocator


class NetSection(_Section, frozen=True, kw_only=True):
    """How neighbours are reached."""

    key_file: _Path
    transport: Literal["udp", "mavlink", "zenoh"] = "udp"
    listen: str = "0.0.0.0:14600"
    peers: list[str] = field(default_factory=list)  # udp: host:port; zenoh: endpoints to connect to
    group: str = ""  # udp: a multicast group, like 239.255.71.1:14600
    bytes_per_s: Annotated[int, Meta(ge=1024, le=100_000_000)] = 32_768  # never exceeded; relays give way first
    zenoh_config: _Path = ""  # zenoh: a file with the rest of its configuration (certificates, access control)

    def __post_init__(self) -> None:
        if self.transport == "udp" and not self.peers and not self.group:
            raise ValueError("nobody to talk to: give `peers` (a list of host:port) or a multicast `group`")
        if self.transport == "zenoh" and self.listen and "/" not in self.listen:
            raise ValueError(f"`listen` {self.listen!r} is no zenoh endpoint: tcp/0.0.0.0:7447, tls/..., or empty")
        if self.transport != "udp" and self.group:
            raise ValueError(f"`group` is of transport udp, not {self.transport}")


class VehicleSection(_Section, frozen=True, kw_only=True):
    """The autopilot and what it may be told."""

    url: _Path  # udpin:host:port, udpout:host:port, tcp:host:port or serial:device:baud
    sysid: Annotated[int, Meta(ge=0, le=255)] = 0  # of the autopilot; 0: the robot's id
    altitude_m: Annotated[float, Meta(gt=0, le=500)] = 20.0  # above home, for UAVs: a layer for each
    altitude_band_m: tuple[float, float] = (2.0, 120.0)  # outside of it nothing is commanded
    fence: list[tuple[_Latitude, _Longitude]] = field(default_factory=list)  # corners; empty: the grid's rectangle
    signing_key_file: _Path = ""  # the key of the autopilot's link, mode 0600; empty: nothing is signed
    drive: Literal["mission", "guided"] = "mission"  # how a UGV is driven
    targets: Literal["reposition", "setpoint"] = "reposition"  # guided ones: with or without an acknowledgement
    launch: Literal["armed", "auto"] = "armed"  # take over, and take off, once a person has armed it; or arm it oneself
    min_separation_m: Annotated[float, Meta(ge=0, le=1000)] = 0.0  # UGVs: from where another rests; 0: not asked
    # what SIGTERM does: stop the vehicle, let a UAV return to launch, or leave it to its last order
    on_stop: Literal["hold", "return", "leave"] = "hold"

    def __post_init__(self) -> None:
        if self.fence and len(self.fence) < 3:
            raise ValueError(
                f"fence has {len(self.fence)} corners, must have at least 3, or none for the grid's rectangle"
            )


class PerceptionSection(_Section, frozen=True, kw_only=True):
    """Where observations come in."""

    listen: _Path = "127.0.0.1:14700"  # or unix:/run/gatar/robot3/perception.sock
    allow_remote: bool = False  # observations are not signed: only this machine may send them


class LoopSection(_Section, frozen=True, kw_only=True):
    """Rates and deadlines."""

    tick_hz: Annotated[float, Meta(ge=0.2, le=10)] = 5.0  # 10 messages/s is what sequence numbers are made for
    deadline_ms: Annotated[float, Meta(ge=1, le=5000)] = 100.0  # for the allocator; then the fallback decides

    def __post_init__(self) -> None:
        if self.deadline_ms >= 1000 / self.tick_hz:
            raise ValueError(
                f"deadline_ms {self.deadline_ms:g} must be less than the {1000 / self.tick_hz:g} ms of one tick"
            )


class LogSection(_Section, frozen=True, kw_only=True):
    """The mission log."""

    folder: _Path = "logs"  # files named by robot and time; empty: no log
    rotate_min: Annotated[float, Meta(ge=1, le=1440)] = 60.0  # begin another file after this long
    rotate_mb: Annotated[float, Meta(ge=1, le=4000)] = 64.0  # or when it is this large
    keep_mb: Annotated[float, Meta(ge=2, le=10_000_000)] = 2000.0  # of this robot in all: the oldest are deleted
    keep_files: Annotated[int, Meta(ge=2, le=10_000)] = 500

    def __post_init__(self) -> None:
        if self.keep_mb < 2 * self.rotate_mb:
            raise ValueError(f"keep_mb {self.keep_mb:g} must be at least twice rotate_mb, {self.rotate_mb:g}")


class StateSection(_Section, frozen=True, kw_only=True):
    """What survives a crash."""

    file: _Path = "state-{id}.bin"  # {id}: the robot's; empty: none
    period_s: Annotated[float, Meta(ge=0.1, le=60)] = 1.0
    max_age_s: Annotated[float, Meta(ge=0, le=86_400)] = 600.0  # older knowledge is of another mission


class WatchSection(_Section, frozen=True, kw_only=True):
    """Being watched."""

    http: str = ""  # host:port of /healthz and /metrics, like 127.0.0.1:9100; empty: none


class VehicleConfig(_Section, frozen=True, kw_only=True):
    """The whole file."""

    robot: RobotSection
    grid: GridSection
    net: NetSection
    vehicle: VehicleSection
    team: TeamSection = field(default_factory=TeamSection)
    model: ModelSection = field(default_factory=ModelSection)
    perception: PerceptionSection = field(default_factory=PerceptionSection)
    loop: LoopSection = field(default_factory=LoopSection)
    log: LogSection = field(default_factory=LogSection)
    state: StateSection = field(default_factory=StateSection)
    watch: WatchSection = field(default_factory=WatchSection)

    def __post_init__(self) -> None:
        if not 0 < self.speed_cells_s <= MAX_SPEED_CELLS_S:
            raise ValueError(
                f"robot.speed_m_s {self.robot.speed_m_s:g} is {self.speed_cells_s:g} cells/s on cells of "
                f"{self.grid.cell_m:g} m, must be at most {MAX_SPEED_CELLS_S:g}"
            )
        if self.vehicle.sysid == 0 and self.robot.id > 255:
            raise ValueError(f"robot.id {self.robot.id} is no MAVLink system id: give vehicle.sysid")

        if self.vehicle.on_stop == "return" and self.kind is RobotKind.UGV:
            raise ValueError('vehicle.on_stop "return" is for UAVs: a UGV would drive home straight through obstacles')

    @property
    def speed_cells_s(self) -> float:
        """The robot's speed as neighbours read it."""
        return self.robot.speed_m_s / self.grid.cell_m

    @property
    def kind(self) -> RobotKind:
        """UAV or UGV."""
        return RobotKind[self.robot.kind]

    @property
    def grid_spec(self) -> GridSpec:
        """The grid as the core knows it."""
        return GridSpec(**msgspec.structs.asdict(self.grid))

    @property
    def agent(self) -> AgentConfig:
        """The agent's parameters."""
        return AgentConfig(grid=self.grid_spec, **msgspec.structs.asdict(self.team))


def parse_config(text: str | bytes, name: str = "vehicle.toml") -> VehicleConfig:
    """The configuration in TOML `text`. Raises ConfigError: what is wrong, and where in the file."""
    try:
        return msgspec.toml.decode(text, type=VehicleConfig)
    except (ValueError, RecursionError) as error:  # msgspec's errors, tomllib's, bytes that are not UTF-8, deep nests
        raise ConfigError(f"{name}: {_plain(str(error))}") from error


def read_config(path: Path) -> VehicleConfig:
    """The configuration in the file at `path`, with paths made absolute. Raises ConfigError."""
    try:
        with path.open("rb") as file:
            text = file.read(MAX_CONFIG_BYTES + 1)
    except OSError as error:
        raise ConfigError(f"{path} cannot be read ({error.strerror}): `gatar init` writes one") from error
    if len(text) > MAX_CONFIG_BYTES:
        raise ConfigError(f"{path} is larger than {MAX_CONFIG_BYTES} bytes: not a configuration")
    return resolved(parse_config(text, str(path)), path.absolute().parent)


def resolved(config: VehicleConfig, folder: Path) -> VehicleConfig:
    """The configuration of a file in `folder`, with paths made absolute."""

    def at(path: str) -> str:
        return str(folder / path) if path else ""

    replace = msgspec.structs.replace
    rule, colon, file = config.model.allocator.partition(":")
    model = replace(config.model, allocator=rule, file=file) if rule == "gatar" and colon else config.model
    scheme, colon, socket = config.perception.listen.partition(":")
    listen = f"unix:{at(socket)}" if scheme == "unix" and colon else config.perception.listen
    return replace(
        config,
        model=replace(model, file=at(model.file)),
        perception=replace(config.perception, listen=listen),
        net=replace(config.net, key_file=at(config.net.key_file), zenoh_config=at(config.net.zenoh_config)),
        vehicle=replace(config.vehicle, signing_key_file=at(config.vehicle.signing_key_file)),
        log=replace(config.log, folder=at(config.log.folder)),
        state=replace(config.state, file=at(config.state.file.replace("{id}", str(config.robot.id)))),
    )


def _plain(text: str) -> str:
    """msgspec's texts, in the words of somebody who edits a file."""
    text = re.sub(r"^Object contains unknown field `(.*?)`", r"unknown field \1", text)
    text = re.sub(r"^Object missing required field `(.*?)`", r"missing field \1", text)
    return re.sub(r" - at `(.*?)`$", r" - at \1", text)
