"""A faults file: TOML -> `Faults`. Every error is one line that names the file and the field's path.

Times are seconds from the end of the launch, delays and jitter milliseconds.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Annotated, Literal

import msgspec
from msgspec import Meta, field

from gatar_edge.errors import ConfigError
from gatar_edge.sim_sitl.faults import Burst, Faults, LinkFaults
from gatar_edge.sim_sitl.incident_types import Incident, KillRobot, RobotId, Time
from gatar_edge.types import NS_PER_S

MAX_FILE_BYTES = 1_000_000
_NS_PER_MS = 1_000_000

_Chance = Annotated[float, Meta(ge=0, le=1)]
_Milliseconds = Annotated[float, Meta(ge=0, le=600_000)]


class _Section(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One table of the file."""


class BurstSection(_Section, frozen=True, kw_only=True):
    """See `faults.Burst`."""

    enter: _Chance
    leave: _Chance
    loss: _Chance = 1.0


class LinkSection(_Section, frozen=True, kw_only=True):
    """One direction of links; see `faults.LinkFaults`."""

    loss: _Chance = 0.0
    duplicate: _Chance = 0.0
    reorder: _Chance = 0.0
    corrupt: _Chance = 0.0
    delay_ms: _Milliseconds = 0.0
    jitter_ms: _Milliseconds = 0.0  # on top of the delay, drawn evenly
    burst: BurstSection | None = None
    blackouts_s: tuple[tuple[Time, Time], ...] = ()  # from, to
    bandwidth_bytes_s: Annotated[int, Meta(ge=0, le=1_000_000_000)] = 0
    replay: _Chance = 0.0
    replay_after_s: Annotated[float, Meta(ge=0, le=3600)] = 10.0

    def faults(self) -> LinkFaults:
        """The same for the simulator. Raises ConfigError."""
        burst = self.burst
        return LinkFaults(
            loss=self.loss,
            duplicate=self.duplicate,
            reorder=self.reorder,
            corrupt=self.corrupt,
            delay_min_ns=round(self.delay_ms * _NS_PER_MS),
            delay_max_ns=round((self.delay_ms + self.jitter_ms) * _NS_PER_MS),
            burst=Burst(burst.enter, burst.leave, burst.loss) if burst is not None else None,
            blackouts_ns=tuple((round(a * NS_PER_S), round(b * NS_PER_S)) for a, b in self.blackouts_s),
            bandwidth_bytes_s=self.bandwidth_bytes_s,
            replay=self.replay,
            replay_after_ns=round(self.replay_after_s * NS_PER_S),
        )


class BetweenSection(LinkSection, frozen=True, kw_only=True):
    """What one robot's radio says to another, instead of [radio]."""

    sender: RobotId
    receiver: RobotId


class RobotLinkSection(LinkSection, frozen=True, kw_only=True):
    """One direction of one robot's telemetry, instead of [to_vehicle] or [to_companion]."""

    robot: RobotId
    direction: Literal["to_vehicle", "to_companion"]


class FaultsFile(_Section, frozen=True, kw_only=True):
    """The whole file; all of it may be left out."""

    radio: LinkSection = LinkSection()
    to_vehicle: LinkSection = LinkSection()
    to_companion: LinkSection = LinkSection()
    between: tuple[BetweenSection, ...] = ()
    telemetry: tuple[RobotLinkSection, ...] = ()
    event: tuple[Incident, ...] = field(default=())

    def faults(self) -> Faults:
        """The same for the simulator. Raises ConfigError."""
        kills = [event for event in self.event if isinstance(event, KillRobot)]
        _once("[[between]]", [f"{section.sender} to {section.receiver}" for section in self.between])
        _once("[[telemetry]]", [f"robot {section.robot}, {section.direction}" for section in self.telemetry])
        _once("kill_robot", [f"robot {event.robot}" for event in kills])
        both = (self.to_vehicle.faults(), self.to_companion.faults())
        links: dict[int, tuple[LinkFaults, LinkFaults]] = {}
        for section in self.telemetry:
            to_vehicle, to_companion = links.get(section.robot, both)
            one = section.faults()
            aboard = section.direction == "to_vehicle"
            links[section.robot] = (one, to_companion) if aboard else (to_vehicle, one)
        return Faults(
            radio=self.radio.faults(),
            to_vehicle=both[0],
            to_companion=both[1],
            kill_ns={event.robot: round(event.at_s * NS_PER_S) for event in kills},
            between={(section.sender, section.receiver): section.faults() for section in self.between},
            links_of=links,
            incidents=tuple(e for e in self.event if not isinstance(e, KillRobot)),
        )


def _once(table: str, names: list[str]) -> None:
    """Raise ConfigError where one would silently replace another."""
    twice = next((name for name, count in Counter(names).items() if count > 1), None)
    if twice is not None:
        raise ConfigError(f"{table} has {twice} twice")


def parse_faults(text: bytes, name: str = "faults") -> Faults:
    """The faults that a file declares. Raises ConfigError for whatever else it holds."""
    if len(text) > MAX_FILE_BYTES:
        raise ConfigError(f"{name} has {len(text)} bytes, the limit is {MAX_FILE_BYTES}")
    try:
        return msgspec.toml.decode(text, type=FaultsFile).faults()
    except (ValueError, RecursionError) as error:  # of msgspec, of tomllib, of bytes that are not UTF-8, of deep nests
        raise ConfigError(f"{name}: {' '.join(str(error).split())}") from None
    except ConfigError as error:
        raise ConfigError(f"{name}: {error}") from None


def load_faults(path: Path) -> Faults:
    """Read a faults file. Raises ConfigError."""
    try:
        with path.open("rb") as file:
            return parse_faults(file.read(MAX_FILE_BYTES + 1), str(path))
    except OSError as error:
        raise ConfigError(f"{path} cannot be read: {error.strerror}") from None
