"""What a mission is, apart from how it travels: its items, its fingerprint, and whether two of them are the same."""

from __future__ import annotations

import hashlib
import math
import struct

from gatar_edge.bridge.dialect import Command, Frame
from gatar_edge.bridge.geo import deg_e7
from gatar_edge.bridge.profiles.base import Profile
from gatar_edge.bridge.wire import MissionItem

Items = tuple[MissionItem, ...]

# ArduPilot stores altitudes in centimetres; latitude and longitude may come back one unit off.
LAT_LON_TOLERANCE_E7 = 1
ALTITUDE_TOLERANCE_M = 0.01 + 1e-6

# Rover 4.6.2 takes 655 items, Copter 650: a path with more corners than this is not a path of ours.
MAX_ITEMS = 500


def build(profile: Profile, points_deg: tuple[tuple[float, float], ...], alt_rel_m: float) -> Items:
    """Waypoints at (lat, lon) pairs, `alt_rel_m` above home, with slot 0 where this stack keeps home there.

    On ArduPilot the acceptance radius of a waypoint is ignored and param1 is a delay: all parameters stay zero.
    """
    items = tuple(
        MissionItem(
            frame=profile.item_frame,
            command=Command.NAV_WAYPOINT,
            params=(0.0, 0.0, 0.0, profile.yaw_param),
            lat_e7=deg_e7(lat),
            lon_e7=deg_e7(lon),
            alt_m=alt_rel_m,
        )
        for lat, lon in points_deg
    )
    if not profile.first_item_seq or not items:
        return items
    # The vehicle overwrites slot 0 with its home, yet refuses an upload in which it is not valid.
    home = MissionItem(Frame.GLOBAL, Command.NAV_WAYPOINT, (0.0, 0.0, 0.0, 0.0), items[0].lat_e7, items[0].lon_e7, 0.0)
    return (home, *items)


def fingerprint(items: Items, first_seq: int) -> str:
    """A hash of what flies: the items from `first_seq` on. MAVLink's own opaque_id is not in the dialect in use."""
    digest = hashlib.sha256()
    for item in items[first_seq:]:
        digest.update(struct.pack("<HH", item.frame, item.command))
        digest.update(struct.pack("<4f2if", *item.params, item.lat_e7, item.lon_e7, item.alt_m))
    return digest.hexdigest()


def _close(a: float, b: float, tolerance: float) -> bool:
    return (math.isnan(a) and math.isnan(b)) or abs(a - b) <= tolerance


def same_item(sent: MissionItem, read: MissionItem, profile: Profile) -> bool:
    """Whether an item that was read back is the one that was sent, within the vehicle's rounding."""
    frames = profile.item_read_back_frames if sent.frame == profile.item_frame else {sent.frame}
    return (
        read.frame in frames
        and sent.command == read.command
        and abs(sent.lat_e7 - read.lat_e7) <= LAT_LON_TOLERANCE_E7
        and abs(sent.lon_e7 - read.lon_e7) <= LAT_LON_TOLERANCE_E7
        and _close(sent.alt_m, read.alt_m, ALTITUDE_TOLERANCE_M)
        and all(_close(a, b, 1e-3) for a, b in zip(sent.params, read.params, strict=True))
    )


def same_mission(sent: Items, read: Items, profile: Profile) -> bool:
    """Whether what is on board is what was sent. Slot 0 counts only where it is a real item."""
    first = profile.first_item_seq
    return len(sent) == len(read) and all(
        same_item(a, b, profile) for a, b in zip(sent[first:], read[first:], strict=True)
    )
