"""A small scripted autopilot on raw MAVLink bytes, for the tests of the driver: pymavlink alone, nothing of the bridge.

It does what the driver's tests need of ArduPilot Copter and Rover and of PX4, in fake time, in a local flat frame.
"""

from __future__ import annotations

import math
import os

os.environ["MAVLINK20"] = "1"
from pymavlink.dialects.v20 import ardupilotmega as mav

S = 1_000_000_000
M_PER_DEG = 111_319.49
PX4_LOITER, PX4_MISSION, PX4_MANUAL, PX4_TAKEOFF = 0x03040000, 0x04040000, 0x00010000, 0x02040000


class FakeVehicle:
    """`poll(now, data)` takes the companion's bytes and returns the vehicle's."""

    def __init__(
        self, kind: str, sysid: int, lat: float, lon: float, *, boot_s: float = 3.0, speed: float = 5.0
    ) -> None:
        self.kind, self.px4, self.flies = kind, kind.startswith("px4"), kind.endswith("copter")
        self.mav = mav.MAVLink(None, srcSystem=sysid, srcComponent=1)
        self.mav.robust_parsing = True
        self.lat, self.lon, self.alt = lat, lon, 0.0
        self.home, self.home_amsl = (lat, lon), 584.0
        self.boot_ns, self.speed = round(boot_s * S), 5.0
        self.mode = PX4_LOITER if self.px4 else 0
        self.armed = False
        self.target: tuple[float, float, float] | None = None  # lat, lon, height above home
        self.mission: list[mav.MAVLink_mission_item_int_message] = []
        self.open: list[mav.MAVLink_mission_item_int_message] | None = None
        self.count, self.current, self.complete = 0, 0, False
        self.peer = (sysid, 191)
        self.received: list[mav.MAVLink_message] = []
        self.has_origin = True
        self.stops_short_m = 0.0  # of a guided target
        self.detour_e7 = 0  # by its own avoidance of obstacles: it tells where it goes round
        self.silent = self.deaf_to_reposition = self.refuse_fence = self.stuck = False
        self.sent: dict[int, int] = {}
        self.out = b""
        self.item_ns = self.asked_ns = 0
        self.last_ns: int | None = None
        # PX4 tells its current item once a second, whatever interval is asked for
        self.intervals: dict[int, float] = {42: 1e6} if self.px4 else {}

    # --- wire ---

    def send(self, message: mav.MAVLink_message) -> None:
        self.out += message.pack(self.mav)
        self.mav.seq = (self.mav.seq + 1) % 256

    def poll(self, now: int, data: bytes) -> bytes:
        self.now = now
        for message in self.mav.parse_buffer(data) or []:
            self.received.append(message)
            handler = getattr(self, "on_" + message.get_type().lower(), None)
            if handler is not None and getattr(message, "target_system", self.peer[0]) == self.peer[0]:
                handler(message)
        self.move(0.0 if self.last_ns is None else (now - self.last_ns) / S)
        self.last_ns = now
        self.watch_upload()
        self.stream()
        out, self.out = self.out, b""
        return b"" if self.silent else out

    def due(self, key: int, hz: float) -> bool:
        if self.now - self.sent.get(key, -(10**12)) < S / hz - 1:
            return False
        self.sent[key] = self.now
        return True

    def stream(self) -> None:
        if self.due(0, 1):
            self.heartbeat()
        ready = self.now >= self.boot_ns
        for message_id in list(self.intervals):
            if self.due(message_id, 1e6 / self.intervals[message_id]):
                self.telemetry(message_id, ready)

    def heartbeat(self) -> None:
        kind, stack = (2 if self.flies else 10), (12 if self.px4 else 3)
        self.send(mav.MAVLink_heartbeat_message(kind, stack, 1 | 128 * self.armed, self.mode, 4, 3))

    def telemetry(self, message_id: int, ready: bool) -> None:
        lat, lon = round(self.lat * 1e7), round(self.lon * 1e7)
        if message_id == 33:
            here = (lat, lon) if ready else (0, 0)
            amsl = round((self.home_amsl + self.alt) * 1000)
            self.send(mav.MAVLink_global_position_int_message(0, *here, amsl, round(self.alt * 1000), 0, 0, 0, 0))
        elif message_id == 42:
            first = 0 if self.px4 else 1
            total = max(0, len(self.mission) - first)
            state = 1 if not total else 5 if self.complete else 3 if self.mode == self.mission_mode else 2
            self.send(
                mav.MAVLink_mission_current_message(self.current, (total or 65535) if self.px4 else total, state, 0)
            )
        elif message_id == 87 and self.target is not None:
            lat, lon = round(self.target[0] * 1e7) + self.detour_e7, round(self.target[1] * 1e7)
            alt = self.home_amsl + self.target[2]
            self.send(
                mav.MAVLink_position_target_global_int_message(0, 0, 65016, lat, lon, alt, 0, 0, 0, 0, 0, 0, 0, 0)
            )
        elif message_id == 245:
            self.send(mav.MAVLink_extended_sys_state_message(0, 2 if self.alt > 0.5 else 1))

    # --- vehicle ---

    @property
    def mission_mode(self) -> int:
        return PX4_MISSION if self.px4 else 10 if not self.flies else 3

    @property
    def guided_mode(self) -> int:
        return PX4_LOITER if self.px4 else 4 if self.flies else 15

    def set_mode(self, mode: int) -> None:
        self.mode = mode
        if mode == self.mission_mode:
            self.start_leg()
        elif mode != self.guided_mode:
            self.target = None
        self.heartbeat()

    def start_leg(self) -> None:
        first = 0 if self.px4 else 1
        self.current = max(first, self.current)
        if self.current < len(self.mission) and not self.complete:
            item = self.mission[self.current]
            self.target = (item.x / 1e7, item.y / 1e7, self.alt)

    def move(self, dt: float) -> None:
        if not self.armed or self.target is None or self.stuck:
            return
        lat, lon, alt = self.target
        self.alt += max(-3 * dt, min(3 * dt, alt - self.alt)) if self.flies else 0.0
        north, east = (lat - self.lat) * M_PER_DEG, (lon - self.lon) * M_PER_DEG * math.cos(math.radians(lat))
        distance = math.hypot(north, east)
        if self.mode == self.guided_mode and distance <= self.stops_short_m:
            return
        part = 1.0 if distance <= self.speed * dt else self.speed * dt / distance
        self.lat += (lat - self.lat) * part
        self.lon += (lon - self.lon) * part
        if self.mode == self.mission_mode and distance < 2.0:
            if self.current + 1 < len(self.mission):
                self.current += 1
                self.start_leg()
            else:
                self.complete, self.target = True, None
                if self.px4:
                    self.set_mode(PX4_LOITER)

    # --- commands ---

    def ack(self, command: int, result: int) -> None:
        self.send(mav.MAVLink_command_ack_message(command, result, 0, 0, *self.peer))

    def on_command_long(self, m: mav.MAVLink_command_long_message) -> None:
        result = 0
        if m.command == 511 and self.px4 and m.param1 == 42:
            result = 4
        elif m.command == 511:
            self.intervals[int(m.param1)] = m.param2
        elif m.command == 512 and m.param1 == 242 and self.now >= self.boot_ns:
            lat, lon = (round(v * 1e7) for v in self.home)
            amsl = round(self.home_amsl * 1000)
            self.send(mav.MAVLink_home_position_message(lat, lon, amsl, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0))
        elif m.command == 512 and m.param1 == 49 and self.now >= self.boot_ns and self.has_origin:
            lat, lon = (round(v * 1e7) for v in self.home)
            self.send(mav.MAVLink_gps_global_origin_message(lat, lon, round(self.home_amsl * 1000)))
        elif m.command == 400:
            result = 0 if self.now >= self.boot_ns and self.mode != 3 else 4
            self.armed = self.armed or result == 0
        elif m.command == 176:
            self.set_mode(int(m.param2) << 16 | int(m.param3) << 24 if self.px4 else int(m.param2))
        elif m.command == 22:
            height = m.param7 - (self.home_amsl if self.px4 else 0.0)
            self.target = (self.lat, self.lon, height)
        elif m.command == 224:
            result = self.set_current(int(m.param1), bool(m.param2)) if not self.px4 else 3
        else:
            result = 3
        self.ack(m.command, result)

    def set_current(self, seq: int, reset: bool) -> int:
        if seq >= len(self.mission):
            return 2
        self.current, self.complete = seq, self.complete and not reset
        if self.mode == self.mission_mode:
            self.start_leg()
        return 0

    def on_mission_set_current(self, m: mav.MAVLink_mission_set_current_message) -> None:
        self.complete = False
        self.set_current(m.seq, True)

    def on_command_int(self, m: mav.MAVLink_command_int_message) -> None:
        if m.command != 192 or self.deaf_to_reposition:
            return
        if self.refuse_fence:
            self.ack(m.command, 4)
            return
        relative = not self.px4 and m.frame in (3, 6)
        self.mode = self.guided_mode
        self.target = (m.x / 1e7, m.y / 1e7, m.z if relative else m.z - self.home_amsl)
        self.ack(m.command, 0)

    def on_set_position_target_global_int(self, m: mav.MAVLink_set_position_target_global_int_message) -> None:
        if self.px4 or self.mode != self.guided_mode or self.deaf_to_reposition or self.refuse_fence:
            return  # without a word
        stops = m.type_mask != (0xDF8 if self.flies else 0xDFC) or m.coordinate_frame != 6
        self.target = (self.lat, self.lon, self.alt) if stops else (m.lat_int / 1e7, m.lon_int / 1e7, m.alt)

    # --- mission ---

    def replace_mission(self, points: list[tuple[float, float]]) -> None:
        """As another ground station does."""
        home = [] if self.px4 or not points else points[:1]
        self.mission = [
            mav.MAVLink_mission_item_int_message(
                *self.peer, seq, 6, 16, 0, 1, 0, 0, 0, 0, round(lat * 1e7), round(lon * 1e7), 0, 0
            )
            for seq, (lat, lon) in enumerate([*home, *points])
        ]

    def on_mission_count(self, m: mav.MAVLink_mission_count_message) -> None:
        if self.px4 and self.open:
            self.mission_ack(1)
            return
        self.open, self.count, self.item_ns = [], m.count, self.now
        if not self.px4:
            self.mission = self.mission[: m.count]
        self.ask()

    def mission_ack(self, result: int) -> None:
        self.send(mav.MAVLink_mission_ack_message(*self.peer, result, 0))

    def watch_upload(self) -> None:
        if self.open is None:
            return
        if self.now - self.item_ns >= (5 if self.px4 else 8) * S:
            self.open = None
            if not self.px4:
                self.mission_ack(15)
        elif self.now - self.asked_ns >= (S // 4 if self.px4 else S):
            self.ask()

    def on_mission_request_list(self, _m: mav.MAVLink_mission_request_list_message) -> None:
        if self.open is None:
            self.send(mav.MAVLink_mission_count_message(*self.peer, len(self.mission), 0))
        elif not self.px4:
            self.mission_ack(14)

    def on_mission_request_int(self, m: mav.MAVLink_mission_request_int_message) -> None:
        if m.seq >= len(self.mission):
            self.mission_ack(1)
            return
        i = self.mission[m.seq]
        params = (i.param1, i.param2, i.param3, i.param4, i.x, i.y, i.z, 0)
        frame = 3 if i.frame == 6 and not self.px4 else i.frame
        self.send(mav.MAVLink_mission_item_int_message(*self.peer, m.seq, frame, i.command, 0, 1, *params))

    def ask(self) -> None:
        self.asked_ns = self.now
        kind = mav.MAVLink_mission_request_int_message if self.px4 else mav.MAVLink_mission_request_message
        self.send(kind(*self.peer, len(self.open or []), 0))

    def on_mission_item_int(self, m: mav.MAVLink_mission_item_int_message) -> None:
        if self.open is None or m.seq != len(self.open):
            if not self.px4:
                self.mission_ack(1 if self.open is None else 13)
            return
        self.open.append(m)
        self.item_ns = self.now
        if not self.px4:
            self.mission[m.seq : m.seq + 1] = [m]
        if len(self.open) < self.count:
            self.ask()
            return
        self.mission, self.open = self.open, None
        if self.mode == self.mission_mode and not self.complete:
            self.start_leg()  # the old index is kept
        self.mission_ack(0)
