"""The vehicle's own fence, as its parameters tell: what it may forbid, mostly in silence, that our own gate allows."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from gatar_edge.bridge.profiles.base import Profile

_ALT_MAX, _CIRCLE, _POLYGON = 1, 2, 4  # bits of FENCE_TYPE
_ARDUPILOT = ("FENCE_ENABLE", "FENCE_TYPE", "FENCE_ACTION", "FENCE_RADIUS", "FENCE_MARGIN", "FENCE_ALT_MAX")
_COPTER = (*_ARDUPILOT, "FENCE_AUTOENABLE")  # a rover has none
_PX4 = ("GF_ACTION", "GF_MAX_HOR_DIST", "GF_MAX_VER_DIST")
_ROVER_STOPS_BEFORE_M = 1.0  # besides the margin: at 47 m of 50, as measured


@dataclass(frozen=True, slots=True)
class OwnFence:
    """A circle round home and a ceiling; infinite where there is none."""

    on: bool
    radius_m: float = math.inf  # as far as it lets the vehicle go
    ceiling_m: float = math.inf
    polygon: bool = False  # one may be stored on board as well
    says: str = ""  # the parameters


def _of_ardupilot(p: Mapping[str, float], *, flies: bool) -> OwnFence | None:
    if "FENCE_ENABLE" not in p:
        return None
    itself = p.get("FENCE_AUTOENABLE", 0.0)  # off on the ground, and on as soon as it is armed or flies
    if not p["FENCE_ENABLE"] and not itself:
        return OwnFence(False, says="FENCE_ENABLE=0")
    kinds = int(p.get("FENCE_TYPE", _CIRCLE | _ALT_MAX))
    before_m = 0.0 if flies else p.get("FENCE_MARGIN", 2.0) + _ROVER_STOPS_BEFORE_M
    return OwnFence(
        True,
        p.get("FENCE_RADIUS", math.inf) - before_m if kinds & _CIRCLE else math.inf,
        p.get("FENCE_ALT_MAX", math.inf) if kinds & _ALT_MAX and flies else math.inf,
        bool(kinds & _POLYGON),
        f"{f'FENCE_AUTOENABLE={itself:g}, ' if itself else ''}FENCE_TYPE={kinds}, "
        f"FENCE_ACTION={p.get('FENCE_ACTION', 0):g}",
    )


def _of_px4(p: Mapping[str, float]) -> OwnFence | None:
    if "GF_ACTION" not in p:
        return None
    return OwnFence(
        p["GF_ACTION"] > 0,
        p.get("GF_MAX_HOR_DIST") or math.inf,  # 0 is none
        p.get("GF_MAX_VER_DIST") or math.inf,
        True,
        f"GF_ACTION={p['GF_ACTION']:g}",
    )


_STACKS: dict[str, tuple[tuple[str, ...], Callable[[Mapping[str, float]], OwnFence | None]]] = {
    "ardupilot-copter": (_COPTER, lambda p: _of_ardupilot(p, flies=True)),
    "ardupilot-rover": (_ARDUPILOT, lambda p: _of_ardupilot(p, flies=False)),
    "px4-copter": (_PX4, _of_px4),
    "px4-rover": (_PX4, _of_px4),
}


def fence_parameters(profile: Profile) -> tuple[str, ...]:
    """The parameters that make the fence on this stack."""
    return _STACKS[profile.name][0]


def own_fence(parameters: Mapping[str, float], profile: Profile) -> OwnFence | None:
    """The fence, None where its parameters could not be read."""
    return _STACKS[profile.name][1](parameters)
