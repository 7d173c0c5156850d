"""The driver passes over the time in which it has nothing to do, and nobody on the wire can tell."""

from __future__ import annotations

import pytest

from gatar_edge.allocators.registry import make
from gatar_edge.bridge.driver import VehicleDriver
from gatar_edge.commands._sim import fleet_config
from gatar_edge.sim_sitl.faulty_link import End
from gatar_edge.sim_sitl.fleet import Fleet, lock_step


def wire_of_a_mission(seed: int) -> list[tuple[int, End, bytes]]:
    """All that is said on the wires of a mission over bad links, with its time."""
    config = fleet_config(team="1A1G", seed=seed, targets=6, stack="mixed", telemetry_loss=0.2, max_steps=60)
    fleet = Fleet(config, make("greedy"))
    said: list[tuple[int, End, bytes]] = []
    for robot in fleet.robots:
        robot.wire.tap = lambda end, data: said.append((fleet.now_ns, end, data))
    for _ in lock_step(fleet):
        pass
    return said


@pytest.mark.parametrize("seed", [1, 2])
def test_it_says_the_same_as_one_that_looks_at_everything_each_time(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    polled = idle = 0
    poll = VehicleDriver.poll

    def counted(driver: VehicleDriver, now_ns: int) -> bytes:
        nonlocal polled, idle
        polled += 1
        idle += not driver._stirred and now_ns < driver._next_due_ns(now_ns)
        return poll(driver, now_ns)

    def restless(driver: VehicleDriver, now_ns: int) -> bytes:
        driver._stirred = True
        return poll(driver, now_ns)

    monkeypatch.setattr(VehicleDriver, "poll", counted)
    said = wire_of_a_mission(seed)
    assert idle > polled / 4
    monkeypatch.setattr(VehicleDriver, "poll", restless)
    assert said == wire_of_a_mission(seed)
