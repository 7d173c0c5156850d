"""PX4's custom_mode: main << 16 | sub << 24 (px4_custom_mode.h), the same on every vehicle."""

from __future__ import annotations

MANUAL = 0x00010000
ALTITUDE = 0x00020000
POSITION = 0x00030000
TAKEOFF = 0x02040000
LOITER = 0x03040000
MISSION = 0x04040000
RTL = 0x05040000
LAND = 0x06040000
OFFBOARD = 0x00060000

MODES: dict[int, str] = {
    MANUAL: "MANUAL",
    ALTITUDE: "ALTITUDE",
    POSITION: "POSITION",
    TAKEOFF: "AUTO.TAKEOFF",
    LOITER: "AUTO.LOITER",
    MISSION: "AUTO.MISSION",
    RTL: "AUTO.RTL",
    LAND: "AUTO.LAND",
    OFFBOARD: "OFFBOARD",
}
