"""Daemons as separate processes on simulated vehicles, by the wall clock: started, killed, stopped, and replayed."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from minds import HOST, Minds, Place, fly, free_ports, yard_of

from gatar_edge.allocators.greedy import Greedy
from gatar_edge.commands._sim import fleet_config
from gatar_edge.review.reader import LogReader
from gatar_edge.review.replay import Replay
from gatar_edge.sim_sitl.realtime import UdpSocket, paced
from gatar_edge.sim_sitl.yard import Yard

SPEED = 4.0  # times real time: the daemons then tick every 0.8 simulated seconds
LIMIT_S = 120.0


@pytest.fixture
def team(tmp_path: Path) -> Iterator[Callable[..., tuple[Yard, Minds]]]:
    """Makes a yard and the minds of its robots, none of which runs yet."""
    with contextlib.ExitStack() as stack:

        def make(**mission: object) -> tuple[Yard, Minds]:
            config = fleet_config(**mission)  # type: ignore[arg-type]
            vehicles = stack.enter_context(contextlib.closing(UdpSocket(f"{HOST}:0")))
            radio = stack.enter_context(contextlib.closing(UdpSocket(f"{HOST}:0")))
            ports = free_ports(2 * len(config.world.team.ids))
            places = {robot_id: Place(HOST, ports.pop(), ports.pop()) for robot_id in config.world.team.ids}
            minds = Minds(config, tmp_path, places, HOST, (vehicles.port, radio.port))
            stack.enter_context(contextlib.closing(minds))
            return yard_of(config, places, vehicles, radio), minds

        yield make


@pytest.mark.slow
def test_a_team_of_processes_finishes_although_one_is_killed_one_stopped_and_one_late(
    team: Callable[..., tuple[Yard, Minds]], tmp_path: Path
) -> None:
    yard, minds = team(team="2A2G", seed=2, targets=16, stack="mixed", loss=0.2)
    times = paced(0.05, SPEED)
    everybody = yard.tally.left
    for robot_id in (1, 2, 3):
        minds.start(robot_id)
    fly(yard, times, LIMIT_S * SPEED, until=lambda: yard.tally.left <= everybody - 3)
    minds.kill(1)
    minds.start(1)
    minds.start(4)
    minds.send(2, signal.SIGSTOP)
    fly(yard, times, LIMIT_S * SPEED, until=lambda: yard.tally.left <= everybody - 8)
    minds.send(2, signal.SIGCONT)
    fly(yard, times, LIMIT_S * SPEED, until=lambda: yard.over)
    assert yard.tally.left == 0
    assert minds.end() == [0, 0, 0, 0]
    assert "outcome=loaded" in minds.said(1)
    assert "stood still" in minds.said(2)
    logs = sorted((tmp_path / "logs").glob("*.mcap"))
    assert len(logs) == 5
    for log in logs:
        result = Replay(lambda _: Greedy()).run(LogReader(log))
        assert result.decisions > 0
        assert result.equal == result.decisions, (log.name, result.differences[:1])
