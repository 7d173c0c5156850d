"""What a vehicle's GPS tells it, apart from where it is."""

from __future__ import annotations

from dataclasses import dataclass

from gatar_edge.sim_sitl.vehicle import Body


@dataclass(frozen=True, slots=True)
class Positioning:
    """The state of the GPS. All that the autopilot knows and steers by is off by (`east_m`, `north_m`)."""

    lost: bool = False
    frozen: tuple[float, float] | None = None  # the place that is told instead, metres from home
    east_m: float = 0.0
    north_m: float = 0.0

    def told(self, body: Body) -> tuple[float, float]:
        """The place that telemetry tells, metres east and north of home."""
        return self.frozen if self.frozen is not None else (body.east_m, body.north_m)

    def really(self, east_m: float, north_m: float) -> tuple[float, float]:
        """Where the vehicle really is when it believes to be at this place."""
        return east_m - self.east_m, north_m - self.north_m


WORKING = Positioning()
