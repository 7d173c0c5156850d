"""What a vehicle does when its companion dies: a pure function of its parameters and mode.

The outcomes were measured on ArduCopter and ArduRover 4.6.2 and PX4 of August 2025 (docs/failsafe.md). Nothing resumes
by itself when heartbeats return. ArduPilot watches one system id and only once that was heard; a companion is a
component of its vehicle, so it is watched where that id is the vehicle's own. PX4 counts heartbeats of type GCS alone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from gatar_edge.bridge.profiles.base import Profile
from gatar_edge.bridge.profiles.px4_modes import OFFBOARD

Parameters = Mapping[str, float]

_ARDUPILOT_NAMES = ("SYSID_MYGCS", "MAV_GCS_SYSID", "MAV_GCS_SYSID_HI", "FS_GCS_ENABLE", "FS_GCS_TIMEOUT")
_GCS_TIMEOUT_S = 5.0  # where the firmware has no FS_GCS_TIMEOUT
_NOTICES_AFTER_S = 1.5  # FS_TIMEOUT's default: a rover waits this much longer
_COPTER_ACTS = {
    1: "returns to launch",
    2: "returns to launch",
    3: "returns to launch by SMART_RTL",
    4: "returns by SMART_RTL or lands",
    5: "lands where it is",
    6: "lands by DO_LAND_START or returns to launch",
    7: "brakes and stands in the air",
}
_ROVER_ACTS = {
    1: "returns to launch",
    2: "stops in HOLD",
    3: "returns to launch by SMART_RTL",
    4: "returns by SMART_RTL or stops in HOLD",
    5: "disarms",
}
_OFFBOARD_ACTS = {3: "returns to launch", 4: "lands where it is", 6: "terminates the flight", 7: "disarms"}
_CONTINUE_IN_AUTO = 2  # bit of FS_OPTIONS


@dataclass(frozen=True, slots=True)
class Outcome:
    """What happens: `after_s` seconds after the last heartbeat `acts`, or, with `after_s` None, it `acts` unwatched."""

    acts: str
    because: str  # the parameters that make it so
    after_s: float | None = None
    mend: str = ""  # what would make it watched

    @property
    def watched(self) -> bool:
        """Whether a failsafe notices."""
        return self.after_s is not None

    @property
    def text(self) -> str:
        """One clause."""
        when = f"after {self.after_s:g} s" if self.after_s is not None else "for ever"
        return f"it {self.acts} {when} ({self.because})"


@dataclass(frozen=True, slots=True)
class Situation:
    """In which mode the vehicle is, and who its companion is."""

    profile: Profile
    mode: int
    companion_sysid: int

    @property
    def goes_on(self) -> str:
        """What it does where nobody notices."""
        profile = self.profile
        if self.mode == profile.mission_mode:
            return "finishes its mission and then stands unwatched"
        if self.mode == profile.guided_mode:
            return "goes to its last target and holds there"
        return f"stays in {profile.mode_name(self.mode)}"


def _ardupilot(p: Parameters, at: Situation, acts: Callable[[Parameters, Situation], tuple[str, float]]) -> Outcome:
    """`acts` says what the failsafe does and after how long, "" for nothing."""
    enable, watched = p.get("FS_GCS_ENABLE"), p.get("SYSID_MYGCS", p.get("MAV_GCS_SYSID"))
    name = "SYSID_MYGCS" if "SYSID_MYGCS" in p else "MAV_GCS_SYSID"
    mend = f"set FS_GCS_ENABLE and {name}={at.companion_sysid}, so that the companion is the one that is watched"
    if enable is None or watched is None:
        return Outcome(at.goes_on, "as far as is known: FS_GCS_ENABLE could not be read", mend="try again")
    if enable == 0:
        return Outcome(at.goes_on, "FS_GCS_ENABLE=0", mend=mend)
    high = p.get("MAV_GCS_SYSID_HI", 0)
    if high > watched:
        because = f"MAV_GCS_SYSID_HI={high:g}: one system from {watched:g} on that is heard will do"
        mend = f"set {name}={at.companion_sysid} and MAV_GCS_SYSID_HI=0, so that the companion alone is watched"
        return Outcome(at.goes_on, because, mend=mend)
    if watched != at.companion_sysid:
        because = f"{name}={watched:g} is watched, not the companion's {at.companion_sysid}"
        return Outcome(at.goes_on, because, mend=mend)
    does, after_s = acts(p, at)
    because = f"FS_GCS_ENABLE={enable:g}"
    return Outcome(does, because, after_s) if does else Outcome(at.goes_on, because + ", without an action", mend=mend)


def _copter_acts(p: Parameters, at: Situation) -> tuple[str, float]:
    excepted = at.mode == at.profile.mission_mode and int(p.get("FS_OPTIONS", 0)) & _CONTINUE_IN_AUTO
    acts = "" if excepted else _COPTER_ACTS.get(int(p["FS_GCS_ENABLE"]), _COPTER_ACTS[1])
    return acts, p.get("FS_GCS_TIMEOUT", _GCS_TIMEOUT_S)


def _rover_acts(p: Parameters, at: Situation) -> tuple[str, float]:
    in_mission = at.mode == at.profile.mission_mode
    # measured: while the radio's failsafe is on, it is that one that acts, and 2 is no exception
    excepted = in_mission and p["FS_GCS_ENABLE"] == 2 and p.get("FS_THR_ENABLE") != 1
    acts = "" if excepted else _ROVER_ACTS.get(int(p.get("FS_ACTION", 0)), "")
    return acts, p.get("FS_GCS_TIMEOUT", _GCS_TIMEOUT_S) + p.get("FS_TIMEOUT", _NOTICES_AFTER_S)


def _px4(p: Parameters, at: Situation) -> Outcome:
    if at.mode == OFFBOARD:
        action = int(p.get("COM_OBL_RC_ACT", 0))
        acts = _OFFBOARD_ACTS.get(action, "leaves OFFBOARD and holds")
        return Outcome(acts, f"COM_OBL_RC_ACT={action}", p.get("COM_OF_LOSS_T", 1.0))
    because = f"NAV_DLL_ACT={p.get('NAV_DLL_ACT', 0):g} counts a ground station's heartbeats, never a companion's"
    mend = (
        "no parameter can watch a companion: keep a ground station with NAV_DLL_ACT=2, and a pilot with a transmitter"
    )
    return Outcome(at.goes_on, because, mend=mend)


@dataclass(frozen=True, slots=True)
class _Stack:
    names: tuple[str, ...]
    outcome: Callable[[Parameters, Situation], Outcome]


_PX4 = _Stack(("NAV_DLL_ACT", "COM_OF_LOSS_T", "COM_OBL_RC_ACT"), _px4)
_STACKS: dict[str, _Stack] = {
    "ardupilot-copter": _Stack((*_ARDUPILOT_NAMES, "FS_OPTIONS"), lambda p, at: _ardupilot(p, at, _copter_acts)),
    "ardupilot-rover": _Stack(
        (*_ARDUPILOT_NAMES, "FS_ACTION", "FS_TIMEOUT", "FS_THR_ENABLE"), lambda p, at: _ardupilot(p, at, _rover_acts)
    ),
    "px4-copter": _PX4,
    "px4-rover": _PX4,
}


def loss_parameters(profile: Profile) -> tuple[str, ...]:
    """The parameters that decide it on this stack; firmware of another age lacks some."""
    return _STACKS[profile.name].names


def companion_loss(parameters: Parameters, situation: Situation) -> Outcome:
    """What happens when the companion falls silent now, the vehicle being armed and under way."""
    return _STACKS[situation.profile.name].outcome(parameters, situation)
