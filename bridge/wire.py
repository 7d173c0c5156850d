"""The MAVLink messages in use, as frozen values: state machines speak these, `codec` alone turns them into bytes.

Units are MAVLink's own, in the names: `_e7` 1e-7 degree, `_mm`, `_cm_s`, `_cdeg`. `to` and `target` are
(sysid, compid).
"""

from __future__ import annotations

import math

import msgspec

from gatar_edge.bridge.dialect import ARMED_FLAG, NO_MISSION

Address = tuple[int, int]


class Heartbeat(msgspec.Struct, frozen=True):
    """HEARTBEAT (0)."""

    type: int
    autopilot: int
    base_mode: int
    custom_mode: int
    system_status: int

    @property
    def armed(self) -> bool:
        """Whether the motors may turn."""
        return bool(self.base_mode & ARMED_FLAG)


class SysStatus(msgspec.Struct, frozen=True):
    """SYS_STATUS (1): what of it is used."""

    battery_percent: int


class GlobalPosition(msgspec.Struct, frozen=True):
    """GLOBAL_POSITION_INT (33)."""

    lat_e7: int
    lon_e7: int
    alt_amsl_mm: int
    alt_rel_mm: int
    north_cm_s: int
    east_cm_s: int
    heading_cdeg: int


class HomePosition(msgspec.Struct, frozen=True):
    """HOME_POSITION (242)."""

    lat_e7: int
    lon_e7: int
    alt_amsl_mm: int


class GlobalOrigin(msgspec.Struct, frozen=True):
    """GPS_GLOBAL_ORIGIN (49): where the vehicle's local frame begins."""

    lat_e7: int
    lon_e7: int
    alt_amsl_mm: int


class SetGlobalOrigin(msgspec.Struct, frozen=True):
    """SET_GPS_GLOBAL_ORIGIN (48); answered by a GPS_GLOBAL_ORIGIN where it was taken."""

    sysid: int
    lat_e7: int
    lon_e7: int
    alt_amsl_mm: int


class GpsRaw(msgspec.Struct, frozen=True):
    """GPS_RAW_INT (24): what of it is used. `fix_type` is a GPS_FIX_TYPE: 3 and above is a position in space."""

    fix_type: int
    satellites: int


class SystemTime(msgspec.Struct, frozen=True):
    """SYSTEM_TIME (2): microseconds since 1970, 0 where the vehicle does not know the time of day."""

    unix_us: int


class TimeSync(msgspec.Struct, frozen=True):
    """TIMESYNC (111): `tc1` is 0 in a request, and the answerer's clock in an answer; `ts1` comes back as it was sent.

    Both in nanoseconds. An answer does not say whom it answers: only its `ts1` does.
    """

    tc1: int
    ts1: int


class AutopilotVersion(msgspec.Struct, frozen=True):
    """AUTOPILOT_VERSION (148): `version` is major << 24 | minor << 16 | patch << 8 | kind of release."""

    capabilities: int
    version: int


class ParamRead(msgspec.Struct, frozen=True):
    """PARAM_REQUEST_READ (20), by name."""

    target: Address
    name: str


class ParamValue(msgspec.Struct, frozen=True):
    """PARAM_VALUE (22): `raw` are the value's four bytes as they came, `type` a MAV_PARAM_TYPE."""

    name: str
    raw: bytes
    type: int


class ExtendedSysState(msgspec.Struct, frozen=True):
    """EXTENDED_SYS_STATE (245)."""

    landed_state: int


class PositionTarget(msgspec.Struct, frozen=True):
    """POSITION_TARGET_GLOBAL_INT (87): where the vehicle itself says it is going."""

    lat_e7: int
    lon_e7: int
    alt_m: float


class StatusText(msgspec.Struct, frozen=True):
    """STATUSTEXT (253)."""

    severity: int
    text: str


class CommandAck(msgspec.Struct, frozen=True):
    """COMMAND_ACK (77)."""

    command: int
    result: int
    target: Address


