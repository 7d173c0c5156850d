"""The latest of what one autopilot told, with the time of its arrival."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from gatar_edge.bridge import wire
from gatar_edge.bridge.dialect import MessageId
from gatar_edge.bridge.geo import geodetic_to_enu
from gatar_edge.types import NS_PER_S

NEVER = -1
ORIGIN_SILENCE_NS = 20 * NS_PER_S  # of asking once a second


@dataclass(slots=True)
class Telemetry:
    """Latest messages of one (sysid, compid); `None` and `NEVER` until the first."""

    heartbeat: wire.Heartbeat | None = None
    heartbeat_ns: int = NEVER
    position: wire.GlobalPosition | None = None
    position_ns: int = NEVER
    position_first_ns: int = NEVER
    home: wire.HomePosition | None = None
    origin: wire.GlobalOrigin | None = None
    current: wire.MissionCurrent | None = None
    current_ns: int = NEVER
    echo: wire.PositionTarget | None = None
    echo_ns: int = NEVER
    landed_state: int = 0  # MAV_LANDED_STATE_UNDEFINED
    battery_percent: int = -1

    def update(self, message: wire.Message, now_ns: int) -> None:
        """Keep a message if it tells of the vehicle's state."""
        keep = _KEEPERS.get(type(message))
        if keep is not None:
            keep(self, message, now_ns)

    def _keep_heartbeat(self, message: wire.Heartbeat, now_ns: int) -> None:
        self.heartbeat, self.heartbeat_ns = message, now_ns

    def _keep_position(self, message: wire.GlobalPosition, now_ns: int) -> None:
        if message.lat_e7 or message.lon_e7:  # (0, 0) means "no position yet"
            self.position, self.position_ns = message, now_ns
            if self.position_first_ns == NEVER:
                self.position_first_ns = now_ns

    def _keep_home(self, message: wire.HomePosition, now_ns: int) -> None:
        if message.lat_e7 or message.lon_e7:
            self.home = message

    def _keep_origin(self, message: wire.GlobalOrigin, now_ns: int) -> None:
        if message.lat_e7 or message.lon_e7:
            self.origin = message

    def _keep_current(self, message: wire.MissionCurrent, now_ns: int) -> None:
        self.current, self.current_ns = message, now_ns

    def _keep_echo(self, message: wire.PositionTarget, now_ns: int) -> None:
        self.echo, self.echo_ns = message, now_ns

    def _keep_landed_state(self, message: wire.ExtendedSysState, now_ns: int) -> None:
        self.landed_state = message.landed_state

    def _keep_battery(self, message: wire.SysStatus, now_ns: int) -> None:
        self.battery_percent = message.battery_percent

    @property
    def armed(self) -> bool:
        """Whether its motors may turn."""
        return self.heartbeat is not None and self.heartbeat.armed

    @property
    def custom_mode(self) -> int | None:
        """Its mode, as the heartbeat alone can tell."""
        return self.heartbeat.custom_mode if self.heartbeat else None

    @property
    def unknown(self) -> tuple[int, ...]:
        """Ids of the messages that are needed once and have not come."""
        if self.home is not None and self.origin is not None:
            return ()
        needed = {MessageId.HOME_POSITION: self.home, MessageId.GPS_GLOBAL_ORIGIN: self.origin}
        return tuple(message_id for message_id, value in needed.items() if value is None)

    def has_origin(self, now_ns: int) -> bool:
        """Whether its estimator has an origin: told, or shown by global positions while no answer comes.

        Not every firmware answers a request for GPS_GLOBAL_ORIGIN, but none estimates a global position without one.
        """
        shown = self.position_first_ns != NEVER and now_ns - self.position_first_ns >= ORIGIN_SILENCE_NS
        return self.origin is not None or (self.home is not None and shown)

    @property
    def lat_lon_deg(self) -> tuple[float, float] | None:
        """Its latest position."""
        return (self.position.lat_e7 / 1e7, self.position.lon_e7 / 1e7) if self.position else None

    @property
    def alt_rel_m(self) -> float:
        """Its height above home, NaN when unknown."""
        return self.position.alt_rel_mm / 1e3 if self.position else math.nan

    def distance_m(self, point_deg: tuple[float, float]) -> float:
        """Horizontal distance to (lat, lon), infinite without a position."""
        here = self.lat_lon_deg
        return math.inf if here is None else distance_m(here, point_deg)

    def echoes(self, point_deg: tuple[float, float], since_ns: int) -> bool:
        """Whether the vehicle itself has said, after `since_ns`, that it goes to (lat, lon)."""
        return self.echo is not None and self.echo_ns > since_ns and near_e7(self.echo, point_deg)


# Looked up by type: to ask whether a message is of one type after another costs several times as much.
_KEEPERS: dict[type[wire.Message], Callable[[Telemetry, Any, int], None]] = {
    wire.Heartbeat: Telemetry._keep_heartbeat,
    wire.GlobalPosition: Telemetry._keep_position,
    wire.HomePosition: Telemetry._keep_home,
    wire.GlobalOrigin: Telemetry._keep_origin,
    wire.MissionCurrent: Telemetry._keep_current,
    wire.PositionTarget: Telemetry._keep_echo,
    wire.ExtendedSysState: Telemetry._keep_landed_state,
    wire.SysStatus: Telemetry._keep_battery,
}


def near_e7(echo: wire.PositionTarget, point_deg: tuple[float, float]) -> bool:
    """Whether an echoed target is (lat, lon): measured +-1e-7 degree, 1e-6 (11 cm) allowed."""
    return abs(echo.lat_e7 - point_deg[0] * 1e7) <= 10 and abs(echo.lon_e7 - point_deg[1] * 1e7) <= 10


@lru_cache(maxsize=1024)  # asked for several times between two positions of a vehicle
def distance_m(a_deg: tuple[float, float], b_deg: tuple[float, float]) -> float:
    """Horizontal distance between two (lat, lon) pairs of one site."""
    east, north, _ = geodetic_to_enu((*b_deg, 0.0), (*a_deg, 0.0))
    return math.hypot(east, north)


class Progress:
    """Tells whether a distance keeps shrinking: at least `STEP_M` less within `timeout_ns`."""

    STEP_M = 0.5

    def __init__(self, timeout_ns: int) -> None:
        self.timeout_ns = timeout_ns
        self._best_m = math.inf
        self._best_ns = 0

    def start(self, remaining_m: float, now_ns: int) -> None:
        """Begin anew."""
        self._best_m, self._best_ns = remaining_m, now_ns

    @property
    def due_ns(self) -> int:
        """From when on an unchanged distance has stalled."""
        return self._best_ns + self.timeout_ns

    def stalled(self, remaining_m: float, now_ns: int) -> bool:
        """Take the present distance; True once it has not shrunk for too long."""
        if remaining_m <= self._best_m - self.STEP_M:
            self._best_m, self._best_ns = remaining_m, now_ns
        return now_ns - self._best_ns >= self.timeout_ns
