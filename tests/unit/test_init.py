"""`gatar init`: what it writes is what `gatar vehicle` reads, and nothing is overwritten unasked."""

from __future__ import annotations

import stat
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from gatar_edge.commands.init import command
from gatar_edge.errors import ConfigError, GatarError
from gatar_edge.keys import read_key
from gatar_edge.policy import DEFAULT_MODEL
from gatar_edge.vehicle_config import VehicleConfig, read_config

GIVEN = ("--id", "3", "--kind", "uav", "--origin", "47.4,-8.5", "--url", "udpin:127.0.0.1:14551")


def init(folder: Path, *arguments: str, answers: str = "") -> Result:
    result = CliRunner().invoke(command, ["--config", str(folder / "vehicle.toml"), *arguments], input=answers)
    if isinstance(result.exception, Exception) and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def test_what_is_written_is_read_back_with_a_private_key(tmp_path: Path) -> None:
    result = init(tmp_path, *GIVEN, "--size", "20x10", "--peer", "10.0.0.2:14600", "--http", "127.0.0.1:9100")
    assert result.exit_code == 0
    config = read_config(tmp_path / "vehicle.toml")
    assert (config.robot.id, config.robot.kind, config.grid.width, config.grid.height) == (3, "UAV", 20, 10)
    assert (config.grid.origin_lat_deg, config.grid.origin_lon_deg) == (47.4, -8.5)
    assert (config.net.peers, config.net.group, config.watch.http) == (["10.0.0.2:14600"], "", "127.0.0.1:9100")
    assert stat.S_IMODE((tmp_path / "team.key").stat().st_mode) == 0o600
    assert len(read_key(tmp_path / "team.key")) == 32


def test_the_commented_lines_of_the_template_are_the_defaults(tmp_path: Path) -> None:
    init(tmp_path, *GIVEN)
    path = tmp_path / "vehicle.toml"
    before = read_config(path)
    lines = path.read_text().splitlines()
    examples = ("# file =", "# fence =", "# One robot", "# Only ")
    path.write_text("\n".join(line if line.startswith(examples) else line.removeprefix("# ") for line in lines))
    assert read_config(path) == before
    assert isinstance(before, VehicleConfig)


def test_what_is_not_given_is_asked_for(tmp_path: Path) -> None:
    result = init(tmp_path, answers="7\nUGV\n1.5,2.5\nserial:/dev/ttyAMA0:921600\n")
    assert result.exit_code == 0
    assert read_config(tmp_path / "vehicle.toml").vehicle.url == "serial:/dev/ttyAMA0:921600"


def test_an_existing_configuration_and_key_are_kept(tmp_path: Path) -> None:
    init(tmp_path, *GIVEN)
    key = (tmp_path / "team.key").read_bytes()
    with pytest.raises(ConfigError, match="--force"):
        init(tmp_path, *GIVEN)
    assert "kept" in init(tmp_path, *GIVEN, "--force").output
    assert (tmp_path / "team.key").read_bytes() == key


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--size", "0x5"), "$.grid.width"),
        (("--speed-m-s", "nan"), "$.robot.speed_m_s"),
        (("--allocator", "best"), "allocator 'best' is unknown"),
        (("--listen", "nonsense"), "net.listen 'nonsense'"),
        (("--group", "10.0.0.1:14600"), "is not in 224.0.0.0"),
        (("--perception", "0.0.0.0:14700"), "perception.listen"),
        (("--perception", "127.0.0.1:14600"), "perception.listen '127.0.0.1:14600' and net.listen"),
        (("--allocator", "gatar:absent.onnx"), "absent.onnx"),
        (("--http", "nonsense"), "watch.http 'nonsense'"),
        (("--altitude-m", "300"), "altitude_band_m"),
        (("--key-file", "absent/team.key"), "absent/team.key cannot be made"),
    ],
)
def test_a_wrong_value_is_one_line_and_writes_nothing(tmp_path: Path, arguments: tuple[str, str], words: str) -> None:
    with pytest.raises(GatarError) as caught:
        init(tmp_path, *GIVEN, *arguments)
    assert words in str(caught.value)
    assert not (tmp_path / "vehicle.toml").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--origin", "47.4"), "'47.4' is not of the form 47.397742,8.545594"),
        (("--origin", "95,0"), "$.origin_lat_deg"),
        (("--origin", "0,nan"), "$.origin_lon_deg"),
        (("--size", "15"), "'15' is not of the form 15x15"),
        (("--url", "nonsense"), "use udpin:"),
        (("--id", "300"), "1<=x<=255"),
    ],
)
def test_a_wrong_option_is_told_before_any_question(tmp_path: Path, arguments: tuple[str, str], words: str) -> None:
    result = init(tmp_path, *arguments)
    assert result.exit_code == 2
    assert f"'{arguments[0]}'" in result.output
    assert words in result.output
    assert "Kind of vehicle" not in result.output


@pytest.mark.parametrize(
    ("answers", "question"),
    [
        ("7\nUGV\nParis\n91,0\n1.5,2.5\nserial:/dev/ttyACM0\n", "South-west corner"),
        ("7\nUGV\n1.5,2.5\n/dev/ttyACM0\nudpin:nowhere\nserial:/dev/ttyACM0\n", "Autopilot"),
    ],
)
def test_a_wrong_answer_is_told_at_once_and_asked_for_again(tmp_path: Path, answers: str, question: str) -> None:
    result = init(tmp_path, answers=answers)
    assert result.exit_code == 0
    assert (result.output.count("Error: "), result.output.count(question)) == (2, 3)
    config = read_config(tmp_path / "vehicle.toml")
    assert (config.grid.origin_lat_deg, config.vehicle.url) == (1.5, "serial:/dev/ttyACM0")


@pytest.mark.parametrize("force", [(), ("--force",)])
def test_an_existing_configuration_is_told_of_before_any_question(tmp_path: Path, force: tuple[str, ...]) -> None:
    (tmp_path / "vehicle.toml").write_text("precious")
    if force:
        assert init(tmp_path, *force, answers="7\nUGV\n1.5,2.5\nserial:/dev/ttyACM0\n").exit_code == 0
        return
    with pytest.raises(ConfigError, match="--force overwrites it"):
        init(tmp_path)
    assert (tmp_path / "vehicle.toml").read_text() == "precious"


def test_a_model_beside_the_file_is_found_from_any_folder(tmp_path: Path) -> None:
    (tmp_path / "mine.onnx").symlink_to(DEFAULT_MODEL)
    assert init(tmp_path, *GIVEN, "--allocator", "gatar:mine.onnx").exit_code == 0
    model = read_config(tmp_path / "vehicle.toml").model
    assert (model.allocator, model.file) == ("gatar", str(tmp_path / "mine.onnx"))


def test_names_may_be_of_any_language(tmp_path: Path) -> None:
    init(tmp_path, *GIVEN, "--key-file", "ключ-\U0001f511.key")
    assert Path(read_config(tmp_path / "vehicle.toml").net.key_file).is_file()


def test_the_example_is_what_init_writes(tmp_path: Path) -> None:
    example = Path(__file__).parents[2] / "examples" / "vehicle.toml"
    init(
        tmp_path, "--id", "3", "--kind", "UAV", "--origin", "47.397742,8.545594", "--url", "serial:/dev/ttyAMA0:921600"
    )
    assert (tmp_path / "vehicle.toml").read_text() == example.read_text()
