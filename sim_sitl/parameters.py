"""Parameters of the simulated autopilots: a small, truthful set. Each one listed here is obeyed or is a plain fact."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass

INT8, INT16, INT32, REAL32 = 2, 4, 6, 9
_BITS = {INT8: 8, INT16: 16, INT32: 32}


@dataclass(frozen=True, slots=True)
class Parameter:
    """A value and its MAV_PARAM_TYPE."""

    value: float
    type: int


Defaults = dict[str, Parameter]


def _whole(width: int, **values: int) -> Defaults:
    return {name: Parameter(float(value), width) for name, value in values.items()}


def _real(**values: float) -> Defaults:
    return {name: Parameter(value, REAL32) for name, value in values.items()}


_ARDUPILOT: Defaults = {
    **_whole(INT16, SYSID_THISMAV=1, SYSID_MYGCS=255),
    **_whole(INT8, SYSID_ENFORCE=0, FS_GCS_ENABLE=0, FENCE_ENABLE=0, MIS_RESTART=0),
    **_whole(INT16, MIS_TOTAL=0),
    **_whole(INT32, FS_OPTIONS=0),
    **_real(FS_GCS_TIMEOUT=5.0, FENCE_RADIUS=300.0, FENCE_MARGIN=2.0, FENCE_ALT_MAX=100.0),
}
ARDUCOPTER: Defaults = {
    **_ARDUPILOT,
    **_whole(INT8, FENCE_TYPE=7, DISARM_DELAY=10),
    **_real(FENCE_ACTION=1.0),  # a float on Copter, an integer on Rover, as measured
    **_real(WPNAV_SPEED=500.0, WPNAV_RADIUS=200.0, WPNAV_SPEED_UP=250.0, WPNAV_SPEED_DN=150.0, WPNAV_ACCEL=250.0),
    **_real(RTL_ALT=1500.0, RTL_SPEED=0.0, LAND_SPEED=50.0, GUID_TIMEOUT=3.0),
}
ARDUROVER: Defaults = {
    **_ARDUPILOT,
    **_whole(INT8, FENCE_TYPE=6, FENCE_ACTION=1, FS_ACTION=2, FS_THR_ENABLE=1, MIS_DONE_BEHAVE=0),
    **_real(WP_SPEED=5.0, WP_RADIUS=2.0, FS_TIMEOUT=1.5, CRUISE_SPEED=5.0, RTL_SPEED=0.0, GUID_TIMEOUT=3.0),
}
PX4: Defaults = {
    **_whole(INT32, MAV_SYS_ID=1, SYS_AUTOSTART=10040, NAV_DLL_ACT=0, COM_DL_LOSS_T=10, COM_DLL_EXCEPT=0),
    **_whole(INT32, COM_OBL_RC_ACT=0, COM_RC_IN_MODE=1, NAV_RCL_ACT=2, GF_ACTION=2),
    **_real(COM_OF_LOSS_T=1.0, COM_FAIL_ACT_T=5.0, COM_DISARM_PRFLT=10.0, COM_DISARM_LAND=2.0, NAV_ACC_RAD=2.0),
    **_real(MIS_TAKEOFF_ALT=2.5, RTL_RETURN_ALT=60.0, MPC_XY_CRUISE=5.0, MPC_Z_VEL_MAX_UP=2.5, MPC_LAND_SPEED=0.7),
}


class ParameterStore:
    """The parameters of one vehicle by name, in the order of their index."""

    def __init__(self, defaults: Defaults, bytewise: bool) -> None:
        self._values = dict(sorted(defaults.items()))
        self._names = list(self._values)
        self._bytewise = bytewise  # PX4 sends the bits of an integer, ArduPilot converts it to float

    def __len__(self) -> int:
        return len(self._names)

    def __getitem__(self, name: str) -> float:
        return self._values[name].value

    def __contains__(self, name: str) -> bool:
        return name in self._values

    def get(self, name: str, default: float = 0.0) -> float:
        """The value, or `default` where this stack has no such parameter."""
        known = self._values.get(name)
        return default if known is None else known.value

    def put(self, name: str, value: float) -> None:
        """Set a parameter that exists, as the vehicle itself does."""
        self._values[name] = Parameter(_fit(value, self._values[name].type), self._values[name].type)

    def name_of(self, index: int) -> str | None:
        """The name at an index, None outside."""
        return self._names[index] if 0 <= index < len(self._names) else None

    def index_of(self, name: str) -> int:
        """The index of a parameter that exists."""
        return self._names.index(name)

    def type_of(self, name: str) -> int:
        """MAV_PARAM_TYPE of a parameter that exists."""
        return self._values[name].type

    def to_wire(self, name: str) -> float:
        """The float that PARAM_VALUE carries."""
        parameter = self._values[name]
        if self._bytewise and parameter.type != REAL32:
            return float(struct.unpack("<f", struct.pack("<i", int(parameter.value)))[0])
        return parameter.value

    def set_from_wire(self, name: str, wire: float) -> bool:
        """Take the float of a PARAM_SET; False where it is unknown or no finite number."""
        if name not in self._values:
            return False
        kind = self._values[name].type
        value = wire
        if self._bytewise and kind != REAL32:
            value = float(struct.unpack("<i", struct.pack("<f", wire))[0])
        if not math.isfinite(value):
            return False
        self._values[name] = Parameter(_fit(value, kind), kind)
        return True


def _fit(value: float, kind: int) -> float:
    if kind == REAL32:
        return value
    limit = 1 << (_BITS[kind] - 1)
    return float(max(-limit, min(limit - 1, round(value))))
