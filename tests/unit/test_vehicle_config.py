"""vehicle.toml: what is read, and that each mistake is one line that names its place."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from gatar_edge.config import AgentConfig
from gatar_edge.errors import ConfigError
from gatar_edge.types import RobotKind
from gatar_edge.vehicle_config import TeamSection, parse_config, read_config

SMALLEST = """
[robot]
id = 3
kind = "UGV"
[grid]
origin_lat_deg = 47.0
origin_lon_deg = 8.0
[net]
key_file = "team.key"
peers = ["10.0.0.2:14600"]
[vehicle]
url = "udpin:127.0.0.1:14550"
"""


def test_the_smallest_file_takes_all_else_from_the_defaults() -> None:
    config = parse_config(SMALLEST)
    assert config.kind is RobotKind.UGV
    assert config.agent.grid.origin_lat_deg == 47.0
    assert config.agent.r_comm == AgentConfig().r_comm
    assert config.loop.tick_hz == 5.0


def test_the_team_table_has_exactly_the_fields_of_the_agent_with_their_defaults() -> None:
    agent = {name: value for name, value in msgspec.structs.asdict(AgentConfig()).items() if name != "grid"}
    assert msgspec.structs.asdict(TeamSection()) == agent


def test_robots_with_the_same_grid_and_team_tables_have_the_same_digest() -> None:
    other = SMALLEST.replace("id = 3", "id = 4").replace("UGV", "UAV").replace("14550", "14551")
    assert parse_config(SMALLEST).agent.digest() == parse_config(other).agent.digest()
    assert parse_config(SMALLEST).agent.digest() != parse_config(SMALLEST.replace("8.0", "8.1")).agent.digest()


def test_paths_are_relative_to_the_file(tmp_path: Path) -> None:
    file = tmp_path / "vehicle.toml"
    file.write_text(SMALLEST + '[model]\nfile = "/abs/m.onnx"\n')
    config = read_config(file)
    assert config.net.key_file == str(tmp_path / "team.key")
    assert config.model.file == "/abs/m.onnx"
    assert config.net.zenoh_config == ""
    assert config.state.file == str(tmp_path / "state-3.bin")


@pytest.mark.parametrize(
    ("value", "file"), [("gatar:m.onnx", "{here}/m.onnx"), ("gatar:/abs/m.onnx", "/abs/m.onnx"), ("gatar:", "")]
)
def test_the_model_in_the_name_of_the_allocator_is_relative_to_the_file_too(
    tmp_path: Path, value: str, file: str
) -> None:
    (tmp_path / "vehicle.toml").write_text(SMALLEST + f'[model]\nallocator = "{value}"\n')
    model = read_config(tmp_path / "vehicle.toml").model
    assert (model.allocator, model.file) == ("gatar", file.format(here=tmp_path))


@pytest.mark.parametrize(
    ("value", "listen"),
    [
        ("unix:eyes.sock", "unix:{here}/eyes.sock"),
        ("unix:/run/eyes.sock", "unix:/run/eyes.sock"),
        ("unix:", "unix:"),
        ("127.0.0.1:14700", "127.0.0.1:14700"),
    ],
)
def test_a_socket_file_is_relative_to_the_file_too(tmp_path: Path, value: str, listen: str) -> None:
    (tmp_path / "vehicle.toml").write_text(SMALLEST + f'[perception]\nlisten = "{value}"\n')
    assert read_config(tmp_path / "vehicle.toml").perception.listen == listen.format(here=tmp_path)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("[robot]", "[model]\nallocator = 'gatar:a.onnx'\nfile = 'b.onnx'\n[robot]"), "both name a model"),
        (("[net]", "[net]\nrate_hs = 3"), "unknown field rate_hs - at $.net"),
        (("id = 3", ""), "missing field id - at $.robot"),
        (('kind = "UGV"', 'kind = "boat"'), "$.robot.kind"),
        (("id = 3", "id = 0"), "$.robot.id"),
        (("47.0", '"47"'), "$.grid.origin_lat_deg"),
        (("47.0", "nan"), "$.grid.origin_lat_deg"),
        (('peers = ["10.0.0.2:14600"]', ""), "nobody to talk to"),
        (("[robot]", "[loop]\ntick_hz = 5.0\ndeadline_ms = 200.0\n[robot]"), "$.loop"),
        (("[robot]", "[robot"), "line"),
        (("[vehicle]", "[vehicle]\non_stop = 'crash'"), "$.vehicle.on_stop"),
        (("[vehicle]", "[vehicle]\nmin_separation_m = -1"), "$.vehicle.min_separation_m"),
        (("[vehicle]", "[vehicle]\nfence = [[47.0, 8.0], [47.1, 8.0]]"), "fence has 2 corners"),
        (("[vehicle]", "[vehicle]\nfence = [[8.0, 247.0]]"), "$.vehicle.fence[0][1]"),
        (("[net]", "cell_m = 0.1\n[net]"), "robot.speed_m_s 5 is 50 cells/s"),
        (("id = 3", "id = 300"), "vehicle.sysid"),
        (("[net]", "[net]\ntransport = 'zenoh'"), "no zenoh endpoint"),
        (("[net]", "[net]\ntransport = 'mavlink'\ngroup = '239.1.1.1:1'"), "`group` is of transport udp"),
    ],
)
def test_a_mistake_is_one_line_with_its_place(change: tuple[str, str], words: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse_config(SMALLEST.replace(*change))
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_that_is_missing_or_not_text_is_a_config_error(tmp_path: Path) -> None:
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    for name in ("absent.toml", "binary.toml", "."):
        with pytest.raises(ConfigError, match=r"\S"):
            read_config(tmp_path / name)


def test_a_ground_robot_cannot_be_sent_home_straight_through_obstacles() -> None:
    text = SMALLEST.replace("[vehicle]", "[vehicle]\non_stop = 'return'")
    with pytest.raises(ConfigError, match="is for UAVs"):
        parse_config(text)
    assert parse_config(text.replace("UGV", "UAV")).vehicle.on_stop == "return"
