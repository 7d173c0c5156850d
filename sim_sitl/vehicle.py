"""How a copter and a rover move: pure kinematics in east-north-up metres from home, one function a kind."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import msgspec
from msgspec.structs import replace

Blocked = Callable[[float, float], bool]

# The speed profile plans with less than the acceleration available, so that a limited controller can follow it.
_PROFILE_MARGIN = 0.8
# A rover brakes harder than it accelerates: full stop from 5 m/s within 2.5 m.
_BRAKE_FACTOR = 2.0
_ROVER_PIVOT_RAD = math.radians(60)
_ROVER_PIVOT_SPEED_M_S = 1.2
_NO_DRAIN_S = math.inf


@dataclass(frozen=True, slots=True)
class Limits:
    """What a vehicle can do."""

    speed_m_s: float = 5.0
    acceleration_m_s2: float = 2.5
    climb_m_s: float = 2.5
    descent_m_s: float = 1.5
    turn_rad_s: float = math.radians(120)
    endurance_s: float = _NO_DRAIN_S  # of a full battery while armed


class Body(msgspec.Struct, frozen=True):
    """Where a vehicle is and how it moves; heading clockwise from north, `charge` 0 to 1."""

    east_m: float = 0.0
    north_m: float = 0.0
    up_m: float = 0.0
    east_m_s: float = 0.0
    north_m_s: float = 0.0
    up_m_s: float = 0.0
    heading_rad: float = 0.0
    charge: float = 1.0

    @property
    def speed_m_s(self) -> float:
        """Over ground."""
        return math.hypot(self.east_m_s, self.north_m_s)


@dataclass(frozen=True, slots=True)
class Goal:
    """A place to go to, and how fast to be there (0: stop)."""

    east_m: float
    north_m: float
    up_m: float
    exit_m_s: float = 0.0

    def distance_m(self, body: Body) -> float:
        """Over ground, to a body."""
        return math.hypot(self.east_m - body.east_m, self.north_m - body.north_m)


@dataclass(frozen=True, slots=True)
class Velocity:
    """A velocity to hold."""

    east_m_s: float
    north_m_s: float
    up_m_s: float


Target = Goal | Velocity | None  # None: brake and stay


def corner_speed_m_s(limits: Limits, before: Goal, corner: Goal, after: Goal) -> float:
    """How fast a rover may pass `corner` without leaving its cell: full speed straight on, none for turning back."""
    first = math.atan2(corner.east_m - before.east_m, corner.north_m - before.north_m)
    second = math.atan2(after.east_m - corner.east_m, after.north_m - corner.north_m)
    return limits.speed_m_s * float(max(0.0, math.cos(wrap_rad(second - first) / 2)) ** 3)


def wrap_rad(angle_rad: float) -> float:
    """The same angle within (-pi, pi]."""
    return math.remainder(angle_rad, math.tau)


def _toward(value: float, wanted: float, change: float) -> float:
    return min(wanted, value + change) if wanted > value else max(wanted, value - change)


def _profile(distance_m: float, exit_m_s: float, limits: Limits) -> float:
    room = 2 * _PROFILE_MARGIN * limits.acceleration_m_s2 * max(0.0, distance_m)
    return min(limits.speed_m_s, math.sqrt(exit_m_s * exit_m_s + room))


def step_copter(body: Body, limits: Limits, target: Target, dt_s: float) -> Body:
    """A copter one `dt_s` (at most about 0.2 s) later: straight to its goal, never below the ground."""
    if isinstance(target, Goal):
        east, north = target.east_m - body.east_m, target.north_m - body.north_m
        distance = math.hypot(east, north)
        speed = min(_profile(distance, target.exit_m_s, limits), distance / dt_s)
        scale = speed / distance if distance > 1e-6 else 0.0
        wanted_east, wanted_north = east * scale, north * scale
        climb = target.up_m - body.up_m
        wanted_up = max(-limits.descent_m_s, min(limits.climb_m_s, climb / max(dt_s, 0.4)))
    elif isinstance(target, Velocity):
        scale = min(1.0, limits.speed_m_s / max(1e-6, math.hypot(target.east_m_s, target.north_m_s)))
        wanted_east, wanted_north = target.east_m_s * scale, target.north_m_s * scale
        wanted_up = max(-limits.descent_m_s, min(limits.climb_m_s, target.up_m_s))
    else:
        wanted_east = wanted_north = wanted_up = 0.0
    change = limits.acceleration_m_s2 * dt_s
    delta_east, delta_north = wanted_east - body.east_m_s, wanted_north - body.north_m_s
    delta = math.hypot(delta_east, delta_north)
    share = min(1.0, change / delta) if delta > 1e-9 else 1.0
    v_east, v_north = body.east_m_s + delta_east * share, body.north_m_s + delta_north * share
    v_up = _toward(body.up_m_s, wanted_up, change)
    heading = math.atan2(v_east, v_north) if math.hypot(v_east, v_north) > 0.5 else body.heading_rad
    turn = limits.turn_rad_s * dt_s
    heading = wrap_rad(body.heading_rad + max(-turn, min(turn, wrap_rad(heading - body.heading_rad))))
    up = body.up_m + v_up * dt_s
    if up <= 0.0:
        up, v_up = 0.0, max(0.0, v_up)
    charge = max(0.0, body.charge - dt_s / limits.endurance_s)
    return Body(body.east_m + v_east * dt_s, body.north_m + v_north * dt_s, up, v_east, v_north, v_up, heading, charge)


def _rover_wish(body: Body, limits: Limits, target: Target) -> tuple[float, float]:
    """Wanted heading and speed, before the turn that is still to be made."""
    if isinstance(target, Goal):
        east, north = target.east_m - body.east_m, target.north_m - body.north_m
        distance = math.hypot(east, north)
        if distance < 0.05 and target.exit_m_s == 0.0:
            return body.heading_rad, 0.0
        return math.atan2(east, north), _profile(distance, target.exit_m_s, limits)
    if isinstance(target, Velocity):
        speed = min(limits.speed_m_s, math.hypot(target.east_m_s, target.north_m_s))
        return (math.atan2(target.east_m_s, target.north_m_s), speed) if speed > 1e-6 else (body.heading_rad, 0.0)
    return body.heading_rad, 0.0


def step_rover(body: Body, limits: Limits, target: Target, dt_s: float, blocked: Blocked) -> Body:
    """A skid-steered rover one `dt_s` later: brakes before it turns sharply, and stops in front of what is blocked."""
    speed = body.speed_m_s
    bearing, wanted = _rover_wish(body, limits, target)
    error = wrap_rad(bearing - body.heading_rad)
    sharp = abs(error) > _ROVER_PIVOT_RAD
    # Turning at speed would sweep it off its path: first slow down on the old course, then pivot.
    turn = 0.0 if sharp and speed > _ROVER_PIVOT_SPEED_M_S else limits.turn_rad_s * dt_s
    heading = wrap_rad(body.heading_rad + max(-turn, min(turn, error)))
    wanted = 0.0 if sharp else wanted * math.cos(error)
    rate = limits.acceleration_m_s2 * (_BRAKE_FACTOR if wanted < speed else 1.0)
    speed = _toward(speed, wanted, rate * dt_s)
    if isinstance(target, Goal) and target.exit_m_s == 0.0:
        speed = min(speed, target.distance_m(body) / dt_s) if not sharp else speed
    v_east, v_north = speed * math.sin(heading), speed * math.cos(heading)
    east, north = body.east_m + v_east * dt_s, body.north_m + v_north * dt_s
    charge = max(0.0, body.charge - dt_s / limits.endurance_s)
    if blocked(east, north) and not blocked(body.east_m, body.north_m):
        return replace(body, east_m_s=0.0, north_m_s=0.0, heading_rad=heading, charge=charge)
    return Body(east, north, body.up_m, v_east, v_north, 0.0, heading, charge)
