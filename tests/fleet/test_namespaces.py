"""Six daemons, each a process in a network namespace of its own, with a lossy radio between them."""

from __future__ import annotations

import contextlib
import itertools
import json
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner
from minds import Minds, Place, fly, yard_of
from namespaces import Bridge, NoNamespacesError, inside

from gatar_edge.commands._sim import fleet_config
from gatar_edge.commands.log import command as log
from gatar_edge.sim_sitl.realtime import UdpSocket, paced

SPEED = 2.0  # times real time
LIMIT_S = 200.0 * SPEED
STOPPED_S = 10.0
EAR, EYE, VEHICLES, RADIO = 14600, 14700, 14550, 14601


@pytest.fixture
def bridge() -> Iterator[Bridge]:
    """A network of its own; the test is skipped where the machine allows none."""
    with contextlib.ExitStack() as stack:
        try:
            made = Bridge(stack)
        except (NoNamespacesError, OSError) as error:
            pytest.skip(f"no network namespaces here: {error}")
        yield made


def reviewed(folder: Path, output: Path) -> dict[str, int]:
    """What `gatar log merge` and `gatar log replay` say of all logs in `folder`."""
    logs = [str(path) for path in sorted(folder.glob("*.mcap"))]
    for arguments in (["merge", *logs, "-o", str(output)], ["replay", str(output), "--json"]):
        done = CliRunner().invoke(log, arguments, standalone_mode=False)
        assert done.exit_code == 0, (arguments[0], done.output, done.exception)
    answer: dict[str, int] = json.loads(done.stdout)
    return answer


@pytest.mark.sweep
def test_six_robots_in_networks_of_their_own_finish_although_one_is_killed_one_stopped_and_one_late(
    bridge: Bridge, tmp_path: Path
) -> None:
    config = fleet_config(team="3A3G", seed=3, targets=24, stack="mixed", loss=0.2)
    places = {}
    for robot_id in config.world.team.ids:
        host, within = bridge.add()
        places[robot_id] = Place(host, EAR, EYE, within)
    minds = Minds(config, tmp_path, places, bridge.host, (VEHICLES, RADIO))
    with contextlib.ExitStack() as stack:
        with inside(bridge.hub):
            vehicles = stack.enter_context(contextlib.closing(UdpSocket(f"{bridge.host}:{VEHICLES}")))
            radio = stack.enter_context(contextlib.closing(UdpSocket(f"{bridge.host}:{RADIO}")))
        stack.enter_context(contextlib.closing(minds))
        yard = yard_of(config, places, vehicles, radio)
        times, everybody = paced(0.05, SPEED), yard.tally.left
        for robot_id in (1, 2, 3, 4, 5):
            minds.start(robot_id)
        fly(yard, times, LIMIT_S, until=lambda: yard.tally.left <= everybody - 3)
        minds.kill(1)
        minds.start(1)
        minds.send(2, signal.SIGSTOP)
        minds.start(6)
        wakes_s = time.monotonic() + STOPPED_S
        fly(yard, times, LIMIT_S, until=lambda: time.monotonic() >= wakes_s)
        minds.send(2, signal.SIGCONT)
        fly(yard, times, LIMIT_S, until=lambda: yard.over)
        assert yard.tally.left == 0
        fly(yard, itertools.islice(times, 20), LIMIT_S, until=lambda: False)  # they hear of it, and write it down
        assert minds.end() == [0] * 6
    assert "outcome=loaded" in minds.said(1)
    assert "stood still" in minds.said(2)
    assert len(list((tmp_path / "logs").glob("*.mcap"))) == 7
    replayed = reviewed(tmp_path / "logs", tmp_path / "merged.mcap")
    assert replayed["decisions"] > 0
    assert replayed["equal"] == replayed["decisions"], replayed
