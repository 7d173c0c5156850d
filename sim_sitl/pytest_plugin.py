"""A pytest plugin: simulated ArduPilot and PX4 vehicles for the tests of any program that speaks MAVLink.

Importing it imports pytest alone; sockets and threads exist only while a test uses a fixture. In a test:

    def test_my_client(vehicle):
        copter = vehicle("copter", stack="px4", speed=10)
        my_client.take_off(copter.url)                       # udpout:127.0.0.1:PORT
        copter.wait(lambda truth: truth.alt_rel_m > 4.5)
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import pytest

if TYPE_CHECKING:
    from gatar_edge.sim_sitl.faults import Faults
    from gatar_edge.sim_sitl.served import ServedVehicle, ServedVehicles


class MakeVehicle(Protocol):
    """What the fixture `vehicle` is."""

    def __call__(
        self,
        kind: str = "copter",
        *,
        stack: str = "ardupilot",
        sysid: int = 1,
        speed: float = 10.0,
        faults: Faults | None = None,
        **config: Any,
    ) -> ServedVehicle:
        """Serve one vehicle until the test ends; `config`: the other fields of AutopilotConfig."""


class MakeFleet(Protocol):
    """What the fixture `fleet` is."""

    def __call__(
        self, team: str = "2A2G", *, stack: str = "mixed", speed: float = 10.0, faults: Faults | None = None
    ) -> ServedVehicles:
        """Serve a team (system ids from 1) side by side on one port until the test ends."""


class MakeFaults(Protocol):
    """What the fixture `faults` is."""

    def __call__(self, source: str | Path) -> Faults:
        """The faults in a TOML file (a Path) or in TOML text."""


@pytest.fixture
def vehicle() -> Iterator[MakeVehicle]:
    """A function that serves a simulated vehicle on loopback UDP until the test ends."""
    from gatar_edge.sim_sitl.autopilot import AutopilotConfig
    from gatar_edge.sim_sitl.served import NONE, ServedVehicles

    with contextlib.ExitStack() as stack_of:

        def make(
            kind: Any = "copter",
            *,
            stack: Any = "ardupilot",
            sysid: int = 1,
            speed: float = 10.0,
            faults: Faults | None = None,
            **config: Any,
        ) -> ServedVehicle:
            one = AutopilotConfig(sysid=sysid, vehicle=kind, stack=stack, **config)
            return stack_of.enter_context(ServedVehicles([one], speed=speed, faults=faults or NONE)).vehicles[0]

        yield make


@pytest.fixture
def fleet() -> Iterator[MakeFleet]:
    """A function that serves a whole team on one loopback UDP port until the test ends."""
    from gatar_edge.sim_sitl.served import NONE, ServedVehicles, team_of

    with contextlib.ExitStack() as stack_of:

        def make(
            team: str = "2A2G", *, stack: str = "mixed", speed: float = 10.0, faults: Faults | None = None
        ) -> ServedVehicles:
            return stack_of.enter_context(ServedVehicles(team_of(team, stack), speed=speed, faults=faults or NONE))

        yield make


@pytest.fixture
def faults() -> MakeFaults:
    """A function that reads declared faults."""
    from gatar_edge.sim_sitl.faults_file import load_faults, parse_faults

    return lambda source: load_faults(source) if isinstance(source, Path) else parse_faults(source.encode())
