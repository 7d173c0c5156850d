"""What a core needs of its dialect: a runner for its missions, and the answers of the stack."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from gatar_edge.sim_sitl.mission_server import Rules
from gatar_edge.sim_sitl.modes import Mode
from gatar_edge.sim_sitl.parameters import Defaults

if TYPE_CHECKING:
    from gatar_edge.sim_sitl.core import Core


class RunnerLike(Protocol):
    """The mission of a vehicle in its AUTO mode."""

    index: int
    state: int

    def enter(self) -> None:
        """AUTO was entered."""

    def leave(self) -> None:
        """AUTO was left."""

    def step(self) -> None:
        """Look whether the item is done."""

    def changed(self, seq: int | None) -> None:
        """An item was stored, or the list was cut, cleared or replaced."""

    def received(self) -> None:
        """An upload is complete."""

    def set_current(self, seq: int) -> None:
        """MISSION_SET_CURRENT."""


class CoreStack(Protocol):
    """What a core asks of its dialect; stack.Stack adds what the autopilot round it asks."""

    modes: dict[int, Mode]
    parameters: Defaults
    bytewise_parameters: bool
    capabilities: int  # MAV_PROTOCOL_CAPABILITY
    version: int  # AUTOPILOT_VERSION.flight_sw_version
    rules: Rules

    def start(self, core: Core) -> RunnerLike:
        """Set up a core at power-on: its mode, and its mission runner."""

    def entered(self, core: Core, before: Mode) -> None:
        """The mode has changed."""

    def armed(self, core: Core) -> None:
        """The motors were started."""

    def disarmed(self, core: Core) -> None:
        """The motors were stopped."""

    def lifted(self, core: Core) -> None:
        """It left the ground."""

    def touched(self, core: Core) -> None:
        """It came down."""

    def idle_s(self, core: Core) -> float:
        """How long it may stand armed on the ground."""

    def return_altitude_m(self, core: Core) -> float:
        """Above home, for the way back."""

    def may_clear(self, core: Core) -> bool:
        """Whether MISSION_CLEAR_ALL is obeyed."""
