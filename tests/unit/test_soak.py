"""What a daemon is measured among: real neighbours, real attacks, and missions that go on."""

from __future__ import annotations

import itertools
from collections import Counter
from pathlib import Path

import pytest

from gatar_edge import soak
from gatar_edge.agent import Agent, Identity
from gatar_edge.allocators.greedy import Greedy
from gatar_edge.config import AgentConfig
from gatar_edge.keys import DEMO_KEY
from gatar_edge.neighbors import HearOutcome
from gatar_edge.surroundings import GRID, SPEED_CELLS_S, Surroundings
from gatar_edge.types import RobotKind


def test_all_attacks_are_refused_each_kind_for_its_own_reason_and_change_nothing() -> None:
    around = Surroundings(neighbors=12)
    agent = Agent(Identity(1, RobotKind.UAV, SPEED_CELLS_S), AgentConfig(grid=GRID), Greedy(), DEMO_KEY)
    attacks = around.attacks()  # which records a tick, then comes too late with it
    for data in around.messages(relays=1):
        agent.hear(data, 0)
    before, belief = agent.memory(), agent.belief
    assert len(before.neighbors) == 12
    outcomes = Counter(agent.hear(data, 1).outcome for data in itertools.islice(attacks, 1000))
    assert set(outcomes) == {HearOutcome.FORGED, HearOutcome.OLDER, HearOutcome.VERSION}
    assert outcomes[HearOutcome.FORGED] == 600
    assert (agent.memory(), agent.belief is belief) == (before, True)


def test_a_soak_hears_everybody_decides_and_goes_on_to_the_next_mission(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(soak, "MISSION_TICKS", 150)
    day = soak.Soak("greedy", 4, tmp_path)
    known = []
    for _ in range(151):
        day.tick()
        known.append(int((day.daemon.agent.belief > 0).sum()))
    assert len(day.daemon.agent.memory().neighbors) == 4
    assert day.daemon.counters.held < day.daemon.counters.ticks == 151
    assert day.daemon.counters.fallbacks == 0
    assert known[-1] < known[-2]  # of the new map little is known
    day.log.close()


def test_growth_counts_from_the_end_of_the_warm_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(soak, "MISSION_TICKS", 2)
    sizes = iter([100.0, 104.0, 104.5, 105.0])
    monkeypatch.setattr(soak, "resident_mb", lambda: next(sizes))
    told: list[tuple[int, float]] = []
    growth = soak.grown("greedy", 1, missions=4, warm_up=2, told=lambda *done: told.append(done))
    assert (growth.mb, growth.ticks, growth.missions) == (1.0, 8, 4)
    assert (growth.from_h, growth.to_h) == (pytest.approx(1 / 3), pytest.approx(2 / 3))
    assert told == [(1, 100.0), (2, 104.0), (3, 104.5), (4, 105.0)]
