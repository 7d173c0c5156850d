"""A blunt MAVLink client for tests: sends one message to a simulated autopilot and looks at every answer."""

from __future__ import annotations

from typing import Any

from gatar_edge.sim_sitl.autopilot import AutopilotConfig, SimAutopilot
from gatar_edge.sim_sitl.geodesy import LocalFrame
from gatar_edge.sim_sitl.wire import mavlink
from gatar_edge.types import NS_PER_S

HOME = (-35.3632621, 149.1652374)
COPTER = AutopilotConfig(sysid=1, vehicle="copter")
ROVER = AutopilotConfig(sysid=2, vehicle="rover")


def px4_copter(seed: int = 0) -> AutopilotConfig:
    """A PX4 multicopter."""
    return AutopilotConfig(sysid=3, vehicle="copter", stack="px4", seed=seed)


def px4_rover(seed: int = 0) -> AutopilotConfig:
    """A PX4 rover."""
    return AutopilotConfig(sysid=4, vehicle="rover", stack="px4", seed=seed)


class Client:
    """One client of one vehicle in lock-step; everything that came is kept in `log`."""

    def __init__(self, config: AutopilotConfig, sysid: int = 255, compid: int = 190, **kwargs: Any) -> None:
        self.now_ns = 0
        self.vehicle = SimAutopilot(config, 0, **kwargs)
        self.target = config.sysid
        self._frame = LocalFrame(config.home_lat_deg, config.home_lon_deg)
        self._out = mavlink.MAVLink(None, srcSystem=sysid, srcComponent=compid)
        self._in = mavlink.MAVLink(None)
        self.log: list[Any] = []
        self.collect()

    def collect(self) -> list[Any]:
        """What the vehicle has sent since the last call."""
        messages = self._in.parse_buffer(self.vehicle.take()) or []
        self.log += messages
        return messages

    def send(self, name: str, *, sysid: int | None = None, compid: int | None = None, **fields: Any) -> list[Any]:
        """Send a message and return the immediate answers."""
        message_class = getattr(mavlink, f"MAVLink_{name.lower()}_message")
        for target, value in (("target_system", self.target), ("target_component", 1)):
            if target in message_class.fieldnames:
                fields.setdefault(target, value)
        message = message_class(**fields)
        keep = self._out.srcSystem, self._out.srcComponent
        self._out.srcSystem, self._out.srcComponent = sysid or keep[0], compid or keep[1]
        self.vehicle.receive(bytes(message.pack(self._out)), self.now_ns)
        self._out.srcSystem, self._out.srcComponent = keep
        return self.collect()

    def command(self, number: int, *params: float, **kwargs: Any) -> int | None:
        """Send COMMAND_LONG and return the result, None without an answer."""
        values: dict[str, Any] = {f"param{i + 1}": (params[i] if i < len(params) else 0.0) for i in range(7)}
        answers = self.send("COMMAND_LONG", command=number, confirmation=0, **values, **kwargs)
        return next((a.result for a in answers if a.get_type() == "COMMAND_ACK" and a.command == number), None)

    def command_int(self, number: int, frame: int, x: float, y: float, z: float, *params: float) -> int | None:
        """Send COMMAND_INT (x and y in degrees) and return the result, None without an answer."""
        values: dict[str, Any] = {f"param{i + 1}": (params[i] if i < len(params) else 0.0) for i in range(4)}
        answers = self.send(
            "COMMAND_INT",
            command=number, frame=frame, current=0, autocontinue=0, x=round(x * 1e7), y=round(y * 1e7), z=z, **values,
        )  # fmt: skip
        return next((a.result for a in answers if a.get_type() == "COMMAND_ACK" and a.command == number), None)

    def run(self, seconds: float, step_s: float = 0.1) -> list[Any]:
        """Let time pass; everything that was sent meanwhile."""
        messages = []
        end = self.now_ns + round(seconds * NS_PER_S)
        while self.now_ns < end:
            self.now_ns = min(end, self.now_ns + round(step_s * NS_PER_S))
            self.vehicle.step(self.now_ns)
            messages += self.collect()
        return messages

    def item(self, seq: int, lat: float, lon: float, z: float = 0.0, **fields: Any) -> list[Any]:
        """Send one MISSION_ITEM_INT (a waypoint in frame 6 unless told)."""
        values: dict[str, Any] = {
            "frame": 6, "command": 16, "current": 0, "autocontinue": 1, "param1": 0.0, "param2": 0.0, "param3": 0.0,
            "param4": 0.0, "mission_type": 0,
        }  # fmt: skip
        values |= fields
        return self.send("MISSION_ITEM_INT", seq=seq, x=round(lat * 1e7), y=round(lon * 1e7), z=z, **values)

    def upload(self, *points: tuple[float, float, float], **fields: Any) -> list[Any]:
        """Upload points (lat, lon, z), slot 0 included where the stack has one; all answers."""
        answers = self.send("MISSION_COUNT", count=len(points), mission_type=0)
        for seq, (lat, lon, z) in enumerate(points):
            answers += self.item(seq, lat, lon, z, **fields)
        return answers

    def place(self, east_m: float, north_m: float, z: float = 0.0) -> tuple[float, float, float]:
        """A point near home."""
        lat, lon = self._frame.geodetic(east_m, north_m)
        return lat, lon, z


def kinds(messages: list[Any], *only: str) -> list[str]:
    """The names of messages in order, all or only some."""
    names = [m.get_type() for m in messages]
    return [n for n in names if n in only] if only else names


def of(messages: list[Any], name: str) -> list[Any]:
    """The messages of one kind."""
    return [m for m in messages if m.get_type() == name]


def texts(messages: list[Any]) -> list[str]:
    """The texts of all STATUSTEXT."""
    return [m.text for m in of(messages, "STATUSTEXT")]
