"""Making declared incidents happen to vehicles, each at its time. The fleet does the rest: what befalls companions."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from gatar_edge.errors import ConfigError
from gatar_edge.sim_sitl.autopilot import SimAutopilot
from gatar_edge.sim_sitl.core import Core
from gatar_edge.sim_sitl.incident_types import (
    Battery,
    GpsFreeze,
    GpsJump,
    GpsLoss,
    Incident,
    Passing,
    PilotMode,
    Reboot,
)
from gatar_edge.sim_sitl.modes import Mode
from gatar_edge.types import NS_PER_S


@dataclass(frozen=True, slots=True)
class Turn:
    """An incident that begins, or one that is over."""

    at_ns: int
    incident: Incident
    over: bool = False

    @property
    def text(self) -> str:
        """For the log."""
        return f"scenario: {type(self.incident).__struct_config__.tag}{' is over' if self.over else ''}"


class Script:
    """All turns of a mission in order of time; checked against the vehicles when it is made."""

    def __init__(self, incidents: tuple[Incident, ...], vehicles: Mapping[int, SimAutopilot]) -> None:
        """Raises ConfigError for a robot or a mode that does not exist."""
        for incident in incidents:
            if incident.robot not in vehicles:
                raise ConfigError(f"event at {incident.at_s:g} s: there is no robot {incident.robot}")
            if isinstance(incident, PilotMode):
                find_mode(vehicles[incident.robot], incident.mode)
        turns = [turn for incident in incidents for turn in _turns(incident)]
        self._turns = sorted(turns, key=lambda turn: turn.at_ns)
        self._next = 0

    def due(self, elapsed_ns: int) -> list[Turn]:
        """What happens up to now, since the last call; `elapsed_ns` counts from the beginning of the mission."""
        first = self._next
        while self._next < len(self._turns) and self._turns[self._next].at_ns <= elapsed_ns:
            self._next += 1
        return self._turns[first : self._next]


def _turns(incident: Incident) -> list[Turn]:
    at_ns = int(incident.at_s * NS_PER_S)
    turns = [Turn(at_ns, incident)]
    if isinstance(incident, Passing) and incident.for_s > 0:
        turns.append(Turn(at_ns + int(incident.for_s * NS_PER_S), incident, over=True))
    return turns


def find_mode(vehicle: SimAutopilot, name: str) -> Mode:
    """A mode by its name; PX4's AUTO modes also without AUTO. Raises ConfigError."""
    for mode in vehicle.modes:
        if name.upper() in (mode.name, mode.name.removeprefix("AUTO.")):
            return mode
    known = ", ".join(mode.name for mode in vehicle.modes)
    raise ConfigError(f"{vehicle.config.stack} {vehicle.config.vehicle} has no mode {name!r}: {known}")


def happen(turn: Turn, vehicle: SimAutopilot, now_ns: int) -> None:
    """Let a turn happen to its vehicle; what befalls companions only changes nothing here."""
    incident = turn.incident
    if isinstance(incident, Reboot):
        vehicle.reboot(now_ns)
    elif isinstance(incident, PilotMode):
        mode = find_mode(vehicle, incident.mode)
        vehicle.suffer(lambda core: core.enter(mode))
    elif isinstance(incident, Battery):
        charge = incident.percent / 100
        vehicle.suffer(lambda core: core.discharge(charge))
    elif isinstance(incident, GpsLoss | GpsFreeze | GpsJump):
        act = _GPS[type(incident)]
        vehicle.suffer(lambda core: act(core, incident, turn.over))


def _lose(core: Core, incident: Incident, over: bool) -> None:
    core.gps = replace(core.gps, lost=not over)
    core.ready = False  # and becomes so again when the fix is back


def _freeze(core: Core, incident: Incident, over: bool) -> None:
    core.gps = replace(core.gps, frozen=None if over else core.gps.told(core.body))


def _jump(core: Core, incident: Incident, over: bool) -> None:
    assert isinstance(incident, GpsJump)
    sign = -1.0 if over else 1.0
    core.mislead(sign * incident.east_m, sign * incident.north_m)


_GPS: dict[type, Callable[[Core, Incident, bool], None]] = {GpsLoss: _lose, GpsFreeze: _freeze, GpsJump: _jump}
