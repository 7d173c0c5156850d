"""One autopilot to test the bridge on: a real one behind a URL, or the simulated one in virtual time."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import pytest

from gatar_edge.bridge import dialect, wire
from gatar_edge.bridge.codec import Codec
from gatar_edge.bridge.driver import VehicleDriver
from gatar_edge.bridge.geo import grid_m_to_wgs84
from gatar_edge.bridge.link import Link, open_link
from gatar_edge.bridge.profiles import Profile, Unsupported, choose
from gatar_edge.bridge.settings import DriverConfig
from gatar_edge.sim_sitl.autopilot import AutopilotConfig, SimAutopilot
from gatar_edge.types import NS_PER_S, GridSpec, RobotKind

STEP_NS = NS_PER_S // 20
FIND_S = 60.0
GRID_CELLS, CELL_M = 15, 5.0
START = (7, 7)  # the cell in which the vehicle stands when a test begins


class Wire(Protocol):
    """Bytes to and from an autopilot."""

    now_ns: int

    def exchange(self, data: bytes) -> bytes:
        """Send, let a step of time pass, and give what came."""


class Simulated:
    """Lock-step: a step costs no time."""

    def __init__(self, config: AutopilotConfig) -> None:
        self.now_ns = 0
        self._vehicle = SimAutopilot(config, 0)

    def exchange(self, data: bytes) -> bytes:
        self._vehicle.receive(data, self.now_ns)
        self.now_ns += STEP_NS
        self._vehicle.step(self.now_ns)
        return self._vehicle.take()


class Real:
    """The wall clock, and whatever the URL leads to."""

    def __init__(self, link: Link) -> None:
        self._link = link
        self._start_ns = time.monotonic_ns()
        self.now_ns = 0

    def exchange(self, data: bytes) -> bytes:
        self._link.send(data)
        time.sleep(STEP_NS / NS_PER_S)
        self.now_ns = time.monotonic_ns() - self._start_ns
        return b"".join(self._link.receive())


@dataclass(frozen=True, slots=True)
class Subject:
    """What is tested: the variable that holds the URL of a real one, and the simulated one for where it is not set."""

    variable: str
    simulated: AutopilotConfig

    @property
    def name(self) -> str:
        return f"{self.simulated.stack}-{self.simulated.vehicle}"


SUBJECTS = (
    Subject("GATAR_SITL_COPTER", AutopilotConfig(1, "copter", "ardupilot")),
    Subject("GATAR_SITL_ROVER", AutopilotConfig(2, "rover", "ardupilot")),
    Subject("GATAR_SITL_PX4", AutopilotConfig(3, "copter", "px4")),
    Subject("GATAR_SITL_PX4_ROVER", AutopilotConfig(4, "rover", "px4")),
)


class Bench:
    """The autopilot on the bench, found and placed: `profile`, `sysid`, a `grid` round it, and time to pass."""

    def __init__(self, wire_: Wire) -> None:
        self._wire = wire_
        self._heard: list[wire.Received] = []
        self._codec = Codec(1, 191)
        self._listeners: list[Callable[[bytes], None]] = [self._listen]
        self._speakers: list[Callable[[], bytes]] = []
        self.profile, self.sysid = self._find()
        self._codec = Codec(self.sysid, 191)
        self.grid = self._place()

    @property
    def now_ns(self) -> int:
        return self._wire.now_ns

    def driver(self, **config: object) -> VehicleDriver:
        """A driver of this vehicle, connected from now on."""
        driver = VehicleDriver(
            DriverConfig(1, self.profile.kind, self.grid, self.sysid, altitude_m=10.0, **config),  # type: ignore[arg-type]
            self.now_ns,
        )
        self._listeners.append(lambda data: driver.receive(data, self.now_ns))
        self._speakers.append(lambda: driver.poll(self.now_ns))
        return driver

    def talk(self, receive: Callable[[wire.Received], None], poll: Callable[[], list[wire.Message]]) -> None:
        """Connect a state machine that speaks messages."""
        codec = Codec(self.sysid, 191)

        def listen(data: bytes) -> None:
            for frame in codec.parse(data):
                receive(frame)

        self._listeners.append(listen)
        self._speakers.append(lambda: b"".join(map(codec.encode, poll())))

    def run(self, until: Callable[[], bool], limit_s: float) -> bool:
        """Let time pass until something is true; False where it did not become so within `limit_s`."""
        end_ns = self.now_ns + int(limit_s * NS_PER_S)
        while not until():
            if self.now_ns >= end_ns:
                return False
            self.step()
        return True

    def step(self) -> None:
        """One step of time."""
        data = self._wire.exchange(b"".join(speak() for speak in self._speakers))
        for listen in self._listeners:
            listen(data)

    def _listen(self, data: bytes) -> None:
        self._heard = self._codec.parse(data)

    def _each_second(self, say: Callable[[], bytes]) -> Callable[[], bytes]:
        said_ns = self.now_ns - NS_PER_S

        def speak() -> bytes:
            nonlocal said_ns
            if self.now_ns - said_ns < NS_PER_S:
                return b""
            said_ns = self.now_ns
            return say()

        return speak

    def _find(self) -> tuple[Profile, int]:
        """The first autopilot that is heard; it is greeted all the while, since some answer only to who has spoken."""
        greeter = Codec(255, 190)
        greeting = wire.Heartbeat(
            dialect.TYPE_ONBOARD_CONTROLLER, dialect.AUTOPILOT_INVALID, 0, 0, dialect.STATE_ACTIVE
        )
        self._speakers = [self._each_second(lambda: greeter.encode(greeting))]
        found: list[tuple[Profile, int]] = []

        def look() -> bool:
            for frame in self._heard:
                message = frame.message
                if isinstance(message, wire.Heartbeat) and message.autopilot != dialect.AUTOPILOT_INVALID:
                    profile = choose(message.autopilot, message.type)
                    assert not isinstance(profile, Unsupported), profile.text
                    found.append((profile, frame.source[0]))
            return bool(found)

        assert self.run(look, FIND_S), f"no autopilot was heard within {FIND_S:g} s"
        self._speakers = []
        return found[0]

    def _place(self) -> GridSpec:
        """A grid with the vehicle in the centre of its middle cell."""
        ask = wire.CommandLong((self.sysid, 1), dialect.Command.SET_MESSAGE_INTERVAL, (33.0, 2e5, 0, 0, 0, 0, 0))
        self._speakers = [self._each_second(lambda: self._codec.encode(ask))]
        places: list[wire.GlobalPosition] = []

        def look() -> bool:
            places.extend(
                frame.message
                for frame in self._heard
                if isinstance(frame.message, wire.GlobalPosition) and frame.message.lat_e7
            )
            return bool(places)

        assert self.run(look, FIND_S), f"no position was told within {FIND_S:g} s"
        self._speakers = []
        here = GridSpec(origin_lat_deg=places[0].lat_e7 / 1e7, origin_lon_deg=places[0].lon_e7 / 1e7)
        back_m = -(START[0] + 0.5) * CELL_M
        lat, lon = grid_m_to_wgs84(here, back_m, back_m)
        return GridSpec(GRID_CELLS, GRID_CELLS, CELL_M, lat, lon)

    @property
    def flies(self) -> bool:
        return self.profile.kind is RobotKind.UAV


def bench_of(subject: Subject, links: list[Link]) -> Bench:
    """The real one where its variable is set, else the simulated one; opened links are added to `links`."""
    url = os.environ.get(subject.variable)
    if url is None:
        return Bench(Simulated(subject.simulated))
    links.append(open_link(url))
    bench = Bench(Real(links[-1]))
    if bench.profile.name != subject.name:
        pytest.fail(f"{subject.variable} leads to {bench.profile.name}, expected {subject.name}")
    return bench
