"""The checks of `doctor`: pure functions of what was collected. One function, one question, one verdict."""

from __future__ import annotations

import math
from collections.abc import Collection
from statistics import median

from gatar_edge.bridge import dialect
from gatar_edge.bridge.companion_loss import Situation, companion_loss
from gatar_edge.bridge.dialect import MessageId
from gatar_edge.bridge.geo import wgs84_to_grid_m
from gatar_edge.bridge.own_fence import OwnFence, own_fence
from gatar_edge.bridge.profiles import Profile
from gatar_edge.bridge.rates import ENOUGH_HZ, WANTED_HZ
from gatar_edge.bridge.settings import DriverConfig
from gatar_edge.bridge.survey import Facts
from gatar_edge.bridge.verdict import Finding, fail, ok, warn
from gatar_edge.bridge.wire import Address
from gatar_edge.types import NS_PER_S, RobotKind

COMPANION_COMPID = 191
SILENT_S = 3.0
POSITION_MAX_AGE_S = 1.0
FIX_3D = 3  # GPS_FIX_TYPE
SLOW_ANSWER_MS = 500.0
CLOCK_SKEW_S = 1.0
OTHER_SITE_M = 1000.0
LOW_PERCENT, EMPTY_PERCENT = 30, 15
MUST_HAVE = {4: "MISSION_INT", 8: "COMMAND_INT"}  # MAV_PROTOCOL_CAPABILITY
_RELEASES = {0: "development", 64: "alpha", 128: "beta", 192: "candidate", 255: "release"}
_NO_MISSION = (0, 65535)
MAX_NAMED = 6
_KINDS = {dialect.TYPE_GCS: "ground station", dialect.TYPE_ONBOARD_CONTROLLER: "companion", 2: "copter", 10: "rover"}


def check_heartbeat(facts: Facts) -> Finding:
    """Is there an autopilot, and does it live?"""
    if facts.vehicle is None:
        if facts.unsupported:
            return ok("an autopilot is heard")
        others = _names(facts, facts.heard)
        return fail(f"no autopilot is heard, only {others}", "check --sysid, the wiring, and what else uses this link")
    heard = facts.heard[facts.vehicle]
    age_s = (facts.now_ns - heard.last_ns) / NS_PER_S
    if age_s > SILENT_S:
        return fail(f"the last heartbeat of system {facts.vehicle[0]} is {age_s:.1f} s old", "check link and power")
    lasted_s = (heard.last_ns - heard.first_ns) / NS_PER_S
    rate = f", {(heard.count - 1) / lasted_s:.1f} a second" if lasted_s > 0 else ""
    return ok(f"autopilot {facts.vehicle[0]}/{facts.vehicle[1]}{rate}")


def check_profile(facts: Facts) -> Finding:
    """Can this stack be driven, and is it the kind of vehicle that the configuration says?"""
    if facts.profile is None:
        text = facts.unsupported or "unknown, as no autopilot is heard"
        return fail(text, "use a vehicle of one of the profiles")
    if facts.plan is not None and facts.plan.kind is not facts.profile.kind:
        text = f"{facts.profile.name}, while the configuration says {facts.plan.kind.name}"
        return fail(text, "mend robot.kind or vehicle.url")
    return ok(facts.profile.name)


def check_answers(facts: Facts, profile: Profile) -> Finding:
    """Does it hear us, and answer?"""
    if facts.answered:
        read = f"{len(facts.parameters)} of {facts.parameters_asked} parameters asked for"
        return ok(f"it answers ({read}; firmware of another age lacks some)")
    mend = "a one-way link, SYSID_ENFORCE=1 with another ground station's id, or signing: see these"
    return fail("it is heard, and answers nothing", mend)


