"""What real autopilots answered, read by our codec: the assumptions of profiles, echo and retasking hold on it.

The transcripts lie outside the repository: in the folder that GATAR_SHARED names, or in ../shared beside the checkout.
"""

from __future__ import annotations

import gzip
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from bridge_fake_vehicle import mav

from gatar_edge.bridge import wire
from gatar_edge.bridge.codec import Codec
from gatar_edge.bridge.profiles import Profile, choose
from gatar_edge.bridge.telemetry import Telemetry, near_e7

SHARED = Path(os.environ.get("GATAR_SHARED", Path(__file__).resolve().parents[3] / "shared")) / "flight"
FILES = {
    "s2_ugv_retask_ap_cmd1": "ardupilot-rover",
    "s2_ugv_retask_px_msg": "px4-rover",
    "s2_uav_retask_copter": "ardupilot-copter",
    "s2_uav_retask_px4quad_part2": "px4-copter",
}


def lines(name: str) -> Iterator[dict[str, Any]]:
    path = SHARED / f"{name}.jsonl.gz"
    if not path.is_file():
        pytest.skip(f"no transcript {path.name}: set GATAR_SHARED to the folder that holds flight/")
    with gzip.open(path, "rt") as file:
        for text in file:
            line = json.loads(text)
            if "msg" in line:
                yield line


def frame(line: dict[str, Any]) -> bytes | None:
    """The vehicle's line as bytes again."""
    kind = getattr(mav, f"MAVLink_{line['msg'].lower()}_message", None)
    if kind is None:
        return None
    fields = {k: v.encode() if isinstance(v, str) else v for k, v in line["f"].items() if k != "mavlink_version"}
    if line["msg"] == "HEARTBEAT":
        fields["mavlink_version"] = 3
    return bytes(kind(**fields).pack(mav.MAVLink(None, srcSystem=line["sys"], srcComponent=line["comp"])))


def heard(name: str) -> Iterator[tuple[dict[str, Any], wire.Received | None]]:
    codec = Codec(7, 191)
    for line in lines(name):
        data = frame(line) if line["dir"] == "rx" else None
        got = codec.parse(data) if data is not None else []
        yield line, got[0] if got else None


@pytest.mark.parametrize(("name", "profile_name"), FILES.items())
def test_a_real_autopilot_is_recognized_and_tells_home_and_position(name: str, profile_name: str) -> None:
    seen = Telemetry()
    for _, received in heard(name):
        if received is not None and received.message is not None and received.source[1] == 1:
            seen.update(received.message, 1)
    assert seen.heartbeat is not None
    profile = choose(seen.heartbeat.autopilot, seen.heartbeat.type)
    assert isinstance(profile, Profile)
    assert profile.name == profile_name
    assert profile.mode_name(seen.heartbeat.custom_mode).isdecimal() is False
    assert seen.home is not None
    assert seen.lat_lon_deg == pytest.approx((42.0, -71.0), abs=0.01)


@pytest.mark.parametrize(("name", "at_least"), [("s2_ugv_retask_ap_cmd1", 13), ("s2_ugv_retask_px_msg", 11)])
def test_after_set_current_a_real_rover_soon_echoes_a_waypoint_of_its_new_mission(name: str, at_least: int) -> None:
    points: list[tuple[float, float]] = []
    asked_s, confirmed, total_matches = None, 0, 0
    for line, received in heard(name):
        fields = line["f"]
        if line["dir"] == "tx":
            if line["msg"] == "MISSION_COUNT":
                points = []
            elif line["msg"] == "MISSION_ITEM_INT" and fields["frame"] == 6:
                points.append((fields["x"] / 1e7, fields["y"] / 1e7))
            elif line["msg"] == "MISSION_SET_CURRENT" or fields.get("command") == 224:
                asked_s = line["t"]
        elif asked_s is not None and received is not None:
            message = received.message
            if isinstance(message, wire.MissionCurrent):
                total_matches += message.total == len(points)
            if isinstance(message, wire.PositionTarget) and any(near_e7(message, p) for p in points):
                confirmed += line["t"] - asked_s < 1.0
                asked_s = None
    assert confirmed >= at_least
    assert total_matches > at_least


def test_a_real_copter_echoes_every_reposition_that_it_accepted() -> None:
    target, pending, echoed = None, 0, 0
    for line, received in heard("s2_uav_retask_copter"):
        if line["dir"] == "tx" and line["msg"] == "COMMAND_INT":
            target = (line["f"]["x"] / 1e7, line["f"]["y"] / 1e7)
        elif received is not None and isinstance(received.message, wire.CommandAck) and received.message.command == 192:
            pending += received.message.result == 0 and target is not None
        elif received is not None and isinstance(received.message, wire.PositionTarget) and target is not None:
            near = near_e7(received.message, target)
            echoed, target = echoed + near, None if near else target
    assert pending >= 8
    assert echoed >= 8
