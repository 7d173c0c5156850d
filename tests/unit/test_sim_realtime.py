"""`gatar sim --realtime --daemons`: what it writes for the daemons."""

from __future__ import annotations

from pathlib import Path

import pytest

from gatar_edge.commands.sim import fleet_config, print_table
from gatar_edge.commands.sim_realtime import write_configurations
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
