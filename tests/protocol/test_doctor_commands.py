"""`gatar doctor` and `gatar bridge` over loopback sockets; the vehicles' time passes as the commands look at it."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from guests import STACKS

from gatar_edge.bridge.geo import cell_to_wgs84
from gatar_edge.cli import gatar
from gatar_edge.commands.init import configuration
from gatar_edge.errors import GatarError
from gatar_edge.sim_sitl.autopilot import AutopilotConfig, SimAutopilot
from gatar_edge.sim_sitl.realtime import UdpSocket
from gatar_edge.sim_sitl.testing import Client
from gatar_edge.types import NS_PER_S, GridSpec

STEP_NS = NS_PER_S // 20
HOME = (-35.3632621, 149.1652374)
GRID = GridSpec(15, 15, 10.0, HOME[0] - 0.0005, HOME[1] - 0.0005)


class Port:
    """Vehicles at one UDP port; `clock` lets time pass for them each time it is read."""

    def __init__(self, configs: tuple[AutopilotConfig, ...]) -> None:
        self.now_ns = 0
        self.socket = UdpSocket("127.0.0.1:0")
        self.vehicles = [SimAutopilot(config, 0) for config in configs]

    @property
    def url(self) -> str:
        return f"udpout:127.0.0.1:{self.socket.port}"

    def clock(self) -> int:
        self.now_ns += STEP_NS
        for data, _ in self.socket.receive():
            for vehicle in self.vehicles:
                vehicle.receive(data, self.now_ns)
        for vehicle in self.vehicles:
            vehicle.step(self.now_ns)
            self.socket.send(vehicle.take())
        return self.now_ns

    def client(self) -> Client:
        vehicle = self.vehicles[0]
        client = Client(vehicle.config)
        client.vehicle, client.now_ns = vehicle, self.now_ns
        return client


Serve = Callable[..., Port]


@pytest.fixture
def serve(monkeypatch: pytest.MonkeyPatch) -> Iterator[Serve]:
    """Opens a port with vehicles of the named stacks, by whose clock the commands live."""
    monkeypatch.setattr("gatar_edge.commands._guest.POLL_S", 0.002)
    with contextlib.ExitStack() as stack:

        def opened(*names: str) -> Port:
            port = Port(tuple(STACKS[name] for name in names))
            stack.callback(port.socket.close)
            monkeypatch.setattr("gatar_edge.preflight.anchored_clock", lambda: port.clock)
            return port

        yield opened


def run(*arguments: str) -> Result:
    return CliRunner().invoke(gatar, arguments)


def config_of(folder: Path, kind: str, sysid: int, url: str) -> Path:
    options = {
        "robot_id": sysid, "kind": kind, "speed_m_s": 5.0, "cell_m": GRID.cell_m, "r_sense": 4.0, "r_comm": 6.0,
        "altitude_m": 20.0, "allocator": "greedy", "url": url, "listen": "127.0.0.1:14600",
        "peers": ["127.0.0.1:14601"], "perception": "127.0.0.1:14700", "launch": "armed", "http": "",
    }  # fmt: skip
    path = folder / "vehicle.toml"
    corner = (GRID.origin_lat_deg, GRID.origin_lon_deg)
    path.write_text(configuration(path.name, corner, (GRID.width, GRID.height), "team.key", options))
    return path


def test_doctor_prints_a_line_a_check_and_exits_with_0(serve: Serve) -> None:
    port = serve("ardupilot-copter")
    result = run("doctor", "--vehicle", port.url)
    assert result.exit_code == 0, result.output
    assert sum(line[:4].strip() in ("OK", "WARN") for line in result.output.splitlines()) >= 12
    assert "FS_GCS_ENABLE=0" in result.output


def test_doctor_with_a_configuration_tells_machines_what_fails_and_exits_with_1(serve: Serve, tmp_path: Path) -> None:
    port = serve("px4-copter", "ardupilot-rover")
    result = run("doctor", "--config", str(config_of(tmp_path, "UAV", 2, port.url)), "--json")
    assert result.exit_code == 1
    report = json.loads(result.output)
    assert not report["good"]
    failed = [check["check"] for check in report["checks"] if check["level"] == "FAIL"]
    assert failed == ["profile"]  # system 2 is the rover, configured as a UAV


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ((), "give --vehicle URL"),
        (("--vehicle", "pigeon:1"), "'pigeon' is unknown"),
        (("--config", "missing.toml"), "cannot be read"),
    ],
)
def test_doctor_without_a_vehicle_to_ask_is_one_clear_line(arguments: tuple[str, ...], says: str) -> None:
    error = run("doctor", *arguments).exception
    assert isinstance(error, GatarError)  # the command line's own end makes of it one line and exit code 2
    assert says in str(error)
    assert "\n" not in str(error)


def test_silence_on_the_link_and_several_vehicles_are_told_apart(serve: Serve) -> None:
    silent = serve()
    assert "nothing is heard" in str(run("doctor", "--vehicle", silent.url, "--timeout-s", "3").exception)
    several = serve("ardupilot-copter", "px4-rover")
    error = run("doctor", "--vehicle", several.url, "--timeout-s", "5").exception
    assert isinstance(error, GatarError)
    assert "--sysid (1, 4)" in str(error)


def test_several_vehicles_are_told_of_without_waiting_for_the_end(serve: Serve) -> None:
    several = serve("ardupilot-copter", "px4-rover")
    error = run("bridge", "clear", "--vehicle", several.url, "--timeout-s", "600").exception
    assert "--sysid (1, 4)" in str(error)
    assert several.now_ns < 10 * NS_PER_S


def test_a_vehicle_that_is_heard_after_one_was_chosen_changes_nothing(serve: Serve) -> None:
    port = serve("ardupilot-rover")
    port.vehicles.append(Late(STACKS["px4-rover"], 0))
    result = run("doctor", "--vehicle", port.url)
    assert result.exception is None, result.output
    assert "also heard: rover 4/1" in result.output


class Late(SimAutopilot):
    """A vehicle that is switched on four seconds after the others."""

    def take(self) -> bytes:
        said = super().take()
        return said if self._core.now_ns > 4 * NS_PER_S else b""


@pytest.mark.parametrize(("stack", "sysid"), [("ardupilot-rover", 2), ("px4-rover", 4)])
def test_a_mission_on_board_is_verified_against_cells(serve: Serve, tmp_path: Path, stack: str, sysid: int) -> None:
    port = serve(stack)
    config = str(config_of(tmp_path, "UGV", sysid, port.url))
    cells, yaw = [[3, 4], [3, 9]], (float("nan") if stack == "px4-rover" else 0.0)
    points = [(*cell_to_wgs84(GRID, (x, y)), 0.0) for x, y in cells]
    slot_0 = [points[0]] if stack == "ardupilot-rover" else []
    port.client().upload(*slot_0, *points, param4=yaw)
    same, other = tmp_path / "same.json", tmp_path / "other.json"
    same.write_text(json.dumps(cells))
    other.write_text(json.dumps([[3, 4], [4, 9]]))
    good = run("bridge", "verify", "--config", config, "--cells", str(same))
    assert good.exit_code == 0, good.output
    bad = run("bridge", "verify", "--config", config, "--cells", str(other))
    assert bad.exit_code == 1
    assert "waypoint 2, cell (4, 9)" in bad.output
    printed = json.loads(run("bridge", "download", "--config", config, "--json").output)
    assert [row["cell"] for row in printed][-2:] == cells


def test_a_mission_is_cleared_on_the_ground_and_kept_while_armed(serve: Serve) -> None:
    port = serve("ardupilot-rover")
    client = port.client()
    client.upload(*(client.place(10.0 * i, 0.0) for i in range(4)))
    client.command(400, 1)
    refused = run("bridge", "clear", "--vehicle", port.url)
    assert refused.exit_code == 1
    assert "armed" in refused.output
    assert len(port.vehicles[0].mission) == 4
    port.client().command(400, 0)
    assert run("bridge", "clear", "--vehicle", port.url).exit_code == 0
    assert len(port.vehicles[0].mission) <= 1


def test_an_origin_from_a_gps_stays_and_that_is_exit_code_1(serve: Serve) -> None:
    port = serve("px4-rover")
    result = run("bridge", "set-origin", "--vehicle", port.url, "--at", "47.4,8.5")
    assert result.exit_code == 1
    assert "keeps another origin" in result.output
    there = ",".join(map(str, HOME))
    assert run("bridge", "set-origin", "--vehicle", port.url, "--at", there).exit_code == 0


@pytest.mark.parametrize("place", ["", "1", "91,0", "0,181", "nan,0", "1,2,99999", "1,2,3,4", "a,b"])
def test_a_place_that_is_none_is_refused(place: str) -> None:
    error = run("bridge", "set-origin", "--vehicle", "udpin:127.0.0.1:1", "--at", place).exception
    assert isinstance(error, GatarError)
    assert "is no place" in str(error)


@pytest.mark.parametrize("text", ["", "{}", "[[1]]", "[[1.5, 2]]", "[]", "[[1, 2, 3]]", "\xff"])
def test_cells_that_are_none_are_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "cells.json"
    path.write_bytes(text.encode("latin-1"))
    error = run("bridge", "verify", "--vehicle", "udpin:127.0.0.1:1", "--cells", str(path)).exception
    assert isinstance(error, GatarError)
    assert "cells" in str(error)


def test_a_cell_outside_of_the_grid_is_refused_before_anybody_is_asked(tmp_path: Path) -> None:
    config = config_of(tmp_path, "UGV", 2, "udpin:127.0.0.1:1")
    cells = tmp_path / "cells.json"
    cells.write_text("[[3, 4], [3, 99999999999999999999]]")
    error = run("bridge", "verify", "--config", str(config), "--cells", str(cells)).exception
    assert isinstance(error, GatarError)
    assert "outside of the grid of 15 x 15 cells" in str(error)


def test_a_system_that_is_not_there_is_told_apart_from_one_that_does_not_answer(serve: Serve) -> None:
    port = serve("ardupilot-rover")
    result = run("bridge", "download", "--vehicle", port.url, "--sysid", "9", "--timeout-s", "5")
    assert result.exit_code == 1
    assert "system 9 is not heard, but 2" in result.output
