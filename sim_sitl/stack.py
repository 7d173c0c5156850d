"""What a dialect must bring: the same members in ardupilot.py and px4.py."""

from __future__ import annotations

from typing import Protocol

from gatar_edge.sim_sitl.contracts import CoreStack
from gatar_edge.sim_sitl.core import Core
from gatar_edge.sim_sitl.orders import Handler
from gatar_edge.sim_sitl.streams import Stream
from gatar_edge.sim_sitl.wire import Message


class Stack(CoreStack, Protocol):
    """One dialect for one vehicle."""

    autopilot_id: int  # MAV_AUTOPILOT
    announces_mode: bool  # a heartbeat leaves at once when the mode changes
    hides_parameter_index: bool  # PARAM_VALUE has index 65535 unless it was asked by index
    streams: dict[int, Stream]
    commands: dict[int, Handler]

    def booted(self, core: Core) -> None:
        """Power is on."""

    def home_found(self, core: Core) -> None:
        """The GPS gave a home."""

    def became_ready(self, core: Core) -> None:
        """The EKF uses the GPS."""

    def step(self, core: Core) -> None:
        """Timers of its own."""

    def receive(self, core: Core, message: Message) -> None:
        """A message that not all stacks know: modes and targets."""

    def parameter_changed(self, core: Core, name: str) -> None:
        """A client has set a parameter."""

    def status(self, core: Core) -> int:
        """HEARTBEAT.system_status."""
