"""Its tests: `pip install gatar-edge`, then `pytest`. The fixtures come with it; nothing is imported from it."""

from __future__ import annotations

import pytest
from takeoff import take_off

LOSSY = """
[to_vehicle]
loss = 0.2
[to_companion]
loss = 0.2
"""


def test_a_copter_takes_off(vehicle):
    copter = vehicle("copter", stack="ardupilot", speed=20)
    take_off(copter.url, 5)
    assert copter.truth.alt_rel_m == pytest.approx(5, abs=0.6)
    assert copter.truth.mode == "GUIDED"


def test_a_copter_takes_off_though_every_fifth_message_is_lost(vehicle, faults):
    copter = vehicle("copter", speed=20, faults=faults(LOSSY))
    take_off(copter.url, 5)
    assert copter.truth.alt_rel_m == pytest.approx(5, abs=0.6)


def test_a_vehicle_that_may_not_arm_says_so(vehicle):
    copter = vehicle("copter", speed=1, ekf_ready_s=60)  # as long as a real one takes, and more
    with pytest.raises(RuntimeError, match="refused"):
        take_off(copter.url, 5)


def test_a_team_stands_ready(fleet):
    team = fleet("2A1G", stack="mixed")
    assert [one.truth.landed for one in team.vehicles] == [True, True, False]
    assert team.sysids == (1, 2, 3)
