"""What differs between autopilot stacks, as data: one frozen value per stack, no branches on names anywhere else.

A new stack is a new file with one `Profile` and a row in the registry. Every member says where its value was measured:
ArduCopter and ArduRover 4.6.2, PX4 main of August 2025, in their own software-in-the-loop builds.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

from gatar_edge.types import RobotKind


class SetCurrent(Enum):
    """How a freshly uploaded mission is made to start at its first waypoint."""

    COMMAND_WITH_RESET = "DO_SET_MISSION_CURRENT(first, reset=1)"
    MESSAGE_AFTER_TOTAL = "MISSION_CURRENT.total == n, then MISSION_SET_CURRENT first"


class Takeoff(Enum):
    """How a vehicle gets into the air."""

    NONE = "it does not fly"
    NAV_RELATIVE = "NAV_TAKEOFF to metres above home"
    NAV_AMSL = "NAV_TAKEOFF to metres above mean sea level"


class HoldBy(Enum):
    """How a vehicle is made to stay where it is. Never by clearing its mission: ArduRover would drive on."""

    MODE = "the hold mode"
    REPOSITION = "a guided target at the present position"


@dataclass(frozen=True, slots=True)
class Profile:
    """One autopilot stack on one kind of vehicle."""

    name: str
    kind: RobotKind
    autopilot: int  # MAV_AUTOPILOT of its heartbeat
    vehicle_types: frozenset[int]  # MAV_TYPEs of its heartbeat
    modes: Mapping[int, str]  # custom_mode -> name
    # mission
    first_item_seq: int  # 1 where slot 0 is home, a placeholder
    yaw_param: float  # param4 of waypoints and repositions: NaN ("leave it") only where it is not refused
    atomic_upload: bool  # the old mission is driven until the new one is complete; else a mix of both
    item_frame: int
    item_read_back_frames: frozenset[int]  # `item_frame` may be downloaded as any of these
    set_current: SetCurrent
    mission_capacity: int  # waypoints it takes, slot 0 not counted
    mission_end: tuple[str, frozenset[int]] | None  # a parameter, and with which values the end leaves its mode to us
    guided_radius: str | None  # a parameter: it may stop this many metres before a guided target; None: it does not
    bytewise_parameters: bool  # PARAM_VALUE holds the bits of an integer; else the integer as a float
    # modes, as custom_mode
    guided_mode: int
    mission_mode: int
    hold_mode: int
    return_mode: int  # back to where it was launched
    arm_modes: frozenset[int]  # armable as it stands; elsewhere `guided_mode` is set first
    own_transitions: frozenset[tuple[int, int]]  # (from, to): mode changes that the vehicle makes by itself
    hold_by: HoldBy
    # flying
    takeoff: Takeoff
    reposition_frame: int
    reposition_amsl: bool  # z is above mean sea level, home's altitude is added
    position_type_mask: int  # SET_POSITION_TARGET_*: bits that say IGNORE
    position_frame: int | None  # of SET_POSITION_TARGET_GLOBAL_INT; None: it obeys a stream of them alone, in OFFBOARD

    def mode_name(self, custom_mode: int) -> str:
        """The mode's name, or its number where it has none here."""
        return self.modes.get(custom_mode, str(custom_mode))

    def mode_params(self, custom_mode: int) -> tuple[int, int]:
        """`custom_mode` as DO_SET_MODE's params 2 and 3: PX4 packs main << 16 | sub << 24, ArduPilot counts from 0."""
        if custom_mode < 0x10000:
            return custom_mode, 0
        return (custom_mode >> 16) & 0xFF, custom_mode >> 24
