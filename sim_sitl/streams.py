"""What a simulated autopilot says by itself: one table of messages, how each is filled and how often it is sent."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from gatar_edge.sim_sitl.core import Core
from gatar_edge.sim_sitl.modes import Does
from gatar_edge.sim_sitl.vehicle import Goal
from gatar_edge.sim_sitl.wire import Message

Fields = dict[str, Any]
_CELLS = [65535] * 10
_CAN_MOVE = frozenset({Does.GUIDED, Does.AUTO, Does.RETURN, Does.OFFBOARD, Does.TAKEOFF})
# MAV_SYS_STATUS_SENSOR: gyro, accelerometer, magnetometer, pressure, GPS, AHRS, battery, pre-arm check.
_SENSORS = 0x01 | 0x02 | 0x04 | 0x08 | 0x20 | 0x200000 | 0x2000000 | 0x10000000
_NEEDS_POSITION = 0x20 | 0x200000 | 0x10000000  # GPS, AHRS, and so the pre-arm check: MAVSDK's "armable"


def _position_e7(core: Core) -> tuple[int, int]:
    lat, lon = core.frame.geodetic(*core.gps.told(core.body))
    return round(lat * 1e7), round(lon * 1e7)


def _heading_cdeg(core: Core) -> int:
    return round(math.degrees(core.body.heading_rad) * 100) % 36000


def global_position_int(core: Core) -> Fields | None:
    """Position as the EKF has it; before home is set the relative altitude is the one above the sea."""
    if core.gps.lost:
        return None
    body = core.body
    lat, lon = _position_e7(core)
    alt = core.amsl_of(body.up_m)
    return {
        "time_boot_ms": core.uptime_ms, "lat": lat, "lon": lon, "alt": round(alt * 1000),
        "relative_alt": round((body.up_m - core.home.up_m if core.home_set else alt) * 1000),
        "vx": round(body.north_m_s * 100), "vy": round(body.east_m_s * 100), "vz": round(-body.up_m_s * 100),
        "hdg": _heading_cdeg(core),
    }  # fmt: skip


def local_position_ned(core: Core) -> Fields | None:
    """Relative to the origin, not to home; z down."""
    if core.gps.lost:
        return None
    body = core.body
    east_m, north_m = core.gps.told(body)
    return {
        "time_boot_ms": core.uptime_ms, "x": north_m, "y": east_m, "z": -body.up_m,
        "vx": body.north_m_s, "vy": body.east_m_s, "vz": -body.up_m_s,
    }  # fmt: skip


def attitude(core: Core) -> Fields:
    """Level, with the true heading."""
    yaw = core.body.heading_rad
    return {
        "time_boot_ms": core.uptime_ms, "roll": 0.0, "pitch": 0.0, "yaw": yaw,
        "rollspeed": 0.0, "pitchspeed": 0.0, "yawspeed": 0.0,
    }  # fmt: skip


def vfr_hud(core: Core) -> Fields:
    """For displays."""
    speed = core.body.speed_m_s
    return {
        "airspeed": speed, "groundspeed": speed, "heading": _heading_cdeg(core) // 100,
        "throttle": 40 if core.is_armed and not core.landed else 0,
        "alt": core.amsl_of(core.body.up_m), "climb": core.body.up_m_s,
    }  # fmt: skip


def gps_raw_int(core: Core) -> Fields:
    """A three-dimensional fix as soon as home can be set."""
    lat, lon = _position_e7(core)
    fix = core.home_set and not core.gps.lost
    return {
        "time_usec": core.uptime_ms * 1000, "fix_type": 6 if fix else 1, "lat": lat, "lon": lon,
        "alt": round(core.amsl_of(core.body.up_m) * 1000), "eph": 121, "epv": 200,
        "vel": round(core.body.speed_m_s * 100), "cog": _heading_cdeg(core), "satellites_visible": 10 if fix else 0,
    }  # fmt: skip


def sys_status(core: Core) -> Fields:
    """Battery and health: GPS and AHRS are healthy once the EKF is ready."""
    health = _SENSORS if core.ready else _SENSORS & ~_NEEDS_POSITION
    return {
        "onboard_control_sensors_present": _SENSORS, "onboard_control_sensors_enabled": _SENSORS,
        "onboard_control_sensors_health": health, "load": 150, "voltage_battery": _millivolts(core),
        "current_battery": 500 if core.is_armed else 0, "battery_remaining": math.floor(core.body.charge * 100),
        "drop_rate_comm": 0, "errors_comm": 0, "errors_count1": 0, "errors_count2": 0, "errors_count3": 0,
        "errors_count4": 0,
    }  # fmt: skip


def _millivolts(core: Core) -> int:
    return round(10_500 + 2_100 * core.body.charge)


def battery_status(core: Core) -> Fields:
    """The same battery in detail."""
    return {
        "id": 0, "battery_function": 1, "type": 1, "temperature": 32767, "voltages": [_millivolts(core), *_CELLS[1:]],
        "current_battery": 500 if core.is_armed else 0, "current_consumed": -1, "energy_consumed": -1,
        "battery_remaining": math.floor(core.body.charge * 100),
    }  # fmt: skip


def landed_state(core: Core) -> int:
    """MAV_LANDED_STATE."""
    if not core.is_copter:
        return 0 if core.config.stack == "ardupilot" else (2 if core.is_armed else 1)  # PX4 rovers are "in air"
    if core.landed:
        return 3 if core.lift and core.body.up_m > 0.02 else 1
    if core.mode.does is Does.LAND:
        return 4
    return 3 if core.mode.does is Does.TAKEOFF else 2


def extended_sys_state(core: Core) -> Fields:
    """Landed or in the air."""
    return {"vtol_state": 0, "landed_state": landed_state(core)}


def home_position(core: Core) -> Fields | None:
    """None before home is set."""
    if not core.home_set:
        return None
    home = core.home
    lat, lon = core.frame.geodetic(home.east_m, home.north_m)
    return {
        "latitude": round(lat * 1e7), "longitude": round(lon * 1e7), "altitude": round(core.amsl_of(home.up_m) * 1000),
        "x": home.north_m, "y": home.east_m, "z": -home.up_m, "q": [1.0, 0.0, 0.0, 0.0],
        "approach_x": 0.0, "approach_y": 0.0, "approach_z": 0.0, "time_usec": core.uptime_ms * 1000,
    }  # fmt: skip


def gps_global_origin(core: Core) -> Fields | None:
    """None before the EKF has an origin, from its GPS or from SET_GPS_GLOBAL_ORIGIN."""
    config, given = core.config, core.given_origin
    by_gps = (
        round(config.home_lat_deg * 1e7), round(config.home_lon_deg * 1e7), round(config.home_alt_m * 1000)
    )  # fmt: skip
    origin = given or (by_gps if core.home_set else None)
    if origin is None:
        return None
    return {
        "latitude": origin[0], "longitude": origin[1], "altitude": origin[2], "time_usec": core.uptime_ms * 1000
    }  # fmt: skip


def take_origin(core: Core, message: Message) -> None:
    """SET_GPS_GLOBAL_ORIGIN: taken where there is none yet; the answer is the one in use."""
    if gps_global_origin(core) is None:
        core.given_origin = (message.latitude, message.longitude, message.altitude)
    core.emit("GPS_GLOBAL_ORIGIN", **(gps_global_origin(core) or {}))


def position_target_global_int(core: Core) -> Fields | None:
    """The echo of the target: altitude above the sea, mask and frame as each stack sends them."""
    nav = core.nav
    ardupilot = core.config.stack == "ardupilot"
    if not isinstance(nav, Goal):
        if ardupilot:
            return None
        nav = core.stopping_place()
    if core.mode.does not in _CAN_MOVE if ardupilot else not core.is_armed:
        return None
    lat, lon = core.frame.geodetic(nav.east_m, nav.north_m)
    # int(), not round(): the real ones are off by up to 1e-7 degrees too.
    return {
        "time_boot_ms": core.uptime_ms,
        "coordinate_frame": 0 if ardupilot else 5, "type_mask": 65016 if ardupilot else 0,
        "lat_int": int(lat * 1e7), "lon_int": int(lon * 1e7), "alt": core.amsl_of(nav.up_m),
        "vx": 0.0, "vy": 0.0, "vz": 0.0, "afx": 0.0, "afy": 0.0, "afz": 0.0, "yaw": 0.0, "yaw_rate": 0.0,
    }  # fmt: skip


def nav_controller_output(core: Core) -> Fields | None:
    """Distance and bearing to the target."""
    if core.mode.does not in _CAN_MOVE:
        return None
    nav = core.nav if isinstance(core.nav, Goal) else core.stopping_place()
    body = core.body
    bearing = math.degrees(math.atan2(nav.east_m - body.east_m, nav.north_m - body.north_m))
    return {
        "nav_roll": 0.0, "nav_pitch": 0.0, "nav_bearing": round(bearing), "target_bearing": round(bearing),
        "wp_dist": min(65535, round(nav.distance_m(body))), "alt_error": nav.up_m - body.up_m, "aspd_error": 0.0,
        "xtrack_error": 0.0,
    }  # fmt: skip


def ekf_status_report(core: Core) -> Fields:
    """ArduPilot's own: 831 once it uses GPS, 167 before."""
    zero = ("velocity_variance", "pos_horiz_variance", "pos_vert_variance", "compass_variance", "terrain_alt_variance")
    return {"flags": 831 if core.ready else 167, **dict.fromkeys(zero, 0.0)}


