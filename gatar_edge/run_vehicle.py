"""The process around the daemon: opens what is configured, waits, and ends in the configured safe state."""

from __future__ import annotations

import contextlib
import select
import signal
import socket
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from gatar_edge.agent import Agent
from gatar_edge.bridge.driver import VehicleDriver
from gatar_edge.bridge.link import Link, open_link
from gatar_edge.daemon import POLL_NS, STOP_NS, Daemon, Settings
from gatar_edge.deadline import ThreadRunner, punctual
from gatar_edge.driver_memory import NOTHING
from gatar_edge.foxglove import Level
from gatar_edge.health import Snapshot
from gatar_edge.journal import Journal
from gatar_edge.notify import Notifier
from gatar_edge.perception import Perception
from gatar_edge.perception_link import PerceptionSocket
from gatar_edge.persist import StateSaver, restore
from gatar_edge.ports import Ports, Watcher
from gatar_edge.preflight import Prepared
from gatar_edge.record import Recorder
from gatar_edge.record_items import carried_state
from gatar_edge.rotate import Ring, RotatingLog, make_room
from gatar_edge.runinfo import describe_run
from gatar_edge.transports.base import Transport
from gatar_edge.transports.budget import ByteBudget
from gatar_edge.transports.udp import UdpTransport
from gatar_edge.types import NS_PER_S
from gatar_edge.vehicle_config import VehicleConfig
from gatar_edge.vehicle_port import AutopilotPort

Clock = Callable[[], int]
# After the first datagram wait this long for more: neighbours that pass on what they hear come in bursts, and waking
# for each of them costs twice the processor time.
GATHER_NS = 5_000_000


class Waiter:
    """Sleeps until a socket has something, a signal comes, or the time is up.

    Asks each time for the sockets' numbers: a connection that was opened again has another one, or -1 while it is lost.
    """

    def __init__(self, filenos: Sequence[Callable[[], int]]) -> None:
        self._wake, self._woken = socket.socketpair()
        self._wake.setblocking(False)
        self._woken.setblocking(False)
        self._filenos = (*filenos, self._woken.fileno)
        self._poll = select.poll()
        self._watched: list[int] = []

    def wait(self, duration_ns: int) -> None:
        """Wait for at most `duration_ns`."""
        numbers = [number for fileno in self._filenos if (number := fileno()) >= 0]
        if numbers != self._watched:
            self._watch(numbers)
        ready = self._poll.poll(max(0, duration_ns) / 1e6)
        if ready and duration_ns > GATHER_NS:
            time.sleep(GATHER_NS / NS_PER_S)
        if (self._woken.fileno(), select.POLLIN) in ready:
            with contextlib.suppress(BlockingIOError):
                self._woken.recv(64)

    def wake(self) -> None:
        """End the wait; may be called from a signal handler."""
        with contextlib.suppress(BlockingIOError):
            self._wake.send(b"\0")

    def close(self) -> None:
        """Give the sockets back."""
        self._wake.close()
        self._woken.close()

    def _watch(self, numbers: list[int]) -> None:
        self._watched, self._poll = numbers, select.poll()
        for number in numbers:
            self._poll.register(number, select.POLLIN)


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
    """Open sockets, log and state, and close them at the end, the sockets last. Raises LinkError and LogError."""
    config = prepared.config
    with contextlib.ExitStack() as stack:
        link = stack.enter_context(open_link(config.vehicle.url))
        radio, tap = _open_radio(config, prepared.driver.sysid, link)
        stack.callback(radio.close)
        perception = PerceptionSocket(config.perception.listen, allow_remote=config.perception.allow_remote)
        stack.callback(perception.close)
        notifier = Notifier()
        stack.callback(notifier.close)
        watchers: list[Watcher] = [notifier.published]
        if config.watch.http:
            from gatar_edge.watch import HttpWatch  # 7 MB that a daemon without it does not need

            http = HttpWatch(config.watch.http, clock_ns)
            stack.callback(http.close)
            watchers.append(http.published)
        log = _open_log(prepared, clock_ns())  # only now: a start that fails must not look like a robot started anew
        if log is not None:
            stack.callback(log.close)
        journal = Journal(config.robot.id, log)
        vehicle = _vehicle(prepared, link, journal, log, clock_ns(), dry_run=dry_run, tap=tap)
        waiter = Waiter([radio.fileno, perception.fileno, link.fileno])
        stack.callback(waiter.close)
        saver = StateSaver(Path(config.state.file)) if config.state.file else None
        daemon = Daemon(
            _make_agent(prepared, journal, log, clock_ns()),
            Perception(config.robot.id, config.kind, config.grid_spec),
            ByteBudget(config.net.bytes_per_s, sends=radio.sends),
            Ports(radio, perception, vehicle, clock_ns, log, saver, _to_all(watchers), lambda: _problem(radio)),
            _settings(config, dry_run=dry_run),
        )
        if log is not None:
            log.carry = lambda: carried_state(daemon.agent)
        if saver is not None:
            stack.callback(saver.close)
            stack.callback(lambda: saver.save_soon(daemon.state()))  # runs before close
        yield Process(daemon, vehicle, waiter, notifier, clock_ns)


