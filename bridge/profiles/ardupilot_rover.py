"""ArduPilot Rover."""

from __future__ import annotations

from types import MappingProxyType

from gatar_edge.bridge.dialect import AUTOPILOT_ARDUPILOT, Frame
from gatar_edge.bridge.profiles.base import HoldBy, Profile, SetCurrent, Takeoff
from gatar_edge.types import RobotKind

_MANUAL, _HOLD, _AUTO, _RTL, _GUIDED, _INITIALISING = 0, 4, 10, 11, 15, 16

PROFILE = Profile(
    name="ardupilot-rover",
    kind=RobotKind.UGV,
    autopilot=AUTOPILOT_ARDUPILOT,
    vehicle_types=frozenset({10, 11}),  # ground rover, surface boat
    modes=MappingProxyType(
        {
            _MANUAL: "MANUAL",
            1: "ACRO",
            3: "STEERING",
            _HOLD: "HOLD",
            5: "LOITER",
            6: "FOLLOW",
            7: "SIMPLE",
            _AUTO: "AUTO",
            _RTL: "RTL",
            12: "SMART_RTL",
            _GUIDED: "GUIDED",
            _INITIALISING: "INITIALISING",
        }
    ),
    first_item_seq=1,
    yaw_param=0.0,  # NaN is refused with INVALID_PARAM1
    atomic_upload=False,  # COUNT truncates at once
    item_frame=Frame.GLOBAL_RELATIVE_ALT_INT,
    item_read_back_frames=frozenset({Frame.GLOBAL_RELATIVE_ALT_INT, Frame.GLOBAL_RELATIVE_ALT}),
    set_current=SetCurrent.COMMAND_WITH_RESET,  # without the reset it acknowledges after completion and never moves
    mission_capacity=655,
    mission_end=("MIS_DONE_BEHAVE", frozenset({0, 1})),  # 2 and 3 go to ACRO and MANUAL, as a pilot would
    guided_radius="WP_RADIUS",  # 2 m by default; it stopped 2.1 m before one with 3
    bytewise_parameters=False,
    guided_mode=_GUIDED,
    mission_mode=_AUTO,
    hold_mode=_HOLD,
    return_mode=_RTL,
    arm_modes=frozenset({_MANUAL, _HOLD, _GUIDED}),
    own_transitions=frozenset({(_INITIALISING, _MANUAL), (_INITIALISING, _HOLD)}),
    hold_by=HoldBy.MODE,
    takeoff=Takeoff.NONE,
    reposition_frame=Frame.GLOBAL_RELATIVE_ALT_INT,
    reposition_amsl=False,
    position_type_mask=0x0DFC,
    position_frame=Frame.GLOBAL_RELATIVE_ALT_INT,
)
