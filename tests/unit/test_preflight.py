"""`gatar vehicle --check`: what is good is described, and each thing that is not is one line and exit code 2."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from gatar_edge.agent import Agent, Identity
from gatar_edge.allocators.greedy import Greedy
from gatar_edge.bridge.signing import timestamp_of
from gatar_edge.commands.init import command as init
from gatar_edge.driver_memory import DriverMemory
from gatar_edge.errors import ConfigError, GatarError, ModelError
from gatar_edge.own_ports import check_ports
from gatar_edge.persist import encode_state, snapshot, write_atomically
from gatar_edge.policy import DEFAULT_MODEL
from gatar_edge.preflight import Prepared, anchored_clock, describe, make_allocator, prepare
from gatar_edge.runinfo import model_file
from gatar_edge.types import NS_PER_S, RobotKind, RobotState
from gatar_edge.vehicle_config import read_config
from gatar_edge.view import build_view

NOW_NS = 1_800_000_000_000_000_000


def written(folder: Path, *arguments: str) -> Path:
    path = folder / "vehicle.toml"
    given = [
        "--id",
        "3",
        "--kind",
        "UAV",
        "--origin",
        "47,8",
        "--url",
        "udpin:127.0.0.1:14551",
        "--allocator",
        "greedy",
    ]
    result = CliRunner().invoke(init, ["--config", str(path), "--peer", "127.0.0.1:14602", *given, *arguments])
    assert result.exit_code == 0, result.output
    return path


PEERS = 'peers = ["127.0.0.1:14602"]'
TRANSPORT = 'transport = "udp"\nlisten = "0.0.0.0:14600"'


def check(path: Path) -> Prepared:
    return prepare(read_config(path), NOW_NS)


def test_a_good_configuration_is_described_with_what_it_would_do(tmp_path: Path) -> None:
    prepared = check(written(tmp_path))
    text = "\n".join(describe(prepared, dry_run=False))
    assert "takes off to 20 m when a person has armed it" in text
    assert "greedy 5 times a second" in text
    assert "635 of 32768 bytes/s" in text
    assert "shadow mode: no command is sent" in "\n".join(describe(prepared, dry_run=True))


@pytest.mark.parametrize("name", ['"gatar:mine.onnx"', '"gatar"\nfile = "mine.onnx"'])
def test_a_model_beside_the_configuration_is_flown_from_any_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    path = written(tmp_path)
    (tmp_path / "mine.onnx").symlink_to(DEFAULT_MODEL)
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    edit('allocator = "greedy"', f"allocator = {name}")(tmp_path)
    prepared = check(path)
    assert prepared.flown == f"gatar:{tmp_path}/mine.onnx"
    assert (prepared.allocator.name, model_file(prepared.flown)) == ("gatar", tmp_path / "mine.onnx")
    edit("r_sense = 4.0", "r_sense = 99.0")(tmp_path)
    with pytest.raises(ModelError, match="the robot is configured to 99"):
        check(path)


GROUP = 'group = "239.255.71.1:14600"'
ZENOH = 'transport = "zenoh"\nlisten = "tcp/[::]:14600"'


@pytest.mark.parametrize(
    ("changes", "fields"),
    [
        ({"127.0.0.1:14700": "127.0.0.1:14600"}, ("perception.listen", "net.listen")),
        ({"127.0.0.1:14700": "localhost:14551"}, ("perception.listen", "vehicle.url")),
        ({"udpin:127.0.0.1:14551": "udpin:0.0.0.0:14600"}, ("vehicle.url", "net.listen")),
        ({"udpin:127.0.0.1:14551": "udpin://[::]:14600"}, ("vehicle.url", "net.listen")),
        (
            {"0.0.0.0:14600": "127.0.0.2:14600", PEERS: GROUP, "127.0.0.1:14700": "127.0.0.1:14600"},
            ("perception.listen", "net.listen"),
        ),
        ({'http = ""': 'http = "127.0.0.1:14600"', TRANSPORT: ZENOH}, ("watch.http", "net.listen")),
    ],
)
def test_two_sockets_on_one_port_are_one_line_with_both_fields(
    tmp_path: Path, changes: dict[str, str], fields: tuple[str, str]
) -> None:
    path = written(tmp_path)
    for old, new in changes.items():
        edit(old, new)(tmp_path)
    with pytest.raises(GatarError) as caught:
        check_ports(read_config(path))
    one, other = fields
    assert str(caught.value).startswith(f"{one} '")
    assert f" and {other} '" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "changes",
    [
        {'http = ""': 'http = "127.0.0.1:14600"'},  # TCP beside UDP
        {"0.0.0.0:14600": "127.0.0.2:14600", "127.0.0.1:14700": "127.0.0.1:14600"},
        {"0.0.0.0:14600": "0.0.0.0:0", "127.0.0.1:14700": "127.0.0.1:0"},  # the system chooses
        {"127.0.0.1:14700": "unix:14600"},
        {"udpin:127.0.0.1:14551": "udpout:127.0.0.1:14600"},  # another machine's, or a simulator's
        {TRANSPORT: ZENOH, "127.0.0.1:14700": "127.0.0.1:14600"},
        {TRANSPORT: 'transport = "mavlink"\nlisten = "0.0.0.0:14600"', "127.0.0.1:14700": "127.0.0.1:14600"},
    ],
)
def test_sockets_that_do_not_meet_may_have_one_port(tmp_path: Path, changes: dict[str, str]) -> None:
    path = written(tmp_path)
    for old, new in changes.items():
        edit(old, new)(tmp_path)
    check_ports(read_config(path))


def test_ports_that_collide_are_found_by_the_check(tmp_path: Path) -> None:
    path = written(tmp_path)
    edit("127.0.0.1:14700", "127.0.0.1:14600")(tmp_path)
    with pytest.raises(ConfigError, match=r"perception\.listen '127\.0\.0\.1:14600' and net\.listen"):
        check(path)


def test_a_model_that_was_trained_for_something_else_is_refused_with_both_values(tmp_path: Path) -> None:
    path = written(tmp_path, "--allocator", "gatar", "--r-sense", "99")
    with pytest.raises(ModelError, match=r"r_sense is [\d.]+ to [\d.]+ cells, the robot is configured to 99"):
        check(path)


def test_a_file_that_is_no_model_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path, "--allocator", "gatar")
    (tmp_path / "no.onnx").write_bytes(b"no model")
    edit('allocator = "gatar"', 'allocator = "gatar"\nfile = "no.onnx"')(tmp_path)
    with pytest.raises(ModelError, match=r"no\.onnx") as caught:
        check(path)
    assert "\n" not in str(caught.value)


def break_key(folder: Path) -> None:
    (folder / "team.key").chmod(0o644)


def remove_key(folder: Path) -> None:
    (folder / "team.key").unlink()


def readable_signing_key(folder: Path) -> None:
    edit('# signing_key_file = ""', 'signing_key_file = "signing.key"')(folder)
    (folder / "signing.key").write_bytes(bytes(32))
    (folder / "signing.key").chmod(0o644)


def edit(old: str, new: str) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        path = folder / "vehicle.toml"
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new))

    return change


@pytest.mark.parametrize(
    ("break_it", "words"),
    [
        (break_key, "chmod 600"),
        (remove_key, "team.key cannot be read"),
        (edit('allocator = "greedy"', 'allocator = "magic"'), "allocator 'magic' is unknown"),
        (
            edit('allocator = "greedy"', 'allocator = "greedy"\nfile = "m.onnx"'),
            "model.file is for the allocator gatar",
        ),
        (edit("udpin:127.0.0.1:14551", "udp:127.0.0.1:14551"), "'udp' is unknown"),
        (edit("udpin:127.0.0.1:14551", "udpin:127.0.0.1"), "HOST:PORT"),
        (edit('# signing_key_file = ""', 'signing_key_file = "signing.key"'), "signing.key: No such file"),
        (readable_signing_key, "signing.key has mode 0644, others may read it"),
        (edit("127.0.0.1:14602", "127.0.0.1"), "net.peers '127.0.0.1'"),
        (edit("127.0.0.1:14700", "0.0.0.0:14700"), "allow_remote"),
        (edit("altitude_m = 20.0", "altitude_m = 150.0"), "altitude_band_m"),
        (edit("# bytes_per_s = 32768", "bytes_per_s = 1000 #"), "$.net.bytes_per_s"),
        (edit('folder = "logs"', 'folder = "/proc/logs"'), "log.folder"),
        (
            edit("# fence = [[47.0, 8.0], ", "fence = [[47.0, 8.0], [47.1, 8.1], [47.0, 8.1], [47.1, 8.0]] # "),
            "between corners 1 and 2 meets the one between 3 and 4",
        ),
        (edit("# fence = [[47.0, 8.0], ", "fence = [[8.0, 47.0], [8.0, 47.1], [8.1, 47.1]] # "), "beside the grid"),
        (edit('file = "state-3.bin"', 'file = "."'), "is a folder: give the name of a file in it"),
        (edit('key_file = "team.key"', r'key_file = "a\u0000b"'), "$.net.key_file"),
        (edit('allocator = "greedy"', 'allocator = "central-greedy"'), "for simulations only"),
        (edit('peers = ["127.0.0.1:14602"]', 'group = "10.0.0.1:14600"'), "is not in 224.0.0.0"),
        (edit('peers = ["127.0.0.1:14602"]', 'group = "239.255.71.1:14601"'), "differ in port"),
        (edit("127.0.0.1:14700", "unix:/absent/eyes.sock"), "no place for a socket"),
        (edit("127.0.0.1:14700", "unix:"), "no place for a socket"),
        (edit("127.0.0.1:14700", "unix:/tmp/" + 120 * "x"), "at most 107 bytes"),
    ],
)
def test_each_mistake_is_one_line(tmp_path: Path, break_it: Callable[[Path], None], words: str) -> None:
    path = written(tmp_path)
    break_it(tmp_path)
    with pytest.raises(GatarError) as caught:
        check(path)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_signed_frames_go_on_from_the_later_of_the_clock_and_what_was_saved(tmp_path: Path) -> None:
    path = written(tmp_path)
    edit('# signing_key_file = ""', 'signing_key_file = "signing.key"')(tmp_path)
    (tmp_path / "signing.key").write_bytes(bytes(range(32)))
    (tmp_path / "signing.key").chmod(0o600)
    config, now_ns = read_config(path), NOW_NS
    by_the_clock = prepare(config, now_ns).signing
    assert by_the_clock is not None
    assert by_the_clock.timestamp == timestamp_of(now_ns)
    agent = Agent(Identity(3, RobotKind.UAV, 1.0), config.agent, Greedy(), bytes(32))
    saved = snapshot(agent, now_ns, DriverMemory(signing_timestamp=timestamp_of(now_ns)))
    write_atomically(Path(config.state.file), encode_state(saved))
    after_a_slow_clock = prepare(config, now_ns - 30 * NS_PER_S).signing
    assert after_a_slow_clock is not None
    assert after_a_slow_clock.timestamp > by_the_clock.timestamp


def test_a_model_file_that_vanishes_in_flight_changes_nothing(tmp_path: Path) -> None:
    path = written(tmp_path)
    (tmp_path / "mine.onnx").write_bytes(DEFAULT_MODEL.read_bytes())
    edit('allocator = "greedy"', 'allocator = "gatar"\nfile = "mine.onnx"')(tmp_path)
    config = read_config(path)
    allocator = make_allocator(config)
    (tmp_path / "mine.onnx").write_bytes(b"another one, half written")
    ego = RobotState(3, RobotKind.UAV, (0, 0), 1.0)
    view = build_view(0, ego, [], np.zeros((15, 15), np.uint8), 6.0, 2, 64)
    assert len(allocator.allocate(view).choices) == 1


def test_a_jump_of_the_clock_of_day_does_not_reach_the_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    clock_ns = anchored_clock()
    before_ns = clock_ns()
    monkeypatch.setattr(time, "time_ns", lambda: 0)
    assert 0 <= clock_ns() - before_ns < 60_000_000_000
