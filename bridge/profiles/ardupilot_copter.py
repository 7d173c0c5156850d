"""ArduPilot Copter."""

from __future__ import annotations

from types import MappingProxyType

from gatar_edge.bridge.dialect import AUTOPILOT_ARDUPILOT, Frame
from gatar_edge.bridge.profiles.base import HoldBy, Profile, SetCurrent, Takeoff
from gatar_edge.types import RobotKind

_STABILIZE, _ALT_HOLD, _AUTO, _GUIDED, _LOITER, _RTL, _LAND = 0, 2, 3, 4, 5, 6, 9

PROFILE = Profile(
    name="ardupilot-copter",
    kind=RobotKind.UAV,
    autopilot=AUTOPILOT_ARDUPILOT,
    vehicle_types=frozenset({2, 3, 4, 13, 14, 15, 29, 35}),  # quad, coaxial, helicopter, hexa, octo, tri, dodeca, deca
    modes=MappingProxyType(
        {
            _STABILIZE: "STABILIZE",
            1: "ACRO",
            _ALT_HOLD: "ALT_HOLD",
            _AUTO: "AUTO",
            _GUIDED: "GUIDED",
            _LOITER: "LOITER",
            _RTL: "RTL",
            7: "CIRCLE",
            _LAND: "LAND",
            16: "POSHOLD",
            17: "BRAKE",
            20: "GUIDED_NOGPS",
            21: "SMART_RTL",
        }
    ),
    first_item_seq=1,
    yaw_param=0.0,  # NaN is refused with INVALID_PARAM1
    atomic_upload=False,  # COUNT truncates at once
    item_frame=Frame.GLOBAL_RELATIVE_ALT_INT,
    item_read_back_frames=frozenset({Frame.GLOBAL_RELATIVE_ALT_INT, Frame.GLOBAL_RELATIVE_ALT}),
    set_current=SetCurrent.COMMAND_WITH_RESET,
    mission_capacity=650,
    mission_end=None,
    guided_radius=None,
    bytewise_parameters=False,
    guided_mode=_GUIDED,
    mission_mode=_AUTO,
    hold_mode=_GUIDED,
    return_mode=_RTL,
    arm_modes=frozenset({_GUIDED}),  # not armable in AUTO; in STABILIZE it could not take off
    own_transitions=frozenset(),
    hold_by=HoldBy.REPOSITION,
    takeoff=Takeoff.NAV_RELATIVE,
    reposition_frame=Frame.GLOBAL_RELATIVE_ALT_INT,
    reposition_amsl=False,
    position_type_mask=0x0DF8,
    position_frame=Frame.GLOBAL_RELATIVE_ALT_INT,
)
