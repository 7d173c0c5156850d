"""The simulator's side of daemons: the declared faults happen there too, or are refused by name."""

from __future__ import annotations

import dataclasses
import socket
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from gatar_edge.bridge.codec import Codec
from gatar_edge.commands.sim import command, fleet_config
from gatar_edge.errors import ConfigError
from gatar_edge.sim_sitl.faults_file import parse_faults
from gatar_edge.sim_sitl.yard import Sockets, Yard
from gatar_edge.types import NS_PER_S


class Heard:
    """A socket that notes who said something."""

    def __init__(self) -> None:
        self.data: list[bytes] = []
        self.to: list[Any] = []

    def receive(self) -> list[Any]:
        return []

    def send(self, data: bytes) -> None:
        self.data.append(data)

    def send_datagrams(self, datagrams: Any) -> None:
        self.data.extend(datagrams)

    def send_to(self, _data: bytes, address: Any) -> None:
        self.to.append(address)

    def speakers(self) -> set[int]:
        data, self.data = b"".join(self.data), []
        return {frame.source[0] for frame in Codec(255, 1).parse(data[:60_000])}


def yard_with(faults: str) -> tuple[Yard, Heard]:
    config = dataclasses.replace(fleet_config(team="1A1G", seed=1), faults=parse_faults(faults.encode()))
    vehicles, radio = Heard(), Heard()
    eyes: Any = {1: "eye 1", 2: "eye 2"}
    return Yard(config, Sockets(vehicles, radio, eyes, {})), vehicles  # type: ignore[arg-type]


def advance(yard: Yard, from_s: float, to_s: float) -> None:
    for tick in range(round(from_s * 20), round(to_s * 20)):
        yard.advance(tick * NS_PER_S // 20)


def moved_off(yard: Yard) -> None:
    yard.bodies[0].travelled_m = 2.0


def test_telemetry_of_one_robot_can_be_lost() -> None:
    yard, vehicles = yard_with('[[telemetry]]\nrobot = 1\ndirection = "to_companion"\nloss = 1.0\n')
    advance(yard, 0, 3)
    assert vehicles.speakers() == {2}


def test_events_count_from_when_the_first_vehicle_moves_off() -> None:
    yard, _ = yard_with('[[event]]\nat_s = 2\nrobot = 2\ndo = "battery"\npercent = 15\n')
    advance(yard, 0, 5)
    battery = yard.bodies[1].autopilot
    assert battery.truth.battery_percent > 90
    moved_off(yard)
    advance(yard, 5, 8)
    assert battery.truth.battery_percent == pytest.approx(15, abs=1)


def test_a_killed_robot_says_and_sees_nothing_any_more() -> None:
    yard, vehicles = yard_with('[[event]]\nat_s = 1\nrobot = 2\ndo = "kill_robot"\n')
    moved_off(yard)
    advance(yard, 0, 0.9)
    assert vehicles.speakers() == {1, 2}
    assert set(vehicles.to) == {"eye 1", "eye 2"}
    advance(yard, 0.9, 1.1)
    vehicles.speakers()
    vehicles.to.clear()
    advance(yard, 1.1, 4)
    assert vehicles.speakers() == {1}
    assert set(vehicles.to) == {"eye 1"}


@pytest.mark.parametrize(
    ("event", "words"),
    [
        ('robot = 99\ndo = "gps_loss"\n', "faults name robot 99, the team has 1 to 2"),
        ('robot = 1\ndo = "kill_companion"\n', "kill_companion befalls a companion"),
        ('robot = 1\ndo = "clock_skew"\noffset_s = 1\n', "clock_skew befalls a companion"),
        ('robot = 1\ndo = "pilot_mode"\nmode = "FOO"\n', "has no mode 'FOO'"),
    ],
)
def test_what_cannot_happen_to_daemons_is_refused_before_anything_is_written(
    tmp_path: Path, event: str, words: str
) -> None:
    (tmp_path / "faults.toml").write_text(f"[[event]]\nat_s = 1\n{event}")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = str(free.getsockname()[1])
    live = ("--realtime", "--listen", "udp:127.0.0.1:0", "--daemons", str(tmp_path / "team"), "--base-port", port)
    done = CliRunner().invoke(command, ["--team", "1A1G", "--faults", str(tmp_path / "faults.toml"), *live])
    assert isinstance(done.exception, ConfigError)
    assert words in str(done.exception)
    assert not (tmp_path / "team").exists()
