"""What a driver remembers over a restart of its process: nothing that the vehicle itself can tell.

With it a restarted companion goes on with the mission on board where that is still the one that it put there, and its
signed frames are newer than all that it has sent.
"""

from __future__ import annotations

from dataclasses import dataclass

from gatar_edge.types import Cell, Mission


@dataclass(frozen=True, slots=True)
class DriverMemory:
    """One moment of a driver. `mission` is "" where nothing is certain to be on board."""

    mission: str = ""  # fingerprint of what is on board
    cells: tuple[Cell, ...] = ()  # the pursued mission
    start: Cell | None = None  # where it began
    signing_timestamp: int = 0  # of the next frame, see `signing.Signing`
    pilot: bool = False  # somebody else had control, and nobody had told us to command again

    @property
    def pursued(self) -> Mission | None:
        """The mission that the vehicle was driving."""
        return Mission(self.cells) if self.mission and self.cells else None


NOTHING = DriverMemory()