def check_version(facts: Facts, profile: Profile) -> Finding:
    """Which firmware, and does it speak the integer protocols?"""
    if facts.version is None:
        return warn("it does not tell its version", "check that AUTOPILOT_VERSION is not filtered on the way")
    v = facts.version.version
    text = f"{profile.name} {v >> 24}.{v >> 16 & 255}.{v >> 8 & 255} {_RELEASES.get(v & 255, 'pre-release')}"
    lacks = [name for bit, name in MUST_HAVE.items() if not facts.version.capabilities & bit]
    if lacks:
        return fail(f"{text} lacks {' and '.join(lacks)}", "update the firmware")
    return ok(text)


def check_position(facts: Facts, profile: Profile) -> Finding:
    """Where is it, and how old is that?"""
    seen, limit_s = facts.seen, facts.plan.position_max_age_s if facts.plan else POSITION_MAX_AGE_S
    indoors = "wait for the GPS; without GPS give it an estimate and `gatar bridge set-origin`"
    if seen.lat_lon_deg is None:
        return fail("it does not know where it is", indoors)
    age_s = (facts.now_ns - seen.position_ns) / NS_PER_S
    if age_s > limit_s:
        text = f"its position is {age_s:.1f} s old, {limit_s:g} s are allowed"
        return fail(text, "see rates; a slow link needs fewer other messages")
    where = f"at {seen.lat_lon_deg[0]:.7f}, {seen.lat_lon_deg[1]:.7f}, {age_s:.1f} s old"
    if facts.gps is None or facts.gps.fix_type < FIX_3D:
        fix = "no GPS is told of" if facts.gps is None else f"GPS fix type {facts.gps.fix_type}"
        return warn(f"{where}, yet {fix}", "make sure that the position is from a good source")
    return ok(f"{where}, {facts.gps.satellites} satellites, fix type {facts.gps.fix_type}")


def check_home(facts: Facts, profile: Profile) -> Finding:
    """Is home known, to which all altitudes are relative?"""
    home = facts.seen.home
    if home is None:
        return fail("home is not set, and every altitude counts from it", "wait for the GPS: it takes up to a minute")
    far_m = facts.seen.distance_m((home.lat_e7 / 1e7, home.lon_e7 / 1e7))
    return ok(f"home is set, {far_m:.0f} m from here" if math.isfinite(far_m) else "home is set")


def check_origin(facts: Facts, profile: Profile) -> Finding:
    """Has the estimator an origin? Without one guided and mission modes are refused."""
    if facts.seen.origin is not None:
        return ok("the origin of its local frame is set")
    return fail("its estimator has no origin", "wait for the GPS; without GPS: `gatar bridge set-origin`")


def check_fence(facts: Facts, profile: Profile) -> Finding:
    """Does the vehicle's own fence forbid what our gate allows? Copter refuses in silence, Rover stops in silence."""
    fence = own_fence(facts.parameters, profile)
    if fence is None:
        return warn("the parameters of its own fence could not be read", "try again nearer to the vehicle")
    if not fence.on:
        text = f"it has no fence of its own ({fence.says}): only the bridge's keeps it inside"
        return warn(text, "set one a few metres outside of the mission's area")
    around = f"{fence.says}, radius {_metres(fence.radius_m)}, ceiling {_metres(fence.ceiling_m)}"
    if facts.plan is None:
        return ok(f"{around}; --config compares it with the mission's area")
    return _compare(fence, around, facts, facts.plan)


def check_companion_loss(facts: Facts, profile: Profile) -> Finding:
    """What would truly happen if the companion died now?"""
    armed = facts.seen.armed
    mode = profile.mission_mode if _by_mission(facts, profile) else profile.guided_mode
    if armed and facts.seen.custom_mode is not None:
        mode = facts.seen.custom_mode
    sysid = facts.vehicle[0] if facts.vehicle else 0
    outcome = companion_loss(facts.parameters, Situation(profile, mode, sysid))
    when = "if the companion died now" if armed else f"disarmed; if the companion dies in {profile.mode_name(mode)}"
    text = f"{when}, {outcome.text}"
    return ok(text) if outcome.watched else warn(text, outcome.mend)


