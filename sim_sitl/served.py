"""Simulated autopilots on one UDP port, driven by a thread of their own: for clients that know no virtual time."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

from gatar_edge.errors import ConfigError
from gatar_edge.sim_sitl.autopilot import AutopilotConfig, SimAutopilot, Truth
from gatar_edge.sim_sitl.body import StackName
from gatar_edge.sim_sitl.faults import Faults
from gatar_edge.sim_sitl.faulty_link import End, FaultyLink
from gatar_edge.sim_sitl.geodesy import LocalFrame
from gatar_edge.sim_sitl.incidents import Script, happen
from gatar_edge.sim_sitl.realtime import UdpSocket
from gatar_edge.sim_sitl.world import Team
from gatar_edge.types import NS_PER_S, RobotKind

NONE = Faults()
_SLICE_S = 0.02  # of simulated time; answers do not wait for it
_IDLE_S = 0.002  # of the wall clock, between looks at the socket
_POLL_S = 0.01


class ServedVehicles:
    """A context manager: while it is entered, the vehicles answer at `port`, `speed` times as fast as the wall clock.

    Where the machine is busy the simulated time slips; it never jumps, so that no timer of a vehicle runs out unseen.
    """

    def __init__(
        self,
        configs: Sequence[AutopilotConfig],
        *,
        speed: float = 1.0,
        listen: str = "udp:127.0.0.1:0",
        faults: Faults = NONE,
    ) -> None:
        """`faults`: those of the telemetry links and of vehicles; there are no radios and no companions here."""
        ids = [config.sysid for config in configs]
        if not ids or len(set(ids)) < len(ids):
            raise ConfigError(f"system ids are {ids}, must be at least one, each its own")
        if not 0.1 <= speed <= 100:
            raise ConfigError(f"speed is {speed}, must be 0.1 to 100")
        self._speed = speed
        self._socket = UdpSocket(listen)
        self._vehicles = {config.sysid: SimAutopilot(config, 0) for config in configs}
        faults.check(ids)
        self._faults = faults
        self._script = Script(faults.incidents, self._vehicles)
        self._links = {config.sysid: FaultyLink(*faults.link_of(config.sysid), config.seed) for config in configs}
        for link in self._links.values():
            link.begin(0)
        self._now_ns = 0
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="gatar-vehicles", daemon=True)

    def __enter__(self) -> ServedVehicles:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def port(self) -> int:
        """Where the vehicles listen, on the loopback interface unless told otherwise."""
        return self._socket.port

    @property
    def sysids(self) -> tuple[int, ...]:
        """System ids of all vehicles."""
        return tuple(self._vehicles)

    @property
    def url(self) -> str:
        """For clients: pymavlink's and gatar's `udpout:`; MAVSDK writes `udpout://` instead."""
        return f"udpout:127.0.0.1:{self.port}"

    @property
    def vehicles(self) -> tuple[ServedVehicle, ...]:
        """All of them."""
        return tuple(ServedVehicle(self, sysid) for sysid in self._vehicles)

    def truth(self, sysid: int) -> Truth:
        """Where a vehicle really is and what it does."""
        with self._lock:
            return self._vehicles[sysid].truth

    def change(self, sysid: int, what: Callable[[SimAutopilot, int], None]) -> None:
        """Do something to a vehicle between two moments of its life: `what(autopilot, now_ns)`."""
        with self._lock:
            what(self._vehicles[sysid], self._now_ns)

    def wait(self, sysid: int, until: Callable[[Truth], bool], timeout_s: float = 30.0) -> Truth:
        """Wait for something to become true of a vehicle; raises TimeoutError after `timeout_s` of the wall clock."""
        deadline_s = time.monotonic() + timeout_s
        while True:
            truth = self.truth(sysid)
            if until(truth):
                return truth
            if time.monotonic() > deadline_s:
                raise TimeoutError(f"vehicle {sysid} did not get there within {timeout_s:g} s: {truth}")
            time.sleep(_POLL_S)

    def close(self) -> None:
        """Stop the thread and release the port."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()
        self._socket.close()

    def _serve(self) -> None:
        last_s = time.monotonic()
        while not self._stop.wait(_IDLE_S):
            now_s = time.monotonic()
            passed_s, last_s = min((now_s - last_s) * self._speed, _SLICE_S * max(1.0, self._speed)), now_s
            with self._lock:
                self._now_ns += int(passed_s * NS_PER_S)
                self._exchange()

    def _exchange(self) -> None:
        now_ns = self._now_ns
        for turn in self._script.due(now_ns):
            happen(turn, self._vehicles[turn.incident.robot], now_ns)
        datagrams = [data for data, _ in self._socket.receive()]
        for sysid, vehicle in self._vehicles.items():
            if self._faults.killed(sysid, now_ns):
                continue
            link = self._links[sysid]
            for data in datagrams:
                link.send(now_ns, End.COMPANION, data)
            self._deliver(link, vehicle)
            vehicle.step(now_ns)
            link.send(now_ns, End.VEHICLE, vehicle.take())
            self._deliver(link, vehicle)

    def _deliver(self, link: FaultyLink, vehicle: SimAutopilot) -> None:
        arrived = link.deliver(self._now_ns)
        for end, data in arrived:
            if end is End.VEHICLE:
                vehicle.receive(data, self._now_ns)
        self._socket.send_datagrams(data for end, data in arrived if end is End.COMPANION)


@dataclass(frozen=True, slots=True)
class ServedVehicle:
    """One of the vehicles that are served."""

    among: ServedVehicles
    sysid: int

    @property
    def url(self) -> str:
        """See `ServedVehicles.url`; all vehicles share it, and each answers to its own system id."""
        return self.among.url

    @property
    def port(self) -> int:
        """See `ServedVehicles.port`."""
        return self.among.port

    @property
    def truth(self) -> Truth:
        """Where the vehicle really is and what it does."""
        return self.among.truth(self.sysid)

    def wait(self, until: Callable[[Truth], bool], timeout_s: float = 30.0) -> Truth:
        """See `ServedVehicles.wait`."""
        return self.among.wait(self.sysid, until, timeout_s)


def team_of(team: str, stack: str, spacing_m: float = 5.0) -> list[AutopilotConfig]:
    """A team such as 2A1G in a row to the east, aerial robots first; "mixed" alternates stacks. Raises ConfigError."""
    families: dict[str, tuple[StackName, StackName]] = {
        "ardupilot": ("ardupilot", "ardupilot"), "px4": ("px4", "px4"), "mixed": ("ardupilot", "px4"),
    }  # fmt: skip
    if stack not in families:
        raise ConfigError(f"stack is {stack!r}, must be one of {', '.join(families)}")
    crew = Team.parse(team)
    first = AutopilotConfig(sysid=1, vehicle="copter")
    frame = LocalFrame(first.home_lat_deg, first.home_lon_deg)
    configs = []
    for index, (sysid, kind) in enumerate(zip(crew.ids, crew.kinds, strict=True)):
        lat_deg, lon_deg = frame.geodetic(index * spacing_m, 0.0)
        vehicle: Literal["copter", "rover"] = "copter" if kind is RobotKind.UAV else "rover"
        family = families[stack][index % 2]
        configs.append(AutopilotConfig(sysid, vehicle, family, home_lat_deg=lat_deg, home_lon_deg=lon_deg, seed=sysid))
    return configs