class CommandLong(msgspec.Struct, frozen=True):
    """COMMAND_LONG (76)."""

    to: Address
    command: int
    params: tuple[float, float, float, float, float, float, float]


class CommandInt(msgspec.Struct, frozen=True):
    """COMMAND_INT (75)."""

    to: Address
    frame: int
    command: int
    params: tuple[float, float, float, float]
    lat_e7: int
    lon_e7: int
    alt_m: float


class SetPositionTarget(msgspec.Struct, frozen=True):
    """SET_POSITION_TARGET_GLOBAL_INT (86), a position alone: never acknowledged. `type_mask` says what to ignore."""

    to: Address
    frame: int
    type_mask: int
    lat_e7: int
    lon_e7: int
    alt_m: float


class MissionCount(msgspec.Struct, frozen=True):
    """MISSION_COUNT (44)."""

    target: Address
    count: int
    mission_type: int = 0


class MissionRequest(msgspec.Struct, frozen=True):
    """MISSION_REQUEST (40) or MISSION_REQUEST_INT (51) received; only the latter is ever sent."""

    target: Address
    seq: int
    mission_type: int = 0


class MissionItem(msgspec.Struct, frozen=True):
    """What a mission holds at one place, without its place: a MISSION_ITEM_INT (73) less its addressing."""

    frame: int
    command: int
    params: tuple[float, float, float, float]
    lat_e7: int
    lon_e7: int
    alt_m: float


class MissionItemAt(msgspec.Struct, frozen=True):
    """MISSION_ITEM_INT (73), sent or received."""

    target: Address
    seq: int
    item: MissionItem
    mission_type: int = 0


class MissionAck(msgspec.Struct, frozen=True):
    """MISSION_ACK (47)."""

    target: Address
    result: int
    mission_type: int = 0


class MissionRequestList(msgspec.Struct, frozen=True):
    """MISSION_REQUEST_LIST (43)."""

    target: Address
    mission_type: int = 0


class MissionClearAll(msgspec.Struct, frozen=True):
    """MISSION_CLEAR_ALL (45)."""

    target: Address
    mission_type: int = 0


class MissionSetCurrent(msgspec.Struct, frozen=True):
    """MISSION_SET_CURRENT (41)."""

    target: Address
    seq: int


class MissionCurrent(msgspec.Struct, frozen=True):
    """MISSION_CURRENT (42). `total` is 0 or 65535 where the vehicle has no mission, or does not say."""

    seq: int
    total: int
    state: int

    def may_be(self, count: int) -> bool:
        """Whether the mission on board may have `count` items. The state alone tells nothing: on PX4 it comes late."""
        untold = self.total in (0, 65535) and self.state != NO_MISSION
        return untold or self.total == count


Message = (
    Heartbeat
    | SysStatus
    | GlobalPosition
    | HomePosition
    | GlobalOrigin
    | SetGlobalOrigin
    | GpsRaw
    | SystemTime
    | TimeSync
    | AutopilotVersion
    | ParamRead
    | ParamValue
    | ExtendedSysState
    | PositionTarget
    | StatusText
    | CommandAck
    | CommandLong
    | CommandInt
    | SetPositionTarget
    | MissionCount
    | MissionRequest
    | MissionItemAt
    | MissionAck
    | MissionRequestList
    | MissionClearAll
    | MissionSetCurrent
    | MissionCurrent
)


class Received(msgspec.Struct, frozen=True):
    """One frame from the wire: who sent it, its bytes without a signature, and its meaning if it is one in use."""

    source: Address
    seq: int
    message_id: int
    raw: bytes
    message: Message | None
    signed: bool = False


def sendable(item: MissionItem) -> bool:
    """Whether an item is finite (NaN is allowed for yaw alone) and fits its fields, so that `encode` cannot fail."""
    return (
        abs(item.lat_e7) <= 900_000_000
        and abs(item.lon_e7) <= 1_800_000_000
        and abs(item.alt_m) < 1e6
        and all(abs(p) < 1e9 for p in item.params[:3])
        and (math.isnan(item.params[3]) or abs(item.params[3]) < 1e9)
    )
