"""The vehicle's mode: set by us until the heartbeat shows it, and ours only while nobody else changes it.

Only the heartbeat tells the mode: PX4 acknowledges DO_SET_MODE even when it does not switch.
The pilot wins: a change that we did not ask for, and that is none of the vehicle's own, ends our right to command.
"""

from __future__ import annotations

from gatar_edge.bridge.commands import NEVER_NS, CommandClient
from gatar_edge.bridge.dialect import CUSTOM_MODE_FLAG, Command
from gatar_edge.bridge.profiles.base import Profile
from gatar_edge.types import NS_PER_S

RETRY_NS = NS_PER_S
# A mode that we asked for before the present one may show up this much later: a delayed copy of the command.
ASKED_LIFE_NS = 3 * NS_PER_S


class ModeKeeper:
    """Sets modes and watches who changes them."""

    def __init__(self, profile: Profile, commands: CommandClient) -> None:
        self._profile, self._commands = profile, commands
        self._asked_ns: dict[int, int] = {}  # mode -> when last asked for
        self._want: int | None = None  # asked for until it shows
        self._expected: int | None = None  # the last mode of our choice: it may show up late
        self._mode: int | None = None
        self._engaged = False  # has been in a mode of our choice
        self.pilot: int | None = None  # the mode that somebody else chose

    def want(self, mode: int | None) -> None:
        """From now on try to be in `mode`; None: leave it as it is."""
        if mode != self._want:  # else one whose answer was lost would be sent again, after what comes now
            self._commands.forget(Command.DO_SET_MODE)
        self._want = mode
        if mode is not None:
            self._expected = mode

    def adopt(self, mode: int | None) -> None:
        """The mode in which it stands is as good as one of our choice: leaving it is somebody else's doing."""
        self._expected, self._engaged = mode, True

    def release(self) -> None:
        """Command again after the pilot took over."""
        self.pilot, self._expected, self._engaged = None, None, False

    def observe(self, mode: int, now_ns: int, may_leave_mission: bool) -> bool:
        """Take the mode of a heartbeat; True when just now somebody else changed it.

        `may_leave_mission`: the mission is at its end, so that leaving its mode is the vehicle's own doing.
        """
        before, self._mode = self._mode, mode
        ours = mode == self._expected or now_ns - self._asked_ns.get(mode, -ASKED_LIFE_NS) < ASKED_LIFE_NS
        self._engaged |= mode == self._expected
        if not self._engaged or before is None or mode == before or ours or self.pilot is not None:
            return False
        if (before, mode) in self._profile.own_transitions and (
            before != self._profile.mission_mode or may_leave_mission
        ):
            return False
        self.pilot, self._want = mode, None
        return True

    def expect(self, mode: int, now_ns: int) -> None:
        """Another command of ours (DO_REPOSITION) brings the vehicle into `mode`."""
        self.want(None)
        self._expected = mode
        self._asked_ns[mode] = now_ns

    @property
    def due_ns(self) -> int:
        """When `poll` has something to do again, unless something arrives or is commanded first."""
        return NEVER_NS if self._want is None or self._want == self._mode or self.pilot is not None else 0

    def poll(self, now_ns: int) -> None:
        """Ask for the wanted mode again if the heartbeat does not show it."""
        want = self._want
        if want is None or self.pilot is not None:
            return
        if want == self._mode:
            self._commands.forget(Command.DO_SET_MODE)
            self._engaged = True
        elif now_ns - self._asked_ns.get(want, -RETRY_NS) >= RETRY_NS:
            self._asked_ns[want] = now_ns
            self._commands.long(Command.DO_SET_MODE, CUSTOM_MODE_FLAG, *self._profile.mode_params(want))
