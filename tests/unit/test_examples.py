"""The examples run as they stand."""

from __future__ import annotations

import json
import runpy
import socket
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import pytest
from click.testing import CliRunner

from gatar_edge.commands.init import command as init
from gatar_edge.perception import ObservationOutcome, Perception, decode_datagram
from gatar_edge.types import GridSpec, RobotKind
from gatar_edge.vehicle_config import read_config

EXAMPLES = Path(__file__).parents[2] / "examples"


def test_the_smallest_perception_is_understood_by_a_daemon(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as daemon:
        daemon.bind(("127.0.0.1", 0))
        daemon.settimeout(30)
        address = "{}:{}".format(*daemon.getsockname())
        monkeypatch.setattr("sys.argv", ["perception.py", address, "0.01"])
        runpy.run_path(str(EXAMPLES / "perception.py"), run_name="__main__")
        judge = Perception(1, RobotKind.UAV, GridSpec())
        judge.take(daemon.recv(65_536), 0, None)
    assert judge.counters[ObservationOutcome.ACCEPTED] == 1


def test_the_adapters_print_a_good_datagram(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["perception_adapters.py"])
    runpy.run_path(str(EXAMPLES / "perception_adapters.py"), run_name="__main__")
    printed = capsys.readouterr().out
    assert decode_datagram(printed.encode()).obstacles == [tuple(cell) for cell in json.loads(printed)["obstacles"]]


def test_the_eyes_of_a_simulated_vehicle_leave_its_place_to_the_autopilot(tmp_path: Path) -> None:
    path = tmp_path / "vehicle.toml"
    arguments = ["--config", str(path), "--id", "7", "--kind", "UGV", "--origin", "47,8", "--url", "udpin:127.0.0.1:1"]
    assert CliRunner().invoke(init, arguments).exit_code == 0
    eyes = runpy.run_path(str(EXAMPLES / "sitl_eyes.py"))
    judge = Perception(7, RobotKind.UGV, GridSpec())
    blind, seeing = (eyes["look"](read_config(path), cell, 1) for cell in ((-1, -1), (4, 5)))
    assert judge.take(blind, 0, (4, 5)).seen.size == 0
    assert [4, 5] in judge.take(seeing, 1, (4, 5)).seen.tolist()
    assert eyes["cell_of"]("127.0.0.1:1") == (-1, -1)  # nobody there


@pytest.mark.parametrize(("lost", "believed"), [(0, False), (1, True)])
def test_the_take_off_takes_a_refused_repetition_for_a_lost_answer(lost: int, believed: bool) -> None:
    command = runpy.run_path(str(EXAMPLES / "pytest_fixture" / "takeoff.py"))["command"]
    answers = [*[None] * lost, SimpleNamespace(result=4)]
    mav = SimpleNamespace(command_long_send=lambda *_: None)
    link = SimpleNamespace(mav=mav, target_system=1, target_component=1, recv_match=lambda **_: answers.pop(0))
    with nullcontext() if believed else pytest.raises(RuntimeError, match="refused"):
        command(link, 22, (5.0,))


def test_the_service_is_hardened_and_watched() -> None:
    unit = (EXAMPLES / "systemd" / "gatar-vehicle@.service").read_text().splitlines()
    needed = {"Type=notify", "WatchdogSec=5", "NoNewPrivileges=yes", "ProtectSystem=strict", "Restart=always"}
    assert needed <= set(unit)


def test_the_service_makes_the_folder_of_the_socket_that_the_configuration_proposes() -> None:
    unit = (EXAMPLES / "systemd" / "gatar-vehicle@.service").read_text()
    proposed = "unix:/run/gatar/robot3/perception.sock"
    assert proposed in unit
    assert proposed in (EXAMPLES / "vehicle.toml").read_text()
    assert "RuntimeDirectory=gatar/%i" in unit.splitlines()