def autopilot_version(core: Core) -> Fields:
    """Capabilities: only what is simulated."""
    zeros = [0] * 8
    return {
        "capabilities": core.stack.capabilities, "flight_sw_version": core.stack.version, "middleware_sw_version": 0,
        "os_sw_version": 0, "board_version": 0, "flight_custom_version": zeros, "middleware_custom_version": zeros,
        "os_custom_version": zeros, "vendor_id": 0, "product_id": 0, "uid": core.config.sysid,
    }  # fmt: skip


def system_time(core: Core) -> Fields:
    """Without GPS time: only the uptime."""
    return {"time_unix_usec": 0, "time_boot_ms": core.uptime_ms}


Fill = Callable[[Core], Fields | None]


@dataclass(frozen=True, slots=True)
class Stream:
    """A message that can be streamed or requested; `default_hz` 0: only on request."""

    name: str
    fill: Fill
    default_hz: float
    fixed: bool = False  # no command changes its rate


COMMON: dict[int, Stream] = {
    1: Stream("SYS_STATUS", sys_status, 0.5),
    2: Stream("SYSTEM_TIME", system_time, 0.0),
    24: Stream("GPS_RAW_INT", gps_raw_int, 0.5),
    30: Stream("ATTITUDE", attitude, 0.5),
    32: Stream("LOCAL_POSITION_NED", local_position_ned, 0.5),
    33: Stream("GLOBAL_POSITION_INT", global_position_int, 3.0),
    49: Stream("GPS_GLOBAL_ORIGIN", gps_global_origin, 0.0),
    62: Stream("NAV_CONTROLLER_OUTPUT", nav_controller_output, 0.0),
    74: Stream("VFR_HUD", vfr_hud, 0.5),
    87: Stream("POSITION_TARGET_GLOBAL_INT", position_target_global_int, 1.0),
    147: Stream("BATTERY_STATUS", battery_status, 0.1),
    148: Stream("AUTOPILOT_VERSION", autopilot_version, 0.0),
    242: Stream("HOME_POSITION", home_position, 0.0),
    245: Stream("EXTENDED_SYS_STATE", extended_sys_state, 0.5),
}
