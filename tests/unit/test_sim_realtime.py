"""`gatar sim --realtime`: its options, and what `--daemons` writes for the daemons."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from gatar_edge.commands.sim import command, fleet_config, print_table
from gatar_edge.commands.sim_realtime import write_configurations
from gatar_edge.errors import ConfigError, GatarError, LinkError
from gatar_edge.policy import DEFAULT_MODEL
from gatar_edge.sim_sitl.tally import Tally
from gatar_edge.vehicle_config import read_config


def test_the_daemons_of_a_mission_hear_and_look_at_ports_of_their_own_from_the_base_port_on(tmp_path: Path) -> None:
    paths = write_configurations(fleet_config(team="1A1G", seed=1), "greedy", 14550, tmp_path, base_port=20000)
    first, second = map(read_config, paths)
    assert (first.net.listen, first.perception.listen) == ("127.0.0.1:20001", "127.0.0.1:20101")
    assert (second.net.listen, second.perception.listen) == ("127.0.0.1:20002", "127.0.0.1:20102")
    assert first.net.peers == second.net.peers == ["127.0.0.1:20000"]


def test_what_daemons_decide_out_of_sight_is_left_out(capsys: pytest.CaptureFixture[str]) -> None:
    result = Tally(fleet_config(team="1A1G", seed=1).world, "daemons").result(12.0)
    print_table(result)
    assert "decision" not in capsys.readouterr().out
    assert result.to_json()["decision_p50_us"] is None


def test_what_daemons_of_an_earlier_mission_knew_is_not_carried_into_this_one(tmp_path: Path) -> None:
    (tmp_path / "state-1.bin").write_bytes(b"another world")
    key = write_configurations(fleet_config(team="1A0G", seed=1), "greedy", 14550, tmp_path, 20000)[0].with_name(
        "team.key"
    )
    kept = key.read_bytes()
    write_configurations(fleet_config(team="1A0G", seed=2), "greedy", 14550, tmp_path, 20000)
    assert not (tmp_path / "state-1.bin").exists()
    assert key.read_bytes() == kept


@pytest.mark.parametrize("allocator", ["best", "central-greedy"])
def test_an_allocator_that_the_daemons_would_refuse_is_refused_before_anything_is_written(
    tmp_path: Path, allocator: str
) -> None:
    with pytest.raises(ConfigError):
        write_configurations(fleet_config(team="1A0G", seed=1), allocator, 14550, tmp_path, 20000)
    assert list(tmp_path.iterdir()) == []


def sim(*arguments: str) -> Result:
    return CliRunner().invoke(command, ["--team", "1A0G", "--targets", "1", "--allocator", "greedy", *arguments])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--listen", "udp:127.0.0.1:0"), "--listen needs --realtime"),
        (("--speed-factor", "2"), "--speed-factor needs --realtime"),
        (("--daemons", "team"), "--daemons needs --realtime"),
        (("--realtime", "--daemons", "team", "--log", "m.mcap"), "each daemon writes its log into team/logs"),
        (("--realtime", "--daemons", "team", "--out", "run"), "each daemon writes its log into team/logs"),
        (("--out", "text/run"), "text/run cannot be made"),
    ],
)
def test_an_option_that_would_mean_nothing_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...], words: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("text").write_text("a file where a folder should be")
    error = sim(*arguments).exception
    assert isinstance(error, GatarError)
    assert words in str(error)
    assert [path.name for path in tmp_path.iterdir()] == ["text"]


def test_a_port_in_use_is_the_only_line_and_nothing_is_written(tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as used:
        used.bind(("127.0.0.1", 0))
        port = str(used.getsockname()[1])
        live = ("--realtime", "--listen", "udp:127.0.0.1:0", "--daemons", str(tmp_path / "team"))
        done = sim(*live, "--base-port", port)
    assert isinstance(done.exception, LinkError)
    assert done.output == ""
    assert not (tmp_path / "team").exists()


def test_daemons_find_the_model_that_was_named_from_where_the_command_was_given(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "mine.onnx").symlink_to(DEFAULT_MODEL)
    monkeypatch.chdir(tmp_path)
    config = fleet_config(team="1A0G", seed=1)
    (path,) = write_configurations(config, "gatar:mine.onnx", 14550, tmp_path / "daemons", 20000)
    assert read_config(path).model.file == str(tmp_path / "mine.onnx")
