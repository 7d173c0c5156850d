"""What goes wrong, declared beforehand: values only. `lanes` draws from them, `incidents` makes them happen."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields

from gatar_edge.errors import ConfigError
from gatar_edge.sim_sitl.incident_types import Incident
from gatar_edge.types import NS_PER_S

_DELAY_MAX_NS = 3600 * NS_PER_S
_BANDWIDTH_MIN_BYTES_S = 10


@dataclass(frozen=True, slots=True)
class Burst:
    """Losses that come together (Gilbert and Elliott): each datagram may turn the weather to bad and back."""

    enter: float  # probability that good weather turns bad
    leave: float  # probability that bad weather turns good: 1 / the mean length of a burst in datagrams
    loss: float = 1.0  # while it is bad


@dataclass(frozen=True, slots=True)
class LinkFaults:
    """One direction of one link. Probabilities are per datagram, delays are drawn evenly.

    A datagram that is not reordered never overtakes one sent before it; one that is takes its own delay. Blackouts are
    (from, to) in nanoseconds since the mission began. Raises ConfigError for what is no probability or no delay.
    """

    loss: float = 0.0
    duplicate: float = 0.0
    reorder: float = 0.0
    delay_min_ns: int = 0
    delay_max_ns: int = 0
    corrupt: float = 0.0  # one byte arrives changed
    burst: Burst | None = None
    blackouts_ns: tuple[tuple[int, int], ...] = ()
    bandwidth_bytes_s: int = 0  # 0: without limit; what waits for longer than a second is lost
    replay: float = 0.0  # somebody records it and sends it again later
    replay_after_ns: int = 10 * NS_PER_S

    @property
    def none(self) -> bool:
        """Whether everything arrives at once."""
        chances = self.loss or self.duplicate or self.reorder or self.corrupt or self.replay
        return not (chances or self.delay_max_ns or self.burst or self.blackouts_ns or self.bandwidth_bytes_s)

    def __post_init__(self) -> None:
        """Refuse what cannot be."""
        chances = {name: getattr(self, name) for name in ("loss", "duplicate", "reorder", "corrupt", "replay")}
        if self.burst is not None:
            chances |= {f"burst.{item.name}": getattr(self.burst, item.name) for item in fields(self.burst)}
        for name, value in chances.items():
            if not 0.0 <= value <= 1.0:
                raise ConfigError(f"{name} is {value}, must be 0 to 1")
        if not 0 <= self.delay_min_ns <= self.delay_max_ns <= _DELAY_MAX_NS:
            raise ConfigError(
                f"delays are {self.delay_min_ns} to {self.delay_max_ns} ns, must rise from 0 to {_DELAY_MAX_NS} at most"
            )
        if not 0 <= self.replay_after_ns <= _DELAY_MAX_NS:
            raise ConfigError(f"replay_after is {self.replay_after_ns} ns, must be 0 to {_DELAY_MAX_NS}")
        for start_ns, end_ns in self.blackouts_ns:
            if not 0 <= start_ns < end_ns:
                raise ConfigError(f"a blackout lasts from {start_ns} to {end_ns} ns, must rise from 0")
        if self.bandwidth_bytes_s and self.bandwidth_bytes_s < _BANDWIDTH_MIN_BYTES_S:
            raise ConfigError(
                f"bandwidth is {self.bandwidth_bytes_s} bytes a second, must be 0 (no limit) or "
                f"{_BANDWIDTH_MIN_BYTES_S} at least"
            )


@dataclass(frozen=True, slots=True)
class Faults:
    """All faults of a mission; times count from the end of the launch.

    `between` holds exceptions from `radio` by (sender, receiver), `links_of` those from `to_vehicle` and
    `to_companion` by robot. `kill_ns`: robot id to the time when it is gone, vehicle and all.
    """

    radio: LinkFaults = LinkFaults()
    to_vehicle: LinkFaults = LinkFaults()
    to_companion: LinkFaults = LinkFaults()
    kill_ns: Mapping[int, int] = field(default_factory=dict)
    between: Mapping[tuple[int, int], LinkFaults] = field(default_factory=dict)
    links_of: Mapping[int, tuple[LinkFaults, LinkFaults]] = field(default_factory=dict)
    incidents: tuple[Incident, ...] = ()

    def killed(self, robot_id: int, now_ns: int) -> bool:
        """Whether the robot is dead by now."""
        at_ns = self.kill_ns.get(robot_id)
        return at_ns is not None and now_ns >= at_ns

    def link_of(self, robot_id: int) -> tuple[LinkFaults, LinkFaults]:
        """(to the vehicle, to the companion) of one robot."""
        return self.links_of.get(robot_id, (self.to_vehicle, self.to_companion))

    def check(self, robot_ids: Iterable[int]) -> None:
        """Raise ConfigError where a robot is named that the team has not."""
        known = set(robot_ids)
        pairs = {robot for pair in self.between for robot in pair}
        named = pairs | set(self.kill_ns) | set(self.links_of) | {incident.robot for incident in self.incidents}
        if named - known:
            raise ConfigError(f"faults name robot {min(named - known)}, the team has {min(known)} to {max(known)}")
