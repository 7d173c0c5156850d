"""The process around the daemon: opens what is configured, waits, and ends in the configured safe state."""

from __future__ import annotations

import contextlib
import selectors
import signal
import socket
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from gatar_edge.agent import Agent
from gatar_edge.bridge.driver import VehicleDriver
from gatar_edge.bridge.link import open_link
from gatar_edge.daemon import POLL_NS, STOP_NS, Daemon, Ports, Settings
from gatar_edge.deadline import Punctual, ThreadRunner
from gatar_edge.health import Snapshot
from gatar_edge.journal import Journal
from gatar_edge.perception import Perception
from gatar_edge.perception_link import PerceptionSocket
from gatar_edge.persist import StateSaver, restore
from gatar_edge.preflight import Prepared, open_radio
from gatar_edge.record import Recorder
from gatar_edge.runinfo import describe_run
from gatar_edge.transports.budget import ByteBudget
from gatar_edge.types import NS_PER_S
from gatar_edge.vehicle_config import VehicleConfig
from gatar_edge.vehicle_port import AutopilotPort
from gatar_edge.watch import HttpWatch, Notifier

Clock = Callable[[], int]


class Waiter:
    """Sleeps until a socket has something, a signal comes, or the time is up."""

    def __init__(self, sockets: Sequence[int]) -> None:
        self._selector = selectors.DefaultSelector()
        self._wake, self._woken = socket.socketpair()
        self._wake.setblocking(False)
        self._woken.setblocking(False)
        for fileno in (*sockets, self._woken.fileno()):
            self._selector.register(fileno, selectors.EVENT_READ)

    def wait(self, duration_ns: int) -> None:
        """Wait for at most `duration_ns`."""
        self._selector.select(max(0, duration_ns) / NS_PER_S)
        with contextlib.suppress(BlockingIOError):
            self._woken.recv(64)

    def wake(self) -> None:
        """End the wait; may be called from a signal handler."""
        with contextlib.suppress(BlockingIOError):
            self._wake.send(b"\0")

    def close(self) -> None:
        """Give the sockets back."""
        self._selector.close()
        self._wake.close()
        self._woken.close()


class Waits(Protocol):
    """What `serve` needs of a `Waiter`."""

    def wait(self, duration_ns: int) -> None: ...


@dataclass(slots=True)
class Orders:
    """What signals ask for."""

    stop: bool = False
    enable: bool = False


@dataclass(frozen=True, slots=True)
class Process:
    """A daemon with everything open."""

    daemon: Daemon
    vehicle: AutopilotPort
    waiter: Waiter
    notifier: Notifier
    clock_ns: Clock


def serve(process: Process, orders: Orders) -> None:
    """Run until told to stop; then bring the vehicle into the configured state, at most three seconds long."""
    daemon, clock_ns = process.daemon, process.clock_ns
    while not orders.stop:
        now_ns = clock_ns()
        if orders.enable:
            orders.enable = False
            daemon.journal.info("told to command again", now_ns)
            process.vehicle.enable(now_ns)
        daemon.step(now_ns)
        process.waiter.wait(daemon.due_ns - clock_ns())
    process.notifier.stopping()
    end_ns = clock_ns() + STOP_NS
    while not daemon.stop(clock_ns()) and clock_ns() < end_ns:
        process.waiter.wait(POLL_NS)
    daemon.journal.info("stopped", clock_ns())