def check_rates(facts: Facts, profile: Profile) -> Finding:
    """Do the messages come as often as they were asked for?"""
    if not facts.rates_hz:
        return warn("not measured: too little time", "give --timeout-s 15 or more")
    # a target is told while there is one, and only then
    expected = {i: hz for i, hz in WANTED_HZ.items() if i != MessageId.POSITION_TARGET_GLOBAL_INT}
    slow = [i for i in expected if facts.rates_hz[i] * facts.counted_s + 1 < ENOUGH_HZ[i] * facts.counted_s]
    told = ", ".join(f"{MessageId(i).name} {facts.rates_hz[i]:.1f} of {expected[i]:g} Hz" for i in slow)
    mend = "the link is too slow, or a ground station sets other rates on it"
    if facts.rates_hz[MessageId.GLOBAL_POSITION_INT] * POSITION_MAX_AGE_S < 1:
        return fail(told, mend)
    if slow:
        return warn(told, mend)
    return ok(f"{facts.rates_hz[MessageId.GLOBAL_POSITION_INT]:.1f} positions a second, the others as asked for")


def check_mission(facts: Facts, profile: Profile) -> Finding:
    """What is on board, how much has room, and does the vehicle get to its end and obey there?"""
    current = facts.seen.current
    name, good = profile.mission_end or ("", frozenset())
    if name in facts.parameters and facts.parameters[name] not in good and _by_mission(facts, profile):
        text = f"at the end of each mission it changes its mode ({name}={facts.parameters[name]:g}), as a pilot would"
        return fail(text, f"set {name} to one of {sorted(good)}: nothing is commanded after a pilot's change of mode")
    if (early := _stops_early(facts, profile)) is not None:
        return early
    if current is None:
        return warn("it does not tell of its mission", "see rates")
    room = f"room for {profile.mission_capacity}"
    if current.total in _NO_MISSION:
        return ok(f"no mission is on board, {room}")
    if profile.kind is RobotKind.UAV:
        return ok(f"{current.total} waypoints are on board, {room}; a UAV is flown by targets and leaves them there")
    return ok(f"{current.total} waypoints are on board, {room}; the first upload replaces them")


def check_signing(facts: Facts, profile: Profile) -> Finding:
    """Who may command it?"""
    if facts.signed and not facts.answered:
        mend = "use a link on which unsigned frames are accepted, as the first serial one"
        return fail("it signs its frames, and answers nothing that is unsigned", mend)
    if facts.signed:
        return ok("it signs its frames, and takes unsigned ones on this link")
    text = "its frames are not signed: whoever reaches this link can command it"
    return warn(text, "keep the link private, or set up signing") if facts.shared_link else ok(text)


def check_clock(facts: Facts, profile: Profile) -> Finding:
    """How far is it, in time, and does it know the time of day?"""
    if not facts.round_trips_ns:
        return warn("it does not answer TIMESYNC", "logs of vehicle and companion will not align")
    trip_ms = median(facts.round_trips_ns) / 1e6
    text = f"an answer takes {trip_ms:.0f} ms ({len(facts.round_trips_ns)} measured)"
    if trip_ms > SLOW_ANSWER_MS:
        return warn(text, "positions are as old when they come: use a faster link")
    if facts.clock_skew_s is None:
        return ok(f"{text}; it does not tell the time of day")
    if abs(facts.clock_skew_s) > CLOCK_SKEW_S:
        return warn(
            f"{text}; the clocks are {facts.clock_skew_s:+.1f} s apart", "set the companion's clock by NTP or GPS"
        )
    return ok(f"{text}; the clocks are {facts.clock_skew_s:+.2f} s apart")


def check_company(facts: Facts, profile: Profile) -> Finding:
    """Who else is there?"""
    others = [address for address in facts.heard if address != facts.vehicle]
    if not others:
        return ok("nobody else is heard on this link")
    sysid = facts.vehicle[0] if facts.vehicle else 0
    text = f"also heard: {_names(facts, others)}"
    if (sysid, COMPANION_COMPID) in others:
        return warn(f"{text}; one of them is this vehicle's companion", "two companions on one vehicle fight: stop one")
    return ok(text)


