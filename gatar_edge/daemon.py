"""The daemon's loop: one thread that hears, looks, decides, commands and records.

`Daemon` holds no socket and no clock of its own: time and ports are handed in, so that a day passes in seconds in a
test. The heartbeat to the autopilot leaves from this loop alone: a loop that hangs falls silent, and the autopilot's
own failsafe acts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal

from msgspec.structs import replace

from gatar_edge.agent import Agent
from gatar_edge.health import Counters, NeighborLine, Shunned, Snapshot, usable
from gatar_edge.journal import Journal
from gatar_edge.neighbors import HearOutcome, Neighbor
from gatar_edge.perception import Perception
from gatar_edge.persist import SavedState, snapshot
from gatar_edge.ports import Ports
from gatar_edge.separation import occupied
from gatar_edge.tasks import to_command
from gatar_edge.transports.budget import ByteBudget
from gatar_edge.types import (
    NS_PER_S,
    Decision,
    Hold,
    Reason,
    TaskKind,
    VehicleCommand,
    VehicleState,
)

POLL_NS = NS_PER_S // 20  # the shortest wait for a timer of the autopilot's protocols
IDLE_NS = NS_PER_S // 4  # the longest wait: the log flushes what it holds, and a link that is lost is opened again
STALL_NS = NS_PER_S  # after standing still for this long, what waits in the sockets is older than it looks
WAKE_NS = 2 * NS_PER_S  # in which a restarted robot first hears its eyes and its vehicle, and decides nothing
STOP_NS = 3 * NS_PER_S  # for the vehicle to confirm that it holds
MAX_USELESS_LOGGED = 16  # a tick: heard datagrams without effect, so that a flood does not fill the disk
COUNTERS_NS = 10 * NS_PER_S  # how often all counters go to the log
_STRANGE = {
    HearOutcome.FORGED: "message with a wrong signature: another team, another key, or an attack",
    HearOutcome.FOREIGN_CONFIG: "neighbour with another [grid] or [team] configuration: not heard",
    HearOutcome.VERSION: "neighbour with another version of the message: not heard",
}
_EFFECTIVE = (HearOutcome.ACCEPTED, HearOutcome.NEARER, HearOutcome.TALK)


@dataclass(frozen=True, slots=True)
class Settings:
    """What of the configuration the loop itself needs."""

    tick_ns: int = NS_PER_S // 5
    save_ns: int = NS_PER_S
    dry_run: bool = False
    on_stop: Literal["hold", "return", "leave"] = "hold"


class Daemon:
    """One robot's loop. Call `step` whenever something has come in, and no later than `due_ns`."""

    def __init__(
        self, agent: Agent, perception: Perception, budget: ByteBudget, ports: Ports, settings: Settings
    ) -> None:
        self.agent = agent
        self.agent.shadow = settings.dry_run
        self.perception = perception
        self.budget = budget
        self.counters = Counters()
        self.journal = Journal(agent.identity.robot_id, ports.log)
        self._ports = ports
        self._settings = settings
        self._robot_id = agent.identity.robot_id
        self._started_ns = self._stepped_ns = self._tick_due_ns = self._save_due_ns = ports.clock_ns()
        self._count_due_ns = self._started_ns + COUNTERS_NS
        # until then a task taken over from before a restart is not given up for want of a first heartbeat
        self._wakes_ns = self._started_ns + WAKE_NS if agent.task.kind is not TaskKind.HOLD else self._started_ns
        self._reason = Reason.NOTHING_LEFT
        self._useless_logged = 0
        self._shunned = Shunned()

    @property
    def due_ns(self) -> int:
        """When `step` must be called again, whatever comes in."""
        vehicle_ns = max(self._stepped_ns + POLL_NS, self._ports.vehicle.due_ns(self._stepped_ns))
        return min(self._tick_due_ns, vehicle_ns, self._stepped_ns + IDLE_NS)

    def step(self, now_ns: int) -> None:
        """Take in what has come, and do what is due at `now_ns`."""
        if now_ns - self._stepped_ns > STALL_NS:
            self._stalled(now_ns)
        self._stepped_ns = now_ns
        self._listen(now_ns)
        self._ports.vehicle.receive(now_ns)
        self._look(now_ns)
        if now_ns >= self._tick_due_ns and self._awake(now_ns):
            self._tick(now_ns)
        self._ports.vehicle.poll(now_ns)
        if self._ports.log is not None:
            self._ports.log.poll(now_ns)

    def stop(self, now_ns: int) -> bool:
        """One step towards the end, as often as `step`; true when the vehicle is in the configured safe state."""
        vehicle = self._ports.vehicle
        vehicle.receive(now_ns)
        on_stop = "leave" if self._settings.dry_run else self._settings.on_stop
        there = on_stop == "leave"
        if on_stop == "hold":
            vehicle.command(Hold("stopped"), now_ns)
        elif on_stop == "return":
            there = vehicle.return_home(now_ns)
        vehicle.poll(now_ns)
        self._stepped_ns = now_ns
        return there or (on_stop == "hold" and vehicle.holding(now_ns))

    def state(self) -> SavedState:
        """What survives a restart."""
        return snapshot(self.agent, self._ports.clock_ns(), self._ports.vehicle.memory())

    def _stalled(self, now_ns: int) -> None:
        """What queued up while the loop stood still would be taken for fresh: throw it away, it comes again.

        Not so the autopilot's: only in its own order does it tell whether the vehicle or a pilot changed the mode.
        """
        for source in (self._ports.radio, self._ports.perception):
            while source.receive():
                pass
        self.counters.stalls += 1
        self.journal.warning("loop stood still", now_ns, seconds=(now_ns - self._stepped_ns) / NS_PER_S)

    def _listen(self, now_ns: int) -> None:
        """Hear the neighbours; what they may have missed from each other is passed on at once."""
        relays = []
        for data in self._ports.radio.receive():
            heard = self.agent.hear(data, now_ns)
            if heard.outcome in _EFFECTIVE:
                if heard.relay is not None:
                    relays.append(heard.relay)
            else:
                if heard.outcome in _STRANGE:
                    self.journal.warning(_STRANGE[heard.outcome], now_ns)
                self._useless_logged += 1
                if self._useless_logged > MAX_USELESS_LOGGED:
                    continue
            if self._ports.log is not None:
                self._ports.log.heard(self._robot_id, data, heard.outcome.value, now_ns)
        if relays:
            self._send((), relays, now_ns)

    def _awake(self, now_ns: int) -> bool:
        """Whether it is time to decide; the first tick counts from then."""
        if self._wakes_ns > now_ns:
            seen, state = self.perception.age_ns(now_ns) is not None, self._ports.vehicle.state(now_ns)
            if not (seen and usable(state, now_ns, self._settings.dry_run)):
                self._tick_due_ns = now_ns + POLL_NS
                return False
            self._wakes_ns = self._tick_due_ns = now_ns
        return True

    def _look(self, now_ns: int) -> None:
        for data in self._ports.perception.receive():
            observation = self.perception.take(data, now_ns, self._ports.vehicle.cell())
            if observation is None:
                self.journal.warning("observation dropped", now_ns, last_malformed=self.perception.last_error)
                continue
            self.agent.observe(observation)
            if self._ports.log is not None:
                self._ports.log.observation(observation)

    def _tick(self, now_ns: int) -> None:
        behind = (now_ns - self._tick_due_ns) // self._settings.tick_ns
        self._tick_due_ns += (behind + 1) * self._settings.tick_ns
        self.counters.ticks_skipped += behind
        self._useless_logged = 0
        vehicle = self._ports.vehicle
        state = vehicle.state(now_ns)
        self.agent.has_vehicle = usable(state, now_ns, self._settings.dry_run)
        self._give_up(now_ns)
        decision = self.agent.decide(now_ns)
        decision = replace(decision, latency_ns=self._ports.clock_ns() - now_ns)
        wanted = to_command(self.agent.identity.kind, decision.assignment)
        heard, me = self.agent.neighbors.fresh(now_ns, decision.cell), self.agent.identity
        vehicle.neighbors(occupied(me.robot_id, me.kind, heard, self.agent.config.grid))
        sent = wanted if self._settings.dry_run else vehicle.command(wanted, now_ns)
        self._account(decision, wanted, sent, now_ns)
        self._record(decision, wanted, sent, state, now_ns)
        self._send((self.agent.beacon(now_ns), *self.agent.negotiate(now_ns)), (), now_ns)
        if self._ports.saver is not None and now_ns >= self._save_due_ns:
            self._save_due_ns = now_ns + self._settings.save_ns
            self._ports.saver.save_soon(self.state())
        self._ports.published(now_ns, partial(self._snapshot, decision, state, heard, now_ns))
        if now_ns >= self._count_due_ns:
            self._count_due_ns = now_ns + COUNTERS_NS
            self.journal.note(f"counters {' '.join(f'{k}={v}' for k, v in self._all_counters().items() if v)}", now_ns)

    def _give_up(self, now_ns: int) -> None:
        """A goal that the vehicle refuses or does not get nearer to is left to the others for a while."""
        task = self.agent.task
        if task.kind is not TaskKind.HOLD and self._ports.vehicle.failed():
            self._shunned.failed(task.cell, now_ns)
            self.counters.shunned += 1
            self.journal.warning("vehicle cannot go there: giving it back", now_ns, x=task.cell[0], y=task.cell[1])
        self.agent.shunned = self._shunned.cells(now_ns)

    def _send(self, own: Sequence[bytes], relays: Sequence[bytes], now_ns: int) -> None:
        for data in self.budget.admit(own, relays, now_ns):
            self._ports.radio.send(data)
            if self._ports.log is not None:
                self._ports.log.sent(self._robot_id, data, now_ns)

    def _account(self, decision: Decision, wanted: VehicleCommand, sent: VehicleCommand, now_ns: int) -> None:
        was_critical = self.counters.critical
        self.counters.decided(decision)
        self.counters.commands_changed += sent != wanted
        self._ports.vehicle.critical(self.counters.critical)
        if self.counters.critical and not was_critical:
            self.journal.error("allocator keeps failing", now_ns, fallback=decision.fallback)
        elif decision.fallback:
            self.journal.warning("fallback allocator", now_ns, why=decision.fallback, used=decision.allocator)
        reason = decision.assignment.reason
        stopped = {Reason.NO_PERCEPTION, Reason.NO_VEHICLE}
        if reason is not self._reason and {reason, self._reason} & stopped:
            say = self.journal.warning if reason in stopped else self.journal.info
            say(f"{'holding' if reason in stopped else 'going on'}: {reason.value}", now_ns)
        self._reason = reason

    def _record(
        self, decision: Decision, wanted: VehicleCommand, sent: VehicleCommand, state: VehicleState, now_ns: int
    ) -> None:
        log = self._ports.log
        if log is None:
            return
        log.decision(decision, wanted, Hold("dry run") if self._settings.dry_run else sent, now_ns)
        log.vehicle(self._robot_id, state, now_ns)
        log.belief(self._robot_id, self.agent.belief, self.agent.config.grid, now_ns)

    def _snapshot(self, decision: Decision, state: VehicleState, heard: Sequence[Neighbor], now_ns: int) -> Snapshot:
        age_ns = self.perception.age_ns(now_ns)
        saver, log = self._ports.saver, self._ports.log
        return Snapshot(
            robot_id=self._robot_id,
            kind=self.agent.identity.kind.name,
            allocator=self.agent.allocator.name,
            dry_run=self._settings.dry_run,
            t_ns=now_ns,
            uptime_s=(now_ns - self._started_ns) / NS_PER_S,
            cell=decision.cell,
            task=decision.assignment.kind.name,
            task_cell=decision.assignment.cell,
            reason=decision.assignment.reason.value,
            neighbors=[_neighbor_line(neighbor, now_ns) for neighbor in heard],
            vehicle_connected=state.connected,
            vehicle_ready=state.ready,
            vehicle_mode=state.mode,
            vehicle_phase=state.phase,
            battery_percent=state.battery_percent,
            perception_age_s=None if age_ns is None else age_ns / NS_PER_S,
            perception_rate_hz=self.perception.rate_hz(now_ns),
            decision_ms=decision.latency_ns / 1e6,
            fallbacks_in_a_row=self.counters.fallbacks_in_a_row,
            radio_problem=self._ports.radio_problem(),
            log_problem=log.stopped if log is not None else "",
            state_problem=f"state is not saved: {saver.last_error}" if saver is not None and saver.last_error else "",
            counters=self._all_counters(),
        )

    def _all_counters(self) -> dict[str, int]:
        counters = {name: getattr(self.counters, name) for name in self.counters.__slots__}
        del counters["fallbacks_in_a_row"]  # goes up and down
        groups = (("link", self._ports.radio.counters), ("budget", self.budget.counters))
        counters |= {f"{group}_{name}": getattr(of, name) for group, of in groups for name in of.__slots__}
        counters |= {f"heard_{outcome.value}": count for outcome, count in self.agent.neighbors.counters.items()}
        return counters | {f"observation_{outcome.value}": n for outcome, n in self.perception.counters.items()}


def _neighbor_line(neighbor: Neighbor, now_ns: int) -> NeighborLine:
    told = neighbor.message
    return NeighborLine(
        told.robot_id,
        told.kind.name,
        told.cell,
        told.task.name,
        told.task_cell,
        neighbor.age_ns(now_ns) / NS_PER_S,
        told.hops,
    )
