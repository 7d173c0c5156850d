"""What commands that visit a vehicle share: the loop between a link and a state machine without sockets."""

from __future__ import annotations

import select
import time
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from gatar_edge.bridge.link import open_link
from gatar_edge.bridge.settings import DriverConfig
from gatar_edge.bridge.visit import Visit
from gatar_edge.errors import ConfigError, LinkError

POLL_S = 0.05


class Guest(Protocol):
    """What visits; see `bridge.survey.Survey`."""

    visit: Visit

    def receive(self, data: bytes, now_ns: int) -> None: ...
    def poll(self, now_ns: int) -> bytes: ...
    def done(self, now_ns: int) -> bool: ...


def call_on(url: str, guest: Guest, timeout_s: float, clock_ns: Callable[[], int]) -> None:
    """Let `guest` talk over the link until it is done or out of time.

    Raises LinkError where nothing at all was heard, ConfigError where several vehicles are there and none was chosen.
    """
    end_ns = clock_ns() + int(timeout_s * 1e9)
    with open_link(url) as link:
        while (now_ns := clock_ns()) < end_ns and not (guest.done(now_ns) or guest.visit.undecided(now_ns)):
            for data in link.receive():
                guest.receive(data, now_ns)
            sysid = guest.visit.vehicle[0] if guest.visit.vehicle is not None else guest.visit.sysid
            link.send(guest.poll(now_ns), sysid)
            if link.fileno() >= 0:
                select.select([link.fileno()], [], [], POLL_S)
            else:
                time.sleep(POLL_S)
    if not guest.visit.heard:
        raise LinkError(
            f"nothing is heard on {url} within {timeout_s:g} s: check that the vehicle is on and sends there, "
            "and that nobody else reads this port"
        )
    visit, systems = guest.visit, guest.visit.autopilots
    if visit.vehicle is None and visit.sysid is None and len(systems) > 1:
        named = ", ".join(map(str, systems))
        raise ConfigError(f"several vehicles are heard on {url}: choose one with --sysid ({named})")


def target(url: str | None, sysid: int | None, config: Path | None) -> tuple[str, int | None, DriverConfig | None]:
    """Link, system and plan of the options --vehicle, --sysid and --config; what is given wins. Raises ConfigError."""
    if config is None:
        if url is None:
            raise ConfigError("no vehicle: give --vehicle URL, such as udpin:127.0.0.1:14550, or --config vehicle.toml")
        return url, sysid, None
    from gatar_edge.preflight import driver_config
    from gatar_edge.vehicle_config import read_config

    read = read_config(config)
    plan = driver_config(read)
    return url or read.vehicle.url, sysid or plan.sysid, plan