def _open_radio(config: VehicleConfig, sysid: int, link: Link) -> tuple[Transport, Callable[[bytes], None] | None]:
    """The configured transport, and what is to be told of the bytes on the vehicle's link. Raises GatarError."""
    net = config.net
    if net.transport == "zenoh":
        from gatar_edge.transports.zenoh import ZenohTransport

        file = Path(net.zenoh_config) if net.zenoh_config else None
        return ZenohTransport(config.robot.id, net.listen, net.peers, file), None
    if net.transport == "mavlink":
        from gatar_edge.transports.mavlink_tunnel import MavlinkTunnel

        tunnel = MavlinkTunnel(lambda data: link.send(data, sysid), link.fileno, sysid)
        return tunnel, tunnel.feed
    return UdpTransport(net.listen, net.peers, net.group or None), None


def _problem(radio: Transport) -> str:
    """What is wrong with a transport that can tell."""
    return str(getattr(radio, "problem", ""))


def _vehicle(
    prepared: Prepared,
    link: Link,
    journal: Journal,
    log: RotatingLog | None,
    now_ns: int,
    *,
    dry_run: bool,
    tap: Callable[[bytes], None] | None,
) -> AutopilotPort:
    saved = prepared.restored.state
    memory = saved.vehicle if saved is not None else NOTHING
    driver = VehicleDriver(prepared.driver, now_ns, prepared.signing, memory)
    launch = prepared.config.vehicle.launch
    if launch == "auto" and not dry_run:
        driver.launch()
    return AutopilotPort(driver, link, journal, log, launch_when_armed=launch == "armed" and not dry_run, tap=tap)


def _settings(config: VehicleConfig, *, dry_run: bool) -> Settings:
    return Settings(
        tick_ns=int(NS_PER_S / config.loop.tick_hz),
        save_ns=int(config.state.period_s * NS_PER_S),
        dry_run=dry_run,
        on_stop=config.vehicle.on_stop,
    )


def _make_agent(prepared: Prepared, journal: Journal, log: RotatingLog | None, now_ns: int) -> Agent:
    allocator = punctual(prepared.allocator, prepared.config.loop.deadline_ms / 1000, ThreadRunner())
    agent = Agent(prepared.identity, prepared.config.agent, allocator, prepared.key, prepared.seq)
    restored = prepared.restored
    journal.info("saved state", now_ns, outcome=restored.outcome.value, next_seq=prepared.seq)
    if restored.state is not None:
        restore(agent, restored.state)
        if log is not None:
            log.takes_over(restored.state, now_ns)
    return agent


def _open_log(prepared: Prepared, now_ns: int) -> RotatingLog | None:
    config = prepared.config
    if not config.log.folder:
        return None
    info = describe_run(
        config.agent,
        [prepared.identity],
        prepared.flown,
        first_seqs={config.robot.id: prepared.seq},
        extra={"simulated": False, "restored": prepared.restored.outcome.value},
    )

    ring = Ring(
        file_ns=int(config.log.rotate_min * 60 * NS_PER_S),
        file_bytes=int(config.log.rotate_mb * 1e6),
        total_bytes=int(config.log.keep_mb * 1e6),
        files=config.log.keep_files,
    )

    def open_file(now_ns: int) -> Recorder:
        deleted = make_room(Path(config.log.folder), _log_stem(config), ring)
        recorder = Recorder(_log_path(config, now_ns), info, now_ns)
        if deleted:
            recorder.text(Level.INFO, config.robot.id, f"deleted the oldest logs: {', '.join(deleted[:20])}", now_ns)
        return recorder

    return RotatingLog(open_file, ring, now_ns)


def _log_path(config: VehicleConfig, now_ns: int) -> Path:
    """A name that sorts by robot and time, and of no file that exists: a restart within a second is another run."""
    stamp = time.strftime("%Y%m%dT%H%M%S", time.gmtime(now_ns / NS_PER_S))
    name = f"{_log_stem(config)}-{stamp}"
    folder = Path(config.log.folder)
    taken = sum(1 for _ in folder.glob(f"{name}*.mcap"))
    return folder / (f"{name}Z-{taken}.mcap" if taken else f"{name}Z.mcap")


def _log_stem(config: VehicleConfig) -> str:
    return f"{config.kind.name.lower()}{config.robot.id}"


def _to_all(watchers: Sequence[Watcher]) -> Watcher:
    def publish(t_ns: int, snapshot: Callable[[], Snapshot]) -> None:
        for watcher in watchers:
            watcher(t_ns, snapshot)

    return publish
