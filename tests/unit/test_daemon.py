"""The daemon's loop in virtual time: what it does when all is well, and what when each of its inputs fails."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from fake_ports import TICK_NS, Rig

from gatar_edge.allocators.base import Allocation
from gatar_edge.allocators.greedy import Greedy
from gatar_edge.daemon import IDLE_NS, POLL_NS
from gatar_edge.errors import DeadlineError
from gatar_edge.keys import DEMO_KEY
from gatar_edge.message import decode
from gatar_edge.types import NS_PER_S, Goto, Hold, TaskKind
from gatar_edge.view import View


class Flaky:
    """A model that does as it is told."""

    name = "gatar"
    mood = "well"

    def allocate(self, view: View) -> Allocation:
        if self.mood == "late":
            raise DeadlineError("the allocator took more than 100 ms")
        allocation = Greedy().allocate(view)
        if self.mood == "nan":
            return Allocation(allocation.choices, np.full_like(allocation.scores, np.nan))
        return allocation


def talk(*rigs: Rig, seconds: float, **run: Any) -> None:
    """Let daemons run side by side on one ideal radio."""
    for _ in range(int(seconds * 5)):
        for rig in rigs:
            rig.run(0.2, **run)
            sent, rig.radio.sent = rig.radio.sent, []
            for other in rigs:
                if other is not rig:
                    other.radio.arrived += sent


def test_a_target_in_view_becomes_a_command_and_a_claim_within_one_tick() -> None:
    rig = Rig()
    rig.run(0.2)
    assert rig.vehicle.commands == [Goto((5, 5))]
    message = decode(rig.radio.sent[0], DEMO_KEY)
    assert (message.task, message.task_cell) == (TaskKind.TARGET, (5, 5))
    assert rig.last.problems == []


def test_the_loop_ticks_at_its_rate_however_often_it_is_woken() -> None:
    rig = Rig()
    rig.run(10, step_ns=NS_PER_S // 1000, seeing=False)
    assert rig.daemon.counters.ticks == 50
    assert rig.vehicle.polls == 10_000


def test_the_loop_sleeps_until_a_tick_or_a_timer_is_due_but_never_for_long() -> None:
    def slept_ns(timer_ns: int, tick_ns: int = TICK_NS) -> int:
        rig = Rig(start_ns=0, tick_ns=tick_ns)
        rig.vehicle.timer_ns = timer_ns
        rig.daemon.step(0)
        return rig.daemon.due_ns

    assert slept_ns(NS_PER_S) == TICK_NS
    assert slept_ns(POLL_NS + 1) == POLL_NS + 1
    assert slept_ns(0) == POLL_NS  # due at any time: not at once, or the loop would spin
    assert slept_ns(NS_PER_S, tick_ns=NS_PER_S) == IDLE_NS


def test_a_message_is_relayed_before_the_next_tick() -> None:
    author, relay, far = Rig(1), Rig(2), Rig(3)
    far.see = lambda: Rig.see(far, cell=(6, 0))  # type: ignore[method-assign]
    author.see = lambda: Rig.see(author, cell=(0, 5))  # type: ignore[method-assign]
    author.run(0.2)
    far.run(0.2)
    relay.radio.arrived += far.radio.sent
    relay.run(0.2)
    relay.radio.sent.clear()
    relay.radio.arrived += author.radio.sent
    relay.daemon.step(relay.now_ns - TICK_NS // 2)
    assert [decode(data, DEMO_KEY).hops for data in relay.radio.sent] == [1]


def test_stale_perception_holds_the_vehicle_gives_the_task_back_and_says_so() -> None:
    rig = Rig()
    rig.run(1)
    rig.run(3.4, seeing=False)
    assert rig.vehicle.commands[-1] == Hold("no_perception")
    assert "perception is" in rig.last.problems[0]
    message = decode(rig.radio.sent[-1], DEMO_KEY)
    assert (message.task, message.speed_cells_s) == (TaskKind.HOLD, 0.0)
    rig.run(0.4)
    assert rig.vehicle.commands[-1] == Goto((5, 5))


@pytest.mark.parametrize("fault", [{"connected": False}, {"ready": False}, {"position_age_ns": 2 * NS_PER_S}])
def test_a_vehicle_that_cannot_be_commanded_leaves_the_allocation_to_the_others(fault: dict[str, Any]) -> None:
    near, far = Rig(1), Rig(2)
    far.see = lambda: Rig.see(far, cell=(0, 5))  # type: ignore[method-assign]
    near.see = lambda: Rig.see(near, cell=(4, 5))  # type: ignore[method-assign]
    talk(near, far, seconds=2)
    assert near.vehicle.commands[-1] == Goto((5, 5))
    assert far.vehicle.commands[-1] != Goto((5, 5))
    for name, value in fault.items():
        setattr(near.vehicle, name, value)
    talk(near, far, seconds=0.6)  # three ticks
    assert near.vehicle.commands[-1] == Hold("no_vehicle")
    assert far.vehicle.commands[-1] == Goto((5, 5))


def test_a_robot_that_dies_is_replaced_within_three_ticks_of_its_being_noticed() -> None:
    near, far = Rig(1), Rig(2)
    far.see = lambda: Rig.see(far, cell=(0, 5))  # type: ignore[method-assign]
    near.see = lambda: Rig.see(near, cell=(4, 5))  # type: ignore[method-assign]
    talk(near, far, seconds=2)
    talk(far, seconds=3)  # the age at which a neighbour leaves the graph
    talk(far, seconds=0.6)
    assert far.vehicle.commands[-1] == Goto((5, 5))


@pytest.mark.parametrize("mood", ["late", "nan"])
def test_a_late_or_broken_model_is_replaced_by_the_fallback_and_three_in_a_row_are_critical(mood: str) -> None:
    model = Flaky()
    rig = Rig(allocator=model)
    rig.run(1)
    model.mood = mood
    rig.run(0.4)
    assert rig.vehicle.commands[-1] == Goto((5, 5))
    assert not rig.vehicle.is_critical
    rig.run(0.2)
    assert rig.vehicle.is_critical
    assert rig.last.counters["fallbacks"] == 3
    assert rig.last.counters["late"] == (3 if mood == "late" else 0)
    assert "gatar failed" in rig.last.problems[0]
    model.mood = "well"
    rig.run(0.2)
    assert not rig.vehicle.is_critical


def test_a_target_that_the_vehicle_cannot_reach_is_given_back_and_tried_again_after_a_minute() -> None:
    rig = Rig()
    rig.see = lambda: Rig.see(rig, targets=[(5, 5), (9, 9)])  # type: ignore[method-assign]
    rig.vehicle.refuses = (5, 5)
    rig.run(0.2)
    assert rig.vehicle.commands == [Goto((5, 5))]
    rig.run(1)
    assert rig.vehicle.commands[1:] == [Goto((9, 9))] * 5
    assert rig.log.of("decision")[-1][0].shunned == ((5, 5),)
    rig.see = lambda: Rig.see(rig, targets=[(5, 5)])  # type: ignore[method-assign]
    rig.agent.belief = rig.agent.belief.copy()
    rig.agent.belief[9, 9] = 4
    rig.run(0.4)
    assert rig.vehicle.commands[-1] == Hold("nothing_left")
    rig.run(60)
    assert Goto((5, 5)) in rig.vehicle.commands[7:]


def test_shadow_mode_decides_and_logs_but_commands_and_claims_nothing() -> None:
    rig = Rig(dry_run=True)
    rig.vehicle.ready = False  # nobody arms it for us
    rig.run(1)
    assert rig.vehicle.commands == []
    decision, wanted, sent, _ = rig.log.of("decision")[-1]
    assert decision.assignment.kind is TaskKind.TARGET
    assert (wanted, sent) == (Goto((5, 5)), Hold("dry run"))
    message = decode(rig.radio.sent[-1], DEMO_KEY)
    assert (message.task, message.speed_cells_s) == (TaskKind.HOLD, 0.0)


def test_what_queued_up_while_the_process_was_stopped_is_not_taken_for_fresh() -> None:
    rig = Rig()
    rig.run(1)
    for _ in range(20):
        rig.see()
    rig.now_ns += 10 * NS_PER_S
    rig.run(0.2, seeing=False)
    assert rig.vehicle.commands[-1] == Hold("no_perception")
    assert rig.daemon.counters.stalls == 1
    assert rig.daemon.counters.ticks_skipped == 50
    ticks = rig.daemon.counters.ticks
    rig.run(0.2, step_ns=NS_PER_S // 1000, seeing=False)
    assert rig.daemon.counters.ticks == ticks + 1  # missed ones are not made up for
    rig.run(0.2)
    assert rig.vehicle.commands[-1] == Goto((5, 5))


def test_stopping_holds_the_vehicle_and_waits_for_it() -> None:
    rig = Rig()
    rig.run(1)
    assert rig.daemon.stop(rig.now_ns)
    assert rig.vehicle.commands[-1] == Hold("stopped")


def test_stopping_leaves_the_vehicle_to_its_last_order_where_so_configured() -> None:
    rig = Rig(on_stop="leave")
    rig.run(1)
    assert rig.daemon.stop(rig.now_ns)
    assert rig.vehicle.commands[-1] == Goto((5, 5))


def test_a_vehicle_that_was_sent_home_gets_no_other_order() -> None:
    rig = Rig(on_stop="return")
    rig.run(1)
    assert rig.daemon.stop(rig.now_ns)
    assert rig.vehicle.commands[-1] == Goto((5, 5))
    assert rig.vehicle.sent_home


def test_a_dry_run_sends_nothing_home() -> None:
    rig = Rig(on_stop="return", dry_run=True)
    rig.run(1)
    assert rig.daemon.stop(rig.now_ns)
    assert not rig.vehicle.sent_home


def test_the_state_is_saved_once_a_period_not_once_a_tick() -> None:
    rig = Rig()
    rig.run(10)
    assert len(rig.saver.states) == 10
    assert rig.saver.states[-1].next_seq > 40


def test_a_log_that_stopped_and_a_state_that_cannot_be_saved_are_problems_not_ends() -> None:
    rig = Rig()
    rig.log.stopped = "recording stopped: No space left on device"
    rig.saver.last_error = "No space left on device"
    rig.daemon._ports = dataclasses.replace(rig.daemon._ports, radio_problem=lambda: "nobody is there")
    rig.run(1)
    assert len(rig.last.problems) == 3
    assert rig.vehicle.commands[-1] == Goto((5, 5))


def test_a_flood_of_forged_and_replayed_messages_changes_nothing_and_does_not_fill_the_log() -> None:
    rig, other = Rig(1), Rig(2)
    talk(rig, other, seconds=1)
    before = rig.vehicle.commands[-1]
    other.run(0.2)
    genuine = other.radio.sent[-1]
    rig.radio.arrived += [genuine]
    rig.run(0.2)
    rig.log.calls.clear()
    for _ in range(5):
        rig.radio.arrived += [genuine] * 100 + [genuine[:-1] + b"x"] * 50 + [b"\x00" * 127] * 50
        rig.run(0.2)
    assert rig.vehicle.commands[-1] == before
    assert len(rig.last.neighbors) == 1
    assert len(rig.log.of("heard")) == 5 * 16


def test_a_neighbour_whose_clock_is_an_hour_off_is_a_neighbour_like_any_other() -> None:
    for skew_s in (-3600, -5, 5, 3600):
        rig, other = Rig(1), Rig(2, start_ns=(5000 + skew_s) * NS_PER_S)
        talk(rig, other, seconds=1)
        assert [n.robot_id for n in rig.last.neighbors] == [2]
        assert rig.last.neighbors[0].age_s < 1
        rig.run(4)
        assert rig.last.neighbors == []


def test_a_neighbour_with_another_configuration_or_key_is_told_of() -> None:
    rig, other = Rig(1), Rig(2)
    other.run(0.2)
    rig.agent.neighbors._config_digest ^= 1
    rig.radio.arrived += [*other.radio.sent, bytes([other.radio.sent[0][0]]) * 127]
    rig.run(0.2)
    lines = [text for _, _, text, _ in rig.log.of("text")]
    assert any("another [grid] or [team]" in line for line in lines)
    assert any("wrong signature" in line for line in lines)


def test_all_counters_go_to_the_log_every_ten_seconds() -> None:
    rig = Rig()
    rig.run(25)
    lines = [text for _, _, text, _ in rig.log.of("text") if text.startswith("counters ")]
    assert len(lines) == 2
    assert "budget_bytes_sent=" in lines[0]
    assert "ticks=51" in lines[0]


def test_observe_hear_decide_and_send_are_logged_in_the_order_in_which_the_agent_met_them() -> None:
    rig, other = Rig(1), Rig(2)
    other.run(0.2)
    rig.radio.arrived += other.radio.sent
    rig.run(0.2)
    kept = [name for name, _ in rig.log.calls if name in {"observation", "heard", "decision", "sent"}]
    assert kept == ["heard", "sent", "observation", "decision", "sent"]
