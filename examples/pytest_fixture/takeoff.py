"""Somebody's program: takes an ArduPilot copter to an altitude. Knows nothing of gatar-edge."""

from __future__ import annotations

import time

from pymavlink import mavutil

mavlink = mavutil.mavlink
GUIDED = 4
CLIMB_S = 60


def take_off(url: str, altitude_m: float) -> None:
    """Arm and climb; returns when the vehicle tells that it is there."""
    link = mavutil.mavlink_connection(url, source_system=255)
    try:
        link.mav.heartbeat_send(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 0)
        if link.wait_heartbeat(timeout=10) is None:
            raise TimeoutError("no vehicle")
        for number, params in (
            (mavlink.MAV_CMD_DO_SET_MODE, (1, GUIDED)),
            (mavlink.MAV_CMD_COMPONENT_ARM_DISARM, (1,)),
            (mavlink.MAV_CMD_NAV_TAKEOFF, (0, 0, 0, 0, 0, 0, altitude_m)),
        ):
            command(link, number, params)
        deadline_s = time.monotonic() + CLIMB_S
        while position(link).relative_alt < (altitude_m - 0.5) * 1000:
            if time.monotonic() > deadline_s:
                raise TimeoutError("it does not climb")
    finally:
        link.close()


def command(link: mavutil.mavfile, number: int, params: tuple[float, ...], tries: int = 20) -> None:
    """Send a command until it is answered."""
    for again in range(tries):
        padded = [*params, *[0] * (7 - len(params))]
        link.mav.command_long_send(link.target_system, link.target_component, number, 0, *padded)
        answer = link.recv_match(
            type="COMMAND_ACK", condition=f"COMMAND_ACK.command=={number}", blocking=True, timeout=0.2
        )
        if answer is not None:
            # where an answer was lost, a copter that is climbing already refuses the second command to take off
            if answer.result != mavlink.MAV_RESULT_ACCEPTED and not again:
                raise RuntimeError(f"command {number} was refused: {answer.result}")
            return
    raise TimeoutError(f"command {number} was never answered")


def position(link: mavutil.mavfile) -> mavlink.MAVLink_global_position_int_message:
    """The next position."""
    message = link.recv_match(type="GLOBAL_POSITION_INT", blocking=True, timeout=10)
    if message is None:
        raise TimeoutError("no position")
    return message
