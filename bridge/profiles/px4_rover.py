"""PX4 rover."""

from __future__ import annotations

import math
from types import MappingProxyType

from gatar_edge.bridge.dialect import AUTOPILOT_PX4, Frame
from gatar_edge.bridge.profiles.base import HoldBy, Profile, SetCurrent, Takeoff
from gatar_edge.bridge.profiles.px4_modes import LOITER, MISSION, MODES, RTL
from gatar_edge.types import RobotKind

PROFILE = Profile(
    name="px4-rover",
    kind=RobotKind.UGV,
    autopilot=AUTOPILOT_PX4,
    vehicle_types=frozenset({10, 11}),
    modes=MappingProxyType(MODES),
    first_item_seq=0,
    yaw_param=math.nan,
    atomic_upload=True,
    item_frame=Frame.GLOBAL_RELATIVE_ALT_INT,
    item_read_back_frames=frozenset({Frame.GLOBAL_RELATIVE_ALT_INT, Frame.GLOBAL_RELATIVE_ALT}),
    set_current=SetCurrent.MESSAGE_AFTER_TOTAL,  # DO_SET_MISSION_CURRENT is UNSUPPORTED
    mission_capacity=10000,
    mission_end=None,
    guided_radius=None,
    bytewise_parameters=True,
    guided_mode=LOITER,
    mission_mode=MISSION,
    hold_mode=LOITER,
    return_mode=RTL,
    arm_modes=frozenset({LOITER}),  # MANUAL needs a transmitter, on hold it arms without
    own_transitions=frozenset({(MISSION, LOITER)}),  # after its last item
    hold_by=HoldBy.MODE,
    takeoff=Takeoff.NONE,
    reposition_frame=Frame.GLOBAL,
    reposition_amsl=True,
    position_type_mask=0x0DFC,
    position_frame=None,
)
