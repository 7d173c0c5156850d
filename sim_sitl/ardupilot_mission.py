"""Missions of ArduPilot: the rules of its mission server, and AUTO."""

from __future__ import annotations

from dataclasses import replace

from gatar_edge.sim_sitl.core import Core
from gatar_edge.sim_sitl.mission_items import NAV_LAST, TAKEOFF, Ack, Item, check_ardupilot, stored_by_ardupilot
from gatar_edge.sim_sitl.mission_runner import ACTIVE, COMPLETE, NO_MISSION, NOT_STARTED, Runner
from gatar_edge.sim_sitl.mission_server import Rules
from gatar_edge.sim_sitl.modes import Does, by_name
from gatar_edge.sim_sitl.streams import Fields
from gatar_edge.sim_sitl.vehicle import Goal
from gatar_edge.types import NS_PER_S

_ITEM_NAMES = {
    16: "WP",
    17: "LoitUnlim",
    19: "LoitTime",
    20: "RTL",
    21: "Land",
    22: "Takeoff",
    93: "Delay",
    177: "Jump",
}
_DONE_BEHAVE = {3: "MANUAL"}  # MIS_DONE_BEHAVE; 0 holds and 1 loiters, both staying in AUTO (mode_auto.cpp)

RULES = Rules(
    request="MISSION_REQUEST",
    retry_ns=NS_PER_S,
    retry_jitter_ns=NS_PER_S // 5,
    give_up_ns=8 * NS_PER_S,
    give_up_ack=Ack.OPERATION_CANCELLED,
    atomic=False,
    home_in_slot_0=True,
    wrong_seq=Ack.INVALID_SEQUENCE,
    repeated_last=Ack.ERROR,
    restart_anywhere=True,
    foreign_count=Ack.DENIED,
    foreign_list=Ack.DENIED,
    client_can_cancel=False,
    downloads_are_transfers=False,
    capacity=650,
    check=check_ardupilot,
    stored=stored_by_ardupilot,
)


class ArduRunner(Runner):
    """AUTO of ArduPilot: stays in AUTO when the mission is over; a new mission keeps the old index."""

    @property
    def _running(self) -> bool:
        return self.core.mode.does is Does.AUTO and self.state == ACTIVE

    def enter(self) -> None:
        if self.state == COMPLETE or not 0 < self.index < len(self.items):
            self.reset_jumps()
            self._start(1)
        else:
            self._start(self.index)

    def leave(self) -> None:
        self.leg = None
        if self.state == ACTIVE:
            self.state = NOT_STARTED

    def start_again(self) -> None:
        """MISSION_START on a copter: go on from the index, or from the first item when all was done."""
        self.core.lift = self.core.lift or self.core.landed
        self.enter()

    def done(self) -> None:
        core, seq = self.core, self.index
        item = self.leg
        if item is not None and item.command <= NAV_LAST:
            core.emit("MISSION_ITEM_REACHED", seq=seq)
            if item.command != TAKEOFF:
                core.text(6, f"Reached command #{seq}" if core.is_copter else f"Reached waypoint #{seq}")
        following = self.following()
        if 0 < following < len(self.items):
            self._start(following)
        else:
            self._complete()
        self.announce()

    def changed(self, seq: int | None) -> None:
        self.core.params.put("MIS_TOTAL", len(self.items))
        if not self._running:
            if not self.items:
                self.index, self.state, self.leg = 0, NOT_STARTED, None
        elif seq is not None and self.index < len(self.items):
            self._start(self.index)
            self.core.text(2, "Auto mission changed, restarted command")

    def received(self) -> None:
        if self.state == NO_MISSION:
            self.state = NOT_STARTED
        self.core.text(6, "Flight plan received")
        self.announce()

    def set_current(self, seq: int) -> None:
        if not self.choose(seq, reset=False):
            self.core.text(2, "Mission item does not exist")

    def choose(self, seq: int, reset: bool) -> bool:
        """DO_SET_MISSION_CURRENT: False out of range. Only `reset` starts what is complete."""
        seq = seq or 1
        if not 0 < seq < len(self.items):
            return False
        if reset:
            self.reset_jumps()
        if reset or self._running:
            self._start(seq)
        else:
            self.index, self.state, self.leg = seq, NOT_STARTED, None
        self.announce()
        return True

    def announce(self) -> None:
        """Send MISSION_CURRENT now."""
        self.core.emit("MISSION_CURRENT", **mission_current(self.core))

    def acceptance_m(self, item: Item) -> float:
        return self.core.params["WPNAV_RADIUS"] / 100 if self.core.is_copter else self.core.params["WP_RADIUS"]

    def _start(self, index: int) -> None:
        self.state = ACTIVE
        if self.core.mode.does is Does.AUTO:
            self.begin(index)
        else:
            self.index = index
        self.core.text(6, f"Mission: {index} {_ITEM_NAMES.get(self.items[index].command, 'Do')}")

    def _complete(self) -> None:
        core = self.core
        self.state, self.leg = COMPLETE, None
        if isinstance(core.nav, Goal):
            core.nav = replace(core.nav, exit_m_s=0.0)
        if core.is_copter:
            return
        core.text(5, "Mission Complete")
        behave = _DONE_BEHAVE.get(int(core.params["MIS_DONE_BEHAVE"]))
        if behave is not None:
            core.enter(by_name(core.stack.modes, behave))


def mission_current(core: Core) -> Fields:
    """MISSION_CURRENT: the total excludes home; the index is kept even where it lies behind the end."""
    total = max(0, len(core.server.items) - 1)
    runner = core.runner
    return {
        "seq": runner.index, "total": total, "mission_state": runner.state if total else NO_MISSION,
        "mission_mode": int(core.mode.does is Does.AUTO),
    }  # fmt: skip
