"""PX4 multicopter."""

from __future__ import annotations

import math
from types import MappingProxyType

from gatar_edge.bridge.dialect import AUTOPILOT_PX4, Frame
from gatar_edge.bridge.profiles.base import HoldBy, Profile, SetCurrent, Takeoff
from gatar_edge.bridge.profiles.px4_modes import LOITER, MISSION, MODES, RTL, TAKEOFF
from gatar_edge.types import RobotKind

PROFILE = Profile(
    name="px4-copter",
    kind=RobotKind.UAV,
    autopilot=AUTOPILOT_PX4,
    vehicle_types=frozenset({2, 3, 4, 13, 14, 15, 29, 35}),
    modes=MappingProxyType(MODES),
    first_item_seq=0,
    yaw_param=math.nan,
    atomic_upload=True,
    item_frame=Frame.GLOBAL_RELATIVE_ALT_INT,
    item_read_back_frames=frozenset({Frame.GLOBAL_RELATIVE_ALT_INT, Frame.GLOBAL_RELATIVE_ALT}),
    set_current=SetCurrent.MESSAGE_AFTER_TOTAL,
    mission_capacity=10000,
    mission_end=None,
    guided_radius=None,
    bytewise_parameters=True,
    guided_mode=LOITER,  # DO_REPOSITION needs neither OFFBOARD nor a stream of setpoints
    mission_mode=MISSION,
    hold_mode=LOITER,
    return_mode=RTL,
    arm_modes=frozenset({LOITER, TAKEOFF}),
    own_transitions=frozenset({(TAKEOFF, LOITER), (LOITER, TAKEOFF), (MISSION, LOITER)}),
    hold_by=HoldBy.REPOSITION,
    takeoff=Takeoff.NAV_AMSL,
    reposition_frame=Frame.GLOBAL,  # the frame is ignored: frame 6 with z = 10 flew it into the ground
    reposition_amsl=True,
    position_type_mask=0x0DF8,
    position_frame=None,
)
