"""A guest of a simulated autopilot in lock-step: bytes both ways, no sockets, no sleeping."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from gatar_edge.bridge.survey import Facts, Survey
from gatar_edge.sim_sitl.autopilot import AutopilotConfig, SimAutopilot
from gatar_edge.sim_sitl.testing import COPTER, ROVER, px4_copter, px4_rover
from gatar_edge.types import NS_PER_S

STACKS = {
    "ardupilot-copter": COPTER,
    "ardupilot-rover": ROVER,
    "px4-copter": px4_copter(),
    "px4-rover": px4_rover(),
}
SLICE_NS = NS_PER_S // 50


class Guest(Protocol):
    def receive(self, data: bytes, now_ns: int) -> None: ...
    def poll(self, now_ns: int) -> bytes: ...
    def done(self, now_ns: int) -> bool: ...


class Site:
    """One vehicle; `lose` says of each direction's bytes whether they are lost."""

    def __init__(self, config: AutopilotConfig) -> None:
        self.now_ns = 0
        self.vehicle = SimAutopilot(config, 0)
        self.sent: list[bytes] = []
        self.lose: Callable[[bool], bool] = lambda to_vehicle: False

    def host(self, guest: Guest, seconds: float = 60.0) -> float:
        """Let them talk until the guest is done; how long that took, in seconds."""
        began_ns = self.now_ns
        end_ns = began_ns + round(seconds * NS_PER_S)
        while self.now_ns < end_ns and not guest.done(self.now_ns):
            self.now_ns += SLICE_NS
            self.vehicle.step(self.now_ns)
            said = self.vehicle.take()
            if said and not self.lose(False):
                guest.receive(said, self.now_ns)
            asked = guest.poll(self.now_ns)
            self.sent.append(asked)
            if asked and not self.lose(True):
                self.vehicle.receive(asked, self.now_ns)
        return (self.now_ns - began_ns) / NS_PER_S

    def survey(self, *, seconds: float = 60.0, sysid: int | None = None, **options: object) -> Facts:
        """What a survey finds."""
        survey = Survey(sysid, self.now_ns, shared_link=True, seed=1, **options)  # type: ignore[arg-type]
        self.host(survey, seconds)
        return survey.facts(self.now_ns)