def check_battery(facts: Facts, profile: Profile) -> Finding:
    """Is there energy for a mission?"""
    percent = facts.seen.battery_percent
    if percent < 0:
        return warn("it does not tell its battery's charge", "set up the battery monitor")
    if percent <= EMPTY_PERCENT:
        return fail(f"the battery is at {percent} %", "charge it")
    return warn(f"the battery is at {percent} %", "charge it") if percent <= LOW_PERCENT else ok(f"at {percent} %")


def check_armed(facts: Facts, profile: Profile) -> Finding:
    """May its motors turn?"""
    mode = facts.seen.custom_mode
    name = profile.mode_name(mode) if mode is not None else "an unknown mode"
    if facts.seen.armed:
        return warn(f"ARMED, in {name}", "keep clear: somebody is flying or driving it")
    return ok(f"disarmed, in {name}")


def check_place(facts: Facts, profile: Profile) -> Finding | None:
    """Does it stand where the configuration's grid is?"""
    here, plan = facts.seen.lat_lon_deg, facts.plan
    if plan is None or here is None:
        return None
    grid = plan.grid
    x, y = wgs84_to_grid_m(grid, *here)
    out_m = math.hypot(max(-x, 0.0, x - grid.width * grid.cell_m), max(-y, 0.0, y - grid.height * grid.cell_m))
    if out_m == 0.0:
        return ok(f"in cell ({int(x // grid.cell_m)}, {int(y // grid.cell_m)}) of the grid")
    mend = "mend [grid] in the configuration, or bring it there"
    text = f"{out_m:.0f} m outside of the grid"
    return fail(text, mend) if out_m > OTHER_SITE_M else warn(text, mend)


def _compare(fence: OwnFence, around: str, facts: Facts, plan: DriverConfig) -> Finding:
    home = facts.seen.home
    if plan.kind is RobotKind.UAV and plan.altitude_m > fence.ceiling_m:
        text = f"it is to fly at {plan.altitude_m:g} m, above its own ceiling of {fence.ceiling_m:g} m"
        return fail(text, "lower vehicle.altitude_m, or raise the ceiling")
    if home is None:
        return ok(around)
    at_m = wgs84_to_grid_m(plan.grid, home.lat_e7 / 1e7, home.lon_e7 / 1e7)
    reach_m = max(math.dist(at_m, corner) for corner in plan.limits().fence_m)
    if reach_m > fence.radius_m:
        text = f"the mission's area reaches {reach_m:.0f} m from home, its own fence ends after {fence.radius_m:.0f} m"
        return fail(text, "it refuses or stops there in silence: shrink the area or widen its fence")
    return ok(f"{around}; the mission's area reaches {reach_m:.0f} m from home")


def _by_mission(facts: Facts, profile: Profile) -> bool:
    """Whether the daemon drives it by missions, as far as is known."""
    return profile.kind is RobotKind.UGV and (facts.plan is None or facts.plan.drive == "mission")


def _stops_early(facts: Facts, profile: Profile) -> Finding | None:
    """What to say of one that may come to rest so far before a guided target that it never counts as there."""
    name, plan = profile.guided_radius or "", facts.plan
    if plan is None or plan.drive != "guided" or name not in facts.parameters:
        return None
    radius_m, near_m = facts.parameters[name], plan.grid.cell_m / 2
    if radius_m <= near_m:
        return None
    text = f"it may stop {radius_m:g} m before a guided target ({name}), and is there within {near_m:g} m, half a cell"
    return warn(text, f'set {name} to {near_m:g} or less, or vehicle.drive to "mission"')


def _metres(value: float) -> str:
    return f"{value:g} m" if math.isfinite(value) else "none"


def _names(facts: Facts, addresses: Collection[Address]) -> str:
    """Who they are, the first few by name."""
    known = [f"{_KINDS.get(facts.heard[a].heartbeat.type, 'component')} {a[0]}/{a[1]}" for a in addresses]
    return ", ".join(known[:MAX_NAMED]) + (f" and {len(known) - MAX_NAMED} more" if len(known) > MAX_NAMED else "")