@contextlib.contextmanager
def listening_to_signals(orders: Orders, waiter: Waiter) -> Iterator[None]:
    """SIGTERM and SIGINT stop; SIGUSR1 takes the vehicle back after a pilot had it."""

    def stop(*_: object) -> None:
        orders.stop = True
        waiter.wake()

    def enable(*_: object) -> None:
        orders.enable = True
        waiter.wake()

    handlers = {signal.SIGTERM: stop, signal.SIGINT: stop, signal.SIGUSR1: enable}
    before = {number: signal.signal(number, handler) for number, handler in handlers.items()}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def opened(prepared: Prepared, clock_ns: Clock, *, dry_run: bool) -> Iterator[Process]:
    """Open sockets, log and state, and close them at the end, the log last. Raises LinkError and LogError."""
    config = prepared.config
    with contextlib.ExitStack() as stack:
        log = _open_log(prepared, clock_ns())
        if log is not None:
            stack.callback(log.close)
        journal = Journal(config.robot.id, log)
        radio = open_radio(config)
        stack.callback(radio.close)
        perception = PerceptionSocket(config.perception.listen, allow_remote=config.perception.allow_remote)
        stack.callback(perception.close)
        link = open_link(config.vehicle.url)
        stack.callback(link.close)
        agent = _make_agent(prepared, journal, log, clock_ns())
        saver = _open_saver(config)
        watchers: list[Callable[[Snapshot], None]] = []
        notifier = Notifier()
        watchers.append(notifier.published)
        if config.watch.http:
            http = HttpWatch(config.watch.http, clock_ns)
            stack.callback(http.close)
            watchers.append(http.published)
        driver = VehicleDriver(prepared.driver, clock_ns())
        if config.vehicle.launch == "auto" and not dry_run:
            driver.launch()
        by_hand = config.vehicle.launch == "armed" and not dry_run
        vehicle = AutopilotPort(driver, link, journal, log, launch_when_armed=by_hand)
        ports = Ports(radio, perception, vehicle, clock_ns, log, saver, _to_all(watchers))
        daemon = Daemon(
            agent,
            Perception(config.robot.id, config.kind, config.grid_spec),
            ByteBudget(config.net.bytes_per_s, sends=radio.sends),
            ports,
            _settings(config, dry_run=dry_run),
        )
        if saver is not None:
            stack.callback(saver.close)
            stack.callback(lambda: saver.save_soon(daemon.state()))  # runs before close
        waiter = Waiter([radio.fileno(), perception.fileno(), link.fileno()])
        stack.callback(waiter.close)
        yield Process(daemon, vehicle, waiter, notifier, clock_ns)


def _settings(config: VehicleConfig, *, dry_run: bool) -> Settings:
    return Settings(
        tick_ns=int(NS_PER_S / config.loop.tick_hz),
        save_ns=int(config.state.period_s * NS_PER_S),
        dry_run=dry_run,
        hold_on_stop=config.vehicle.on_stop == "hold",
    )


def _make_agent(prepared: Prepared, journal: Journal, log: Recorder | None, now_ns: int) -> Agent:
    allocator = Punctual(prepared.allocator, prepared.config.loop.deadline_ms / 1000, ThreadRunner())
    agent = Agent(prepared.identity, prepared.config.agent, allocator, prepared.key, prepared.seq)
    restored = prepared.restored
    journal.info("saved state", now_ns, outcome=restored.outcome.value, next_seq=prepared.seq)
    if restored.state is not None:
        restore(agent, restored.state)
        if log is not None:
            log.takes_over(restored.state, now_ns)
    return agent


def _open_saver(config: VehicleConfig) -> StateSaver | None:
    return StateSaver(Path(config.state.file)) if config.state.file else None


def _open_log(prepared: Prepared, now_ns: int) -> Recorder | None:
    config = prepared.config
    if not config.log.folder:
        return None
    stamp = time.strftime("%Y%m%dT%H%M%S", time.gmtime(now_ns / NS_PER_S))
    path = Path(config.log.folder) / f"{config.kind.name.lower()}{config.robot.id}-{stamp}Z.mcap"
    info = describe_run(
        config.agent,
        [prepared.identity],
        config.model.allocator,
        model=config.model.file,
        first_seqs={config.robot.id: prepared.seq},
        extra={"simulated": False, "restored": prepared.restored.outcome.value},
    )
    return Recorder(path, info, now_ns)


def _to_all(watchers: Sequence[Callable[[Snapshot], None]]) -> Callable[[Snapshot], None]:
    def publish(snapshot: Snapshot) -> None:
        for watcher in watchers:
            watcher(snapshot)

    return publish
