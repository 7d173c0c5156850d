"""The numbers of MAVLink's common.xml in use, under its own names."""

from __future__ import annotations

from enum import IntEnum


class MissionResult(IntEnum):
    """MAV_MISSION_RESULT of common.xml."""

    ACCEPTED = 0
    ERROR = 1
    UNSUPPORTED_FRAME = 2
    UNSUPPORTED = 3
    NO_SPACE = 4
    INVALID = 5
    INVALID_PARAM1 = 6
    INVALID_PARAM2 = 7
    INVALID_PARAM3 = 8
    INVALID_PARAM4 = 9
    INVALID_PARAM5_X = 10
    INVALID_PARAM6_Y = 11
    INVALID_PARAM7 = 12
    INVALID_SEQUENCE = 13
    DENIED = 14
    OPERATION_CANCELLED = 15


class CommandResult(IntEnum):
    """MAV_RESULT of common.xml, and what only the sender knows: nobody answered."""

    ACCEPTED = 0
    TEMPORARILY_REJECTED = 1
    DENIED = 2
    UNSUPPORTED = 3
    FAILED = 4
    IN_PROGRESS = 5
    CANCELLED = 6
    COMMAND_LONG_ONLY = 7
    COMMAND_INT_ONLY = 8
    UNSUPPORTED_FRAME = 9
    NO_ANSWER = 255


class MessageId(IntEnum):
    """The messages that the bridge asks a vehicle for."""

    SYS_STATUS = 1
    SYSTEM_TIME = 2
    GPS_RAW_INT = 24
    GLOBAL_POSITION_INT = 33
    MISSION_CURRENT = 42
    GPS_GLOBAL_ORIGIN = 49
    POSITION_TARGET_GLOBAL_INT = 87
    AUTOPILOT_VERSION = 148
    HOME_POSITION = 242
    EXTENDED_SYS_STATE = 245
    SETUP_SIGNING = 256


class Command(IntEnum):
    """The MAV_CMDs in use."""

    NAV_WAYPOINT = 16
    NAV_TAKEOFF = 22
    DO_SET_MODE = 176
    DO_CHANGE_SPEED = 178
    DO_REPOSITION = 192
    DO_SET_MISSION_CURRENT = 224
    COMPONENT_ARM_DISARM = 400
    SET_MESSAGE_INTERVAL = 511
    REQUEST_MESSAGE = 512


class Frame(IntEnum):
    """The MAV_FRAMEs in use."""

    GLOBAL = 0  # altitude above mean sea level
    GLOBAL_RELATIVE_ALT = 3
    GLOBAL_INT = 5
    GLOBAL_RELATIVE_ALT_INT = 6  # altitude above home


ARMED_FLAG = 128  # MAV_MODE_FLAG_SAFETY_ARMED
CUSTOM_MODE_FLAG = 1  # MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
LANDED_ON_GROUND = 1  # MAV_LANDED_STATE_ON_GROUND
NO_MISSION, MISSION_COMPLETE = 1, 5  # MISSION_STATE
STATE_ACTIVE = 4  # MAV_STATE
STATE_CRITICAL = 5
TYPE_GCS = 6  # MAV_TYPE
TYPE_ONBOARD_CONTROLLER = 18
AUTOPILOT_INVALID = 8  # MAV_AUTOPILOT: not an autopilot
AUTOPILOT_ARDUPILOT = 3
AUTOPILOT_PX4 = 12
