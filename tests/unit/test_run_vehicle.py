"""The process round the daemon: an occupied address ends it with one line, a signal ends its wait, nothing leaks."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner

from gatar_edge.commands.init import command as init
from gatar_edge.commands.vehicle import command as vehicle
from gatar_edge.errors import GatarError, LinkError
from gatar_edge.preflight import anchored_clock, prepare
from gatar_edge.run_vehicle import Orders, Process, Waiter, listening_to_signals, opened, serve
from gatar_edge.types import NS_PER_S
from gatar_edge.vehicle_config import read_config

NOW_NS = 1_800_000_000 * NS_PER_S
PLACES = ("listen", "perception", "url", "http")


@pytest.fixture
def ports() -> dict[str, int]:
    """A free port for each place; the HTTP one is TCP."""
    with contextlib.ExitStack() as stack:
        found = {}
        for place in PLACES:
            kind = socket.SOCK_STREAM if place == "http" else socket.SOCK_DGRAM
            probe = stack.enter_context(socket.socket(socket.AF_INET, kind))
            probe.bind(("127.0.0.1", 0))
            found[place] = probe.getsockname()[1]
        return found


def config_path(folder: Path, ports: dict[str, int]) -> Path:
    path = folder / "vehicle.toml"
    at = {place: f"127.0.0.1:{port}" for place, port in ports.items()}
    arguments = ["--config", str(path), "--id", "3", "--kind", "UGV", "--origin", "47,8", "--allocator", "greedy"]
    arguments += ["--url", f"udpin:{at['url']}", "--listen", at["listen"], "--peer", "127.0.0.1:9"]
    arguments += ["--perception", at["perception"], "--http", at["http"], "--force"]
    assert CliRunner().invoke(init, arguments).exit_code == 0
    return path


@contextlib.contextmanager
def started(folder: Path, ports: dict[str, int]) -> Iterator[Process]:
    prepared = prepare(read_config(config_path(folder, ports)), NOW_NS)
    with opened(prepared, anchored_clock(), dry_run=False) as process:
        yield process


@pytest.mark.parametrize("place", PLACES)
def test_an_occupied_address_is_one_line_and_leaves_nothing_open(
    tmp_path: Path, ports: dict[str, int], place: str
) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM if place == "http" else socket.SOCK_DGRAM) as used:
        used.bind(("127.0.0.1", ports[place]))
        if place == "http":
            used.listen()
        with pytest.raises(LinkError, match=str(ports[place])) as caught, started(tmp_path, ports):
            pass
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.glob("logs/*"))  # a log would tell of a robot that was started anew
    with started(tmp_path, ports):  # what had been opened before was closed again
        pass


def test_sigterm_ends_the_loop_at_once_with_the_log_and_the_state_complete(
    tmp_path: Path, ports: dict[str, int]
) -> None:
    orders = Orders()
    with started(tmp_path, ports) as process, listening_to_signals(orders, process.waiter):
        os.kill(os.getpid(), signal.SIGTERM)
        serve(process, orders)
    assert len(list((tmp_path / "logs").glob("ugv3-*.mcap"))) == 1
    with started(tmp_path, ports) as process:
        assert process.daemon.agent.next_seq > 0
    assert (tmp_path / "state-3.bin").exists()


def test_sigusr1_takes_the_vehicle_back(tmp_path: Path, ports: dict[str, int], monkeypatch: pytest.MonkeyPatch) -> None:
    orders = Orders()
    enabled: list[int] = []
    with started(tmp_path, ports) as process, listening_to_signals(orders, process.waiter):
        monkeypatch.setattr(process.vehicle, "enable", enabled.append)
        os.kill(os.getpid(), signal.SIGUSR1)
        real_step = process.daemon.step

        def step_once(now_ns: int) -> None:
            real_step(now_ns)
            orders.stop = True

        monkeypatch.setattr(process.daemon, "step", step_once)
        serve(process, orders)
    assert len(enabled) == 1


def test_a_wait_ends_with_a_datagram_a_signal_or_the_time_and_survives_lost_sockets() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ear:
        ear.bind(("127.0.0.1", 0))
        lost = [ear.fileno()]
        waiter = Waiter([ear.fileno, lambda: lost[0]])
        waiter.wait(0)
        lost[0] = -1
        ear.sendto(b"x", ear.getsockname())
        waiter.wait(60 * NS_PER_S)
        ear.recv(1)
        waiter.wake()
        waiter.wait(60 * NS_PER_S)
        waiter.close()


def test_check_ends_with_what_would_be_done_and_opens_nothing(tmp_path: Path, ports: dict[str, int]) -> None:
    path = config_path(tmp_path, ports)
    with contextlib.ExitStack() as stack:
        for place in ("listen", "perception", "url"):
            used = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            used.bind(("127.0.0.1", ports[place]))
        result = CliRunner().invoke(vehicle, ["--config", str(path), "--check"])
    assert result.exit_code == 0
    assert "UGV 3" in result.output
    assert f"{path} is good" in result.output
    assert not list((tmp_path / "logs").glob("*.mcap"))


def test_a_missing_configuration_is_an_error_that_names_init(tmp_path: Path) -> None:
    result = CliRunner().invoke(vehicle, ["--config", str(tmp_path / "none.toml")])
    assert isinstance(result.exception, GatarError)
    assert "gatar init" in str(result.exception)
