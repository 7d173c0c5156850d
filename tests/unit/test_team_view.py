"""`gatar fleet`: rows say what was heard, loss counts what was not, and a listener needs the team's key."""

from __future__ import annotations

import json
import os
import socket
import threading
from pathlib import Path

import pytest
from click.testing import CliRunner
from fake_ports import Rig

from gatar_edge.commands.fleet import command, table
from gatar_edge.errors import ConfigError
from gatar_edge.keys import DEMO_KEY
from gatar_edge.message import with_hops
from gatar_edge.team_view import TeamView
from gatar_edge.types import NS_PER_S


def messages(robot_id: int, count: int) -> list[bytes]:
    rig = Rig(robot_id)
    rig.run(count * 0.2)
    return rig.radio.sent


def test_a_row_says_who_where_what_for_and_how_old() -> None:
    view = TeamView(DEMO_KEY)
    for tick, data in enumerate(messages(3, 6)):
        view.hear(with_hops(data, 1, DEMO_KEY), tick * NS_PER_S // 5)
    (row,) = view.rows(3 * NS_PER_S)
    assert (row.robot_id, row.kind, row.cell, row.task, row.task_cell) == (3, "UAV", (0, 0), "TARGET", (5, 5))
    assert (row.age_s, row.hops, row.loss, row.moves) == (2.0, 1, 0.0, True)
    assert row.rate_hz == pytest.approx(5.0)


def test_what_did_not_arrive_on_any_way_is_loss() -> None:
    view = TeamView(DEMO_KEY)
    for tick, data in enumerate(messages(3, 11)):
        if tick not in (3, 4):
            view.hear(data, tick * NS_PER_S // 5)
            view.hear(with_hops(data, 1, DEMO_KEY), tick * NS_PER_S // 5)
    (row,) = view.rows(2 * NS_PER_S)
    assert row.loss == pytest.approx(2 / 11)
    assert (row.hops, view.repeated) == (0, 9)


def test_forged_messages_make_no_robot() -> None:
    view = TeamView(b"k" * 32)
    for data in [*messages(3, 2), b"", b"noise" * 100]:
        view.hear(data, 0)
    assert (view.rows(0), view.refused) == ([], 4)


def test_the_table_warns_of_robots_that_cannot_hear_each_other() -> None:
    view = TeamView(DEMO_KEY)
    view.hear(messages(3, 1)[0], 0)
    assert table(view.rows(0), view).title == "1 robot"
    rows = view.rows(0)
    other = type(rows[0])(**{name: getattr(rows[0], name) for name in rows[0].__struct_fields__} | {"team": "other"})
    assert "CONFIGURATIONS DIFFER" in str(table([rows[0], other], view).title)


def test_the_table_tells_a_robot_that_fell_silent_from_one_that_is_there() -> None:
    view = TeamView(DEMO_KEY)
    for robot_id, heard_ns in ((3, 0), (4, 5 * NS_PER_S)):
        for data in messages(robot_id, 6):
            view.hear(data, heard_ns)
    shown = table(view.rows(6 * NS_PER_S), view)
    assert shown.title == "2 robots, 1 silent"
    columns = {str(column.header): list(column.cells) for column in shown.columns}
    assert (columns["task"][0], columns["rate"][0], shown.rows[0].style) == ("silent", "-", "red")
    assert (columns["task"][1], shown.rows[1].style) == ("target 5,5", None)


def test_the_command_prints_the_team_it_hears_as_json(tmp_path: Path) -> None:
    key = tmp_path / "team.key"
    key.write_bytes(DEMO_KEY)
    os.chmod(key, 0o600)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    done = threading.Event()

    def talk() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            data = messages(3, 1)[0]
            while not done.wait(0.01):
                sender.sendto(data, ("127.0.0.1", port))

    thread = threading.Thread(target=talk)
    thread.start()
    try:
        arguments = ["--key", str(key), "--listen", f"127.0.0.1:{port}", "--seconds", "0.3", "--json"]
        result = CliRunner().invoke(command, arguments)
    finally:
        done.set()
        thread.join()
    assert json.loads(result.output.splitlines()[-1])["robots"][0]["robot_id"] == 3


def test_without_a_key_there_is_nothing_to_show() -> None:
    result = CliRunner().invoke(command, [])
    assert isinstance(result.exception, ConfigError)


@pytest.mark.parametrize(
    "net", ['transport = "mavlink"', 'transport = "zenoh"\nlisten = "tcp/0.0.0.0:7447"'], ids=["mavlink", "zenoh"]
)
def test_a_team_that_does_not_talk_over_udp_is_told_at_once(tmp_path: Path, net: str) -> None:
    config = tmp_path / "vehicle.toml"
    config.write_text(
        '[robot]\nid = 3\nkind = "UAV"\n[grid]\norigin_lat_deg = 47.0\norigin_lon_deg = 8.0\n'
        f'[vehicle]\nurl = "udpin:127.0.0.1:14550"\n[net]\nkey_file = "team.key"\n{net}\n'
    )
    (tmp_path / "team.key").write_bytes(DEMO_KEY)
    (tmp_path / "team.key").chmod(0o600)
    result = CliRunner().invoke(command, ["--config", str(config), "--seconds", "0.2"])
    assert isinstance(result.exception, ConfigError)
    assert "the fleet is heard over udp only" in str(result.exception)
