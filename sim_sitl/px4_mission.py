"""Missions of PX4: the rules of its mission server, and AUTO.MISSION."""

from __future__ import annotations

from gatar_edge.sim_sitl.core import Core
from gatar_edge.sim_sitl.mission_items import NAV_LAST, Ack, Item, check_px4, stored_by_px4
from gatar_edge.sim_sitl.mission_runner import ACTIVE, COMPLETE, NO_MISSION, NOT_STARTED, Runner
from gatar_edge.sim_sitl.mission_server import Rules
from gatar_edge.sim_sitl.modes import Does, by_name
from gatar_edge.sim_sitl.streams import Fields
from gatar_edge.types import NS_PER_S

_MS = 1_000_000
_REPEATS = 10  # of MISSION_ITEM_REACHED, one a second
_ANNOUNCED_AFTER_MS = (40, 1000)  # MISSION_CURRENT follows a change by this much, as measured
_REFUSED_AFTER_CLEAR = 0.8  # how often AUTO.MISSION right after clear and upload does not switch, as measured

RULES = Rules(
    request="MISSION_REQUEST_INT",
    retry_ns=250 * _MS,
    retry_jitter_ns=0,
    give_up_ns=5 * NS_PER_S,
    give_up_ack=None,
    atomic=True,
    home_in_slot_0=False,
    wrong_seq=None,
    repeated_last=Ack.ACCEPTED,
    restart_anywhere=False,
    foreign_count=Ack.ERROR,
    foreign_list=None,
    client_can_cancel=True,
    downloads_are_transfers=True,
    capacity=10_000,
    check=check_px4,
    stored=stored_by_px4,
)


class Px4Runner(Runner):
    """AUTO.MISSION: loiters when the mission is over; a new mission keeps the old index, clamped to its length."""

    def __init__(self, core: Core) -> None:
        super().__init__(core)
        self.total = 0  # as announced, which lags behind what is stored
        self._announce_ns: int | None = None
        self._ready_ns = 0  # from when on the mission can be started
        self._cleared = False
        self._repeat: tuple[int, int, int] | None = None  # seq, times left, when

    @property
    def available(self) -> bool:
        """Whether AUTO.MISSION can be entered."""
        return bool(self.items) and self.core.now_ns >= self._ready_ns

    def enter(self) -> None:
        core = self.core
        core.lift = core.lift or (core.is_copter and core.landed)
        core.text(6, "Executing Mission")
        self._fly(min(self.index, len(self.items) - 1))
        self._announce_soon()

    def leave(self) -> None:
        self.leg = None
        self.state = NOT_STARTED if self.items else NO_MISSION
        self._announce_soon()

    def done(self) -> None:
        core, seq = self.core, self.index
        if self.leg is not None and self.leg.command <= NAV_LAST:
            core.emit("MISSION_ITEM_REACHED", seq=seq)
            self._repeat = (seq, _REPEATS - 1, core.now_ns + NS_PER_S)
        following = self.following()
        if following < len(self.items):
            self._fly(following)
        else:
            core.text(6, "Mission finished, loitering")
            core.enter(by_name(core.stack.modes, "AUTO.LOITER"))
            self.state = COMPLETE
        self._announce_soon()

    def changed(self, seq: int | None) -> None:
        if not self.items:
            self._clear()

    def received(self) -> None:
        if not self.items:
            self._clear()
            return
        rng, now_ns = self.core.rng, self.core.now_ns
        self.index = min(self.index, len(self.items) - 1)
        self.reset_jumps()
        self._announce_soon()
        late = self._cleared and rng.random() < _REFUSED_AFTER_CLEAR
        self._ready_ns = self._announce_ns if late and self._announce_ns is not None else now_ns
        self._cleared = False
        if self.core.mode.does is Does.AUTO:
            self._fly(self.index)
        elif self.state == NO_MISSION:
            self.state = NOT_STARTED

    def set_current(self, seq: int) -> None:
        if not seq < len(self.items):
            self.core.text(2, "WPM: WP CURR CMD: Not in list")
            return
        self.reset_jumps()
        if self.core.mode.does is Does.AUTO:
            self._fly(seq)
        else:
            self.index, self.state = seq, NOT_STARTED
        self._announce_soon()

    def acceptance_m(self, item: Item) -> float:
        radius = item.params[1]
        return radius if self.core.is_copter and radius > 0 else self.core.params["NAV_ACC_RAD"]

    def timers(self) -> None:
        """Announce what has changed, and repeat what was reached."""
        core = self.core
        if self._announce_ns is not None and core.now_ns >= self._announce_ns:
            self._announce_ns, self.total = None, len(self.items)
            core.emit("MISSION_CURRENT", **mission_current(core))
        if self._repeat is not None and core.now_ns >= self._repeat[2]:
            seq, left, due_ns = self._repeat
            core.emit("MISSION_ITEM_REACHED", seq=seq)
            self._repeat = (seq, left - 1, due_ns + NS_PER_S) if left > 1 else None

    def _fly(self, index: int) -> None:
        self.state = ACTIVE
        self.begin(index)

    def _clear(self) -> None:
        core = self.core
        self.index, self.leg, self._cleared = 0, None, True
        if core.mode.does is Does.AUTO:
            core.text(2, "No valid mission available, loitering")
            core.enter(by_name(core.stack.modes, "AUTO.LOITER"))
        self.state = NO_MISSION
        self._announce_soon()

    def _announce_soon(self) -> None:
        first, last = _ANNOUNCED_AFTER_MS
        due_ns = self.core.now_ns + self.core.rng.randint(first, last) * _MS
        self._announce_ns = due_ns if self._announce_ns is None else min(due_ns, self._announce_ns)


def mission_current(core: Core) -> Fields:
    """MISSION_CURRENT: the total is the count, 65535 without a mission."""
    runner = core.runner
    total = runner.total if isinstance(runner, Px4Runner) else 0
    return {
        "seq": runner.index, "total": total or 65535, "mission_state": runner.state,
        "mission_mode": 1 if core.mode.does is Does.AUTO else 2,
    }  # fmt: skip
