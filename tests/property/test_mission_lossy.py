"""Missions through a link that loses 30 % and doubles 10 % each way, reorders, and delays up to 400 ms.

Invariant: every transfer ends, and whenever the client says "accepted" and no transfer is open, what is on board is
what was sent. A failure names the seed that reproduces it.
"""

from __future__ import annotations

import random

import pytest
from bridge_mission_server import ME, MS, VEHICLE, Lossy, Server

from gatar_edge.bridge.mission_items import Items, build, same_mission
from gatar_edge.bridge.mission_states import Result
from gatar_edge.bridge.mission_transfer import MissionClient
from gatar_edge.bridge.profiles import PROFILES

S = 1_000_000_000
SEEDS = 200


class Run:
    def __init__(self, seed: int, ardupilot: bool, loss: float) -> None:
        self.seed, rng = seed, random.Random(seed)
        self.profile = PROFILES[1 if ardupilot else 3]
        self.client = MissionClient(self.profile, ME, VEHICLE, random.Random(seed))
        self.server = Server(ardupilot)
        self.up, self.down = Lossy(rng, loss, 0.1, 400), Lossy(rng, loss, 0.1, 400)
        self.now = 0

    def step(self) -> None:
        self.now += 20 * MS
        for message in self.client.poll(self.now):
            self.up.put(message, self.now)
        for arrived in self.up.get(self.now):
            self.server.receive(arrived, self.now)
        self.server.tick(self.now)
        for answer in self.server.out:
            self.down.put(answer, self.now)
        self.server.out = []
        for arrived in self.down.get(self.now):
            self.client.receive(VEHICLE, arrived, self.now)  # type: ignore[arg-type]

    def upload(self, shift: float) -> Result:
        """Upload 12 waypoints; the seconds after it are the caller's."""
        items = self.items(shift)
        started = self.now
        self.client.upload(items, self.now)
        while self.client.result is None:
            self.step()
            assert self.now - started < 61 * S, f"the transfer does not end, seed {self.seed}"
        self.check(items)
        return self.client.result

    def items(self, shift: float) -> Items:
        return build(self.profile, tuple((10 + i * 1e-3 + shift, 20.0) for i in range(12)), 5.0)

    def check(self, items: Items) -> None:
        if self.client.result is not None and self.client.result.ok:
            assert same_mission(items, tuple(self.server.board), self.profile), f"a false 'accepted', seed {self.seed}"

    def settle(self, shift: float, seconds: float) -> None:
        until = self.now + round(seconds * S)
        while self.now < until or self.client.result is None:
            self.step()
        self.check(self.items(shift))


@pytest.mark.parametrize("ardupilot", [True, False], ids=["ardupilot", "px4"])
def test_every_upload_ends_and_every_accepted_one_is_on_board(ardupilot: bool) -> None:
    results = []
    for seed in range(SEEDS):
        run = Run(seed, ardupilot, loss=0.3)
        results.append(run.upload(0.0))
        run.settle(0.0, 12)
    assert results.count(Result.ACCEPTED) >= 0.97 * SEEDS


@pytest.mark.parametrize("loss", [0.3, 0.0])
@pytest.mark.parametrize("ardupilot", [True, False], ids=["ardupilot", "px4"])
def test_retasking_at_once_is_never_confused_by_packets_of_the_mission_before(ardupilot: bool, loss: float) -> None:
    for seed in range(SEEDS):
        run = Run(seed, ardupilot, loss)
        for shift in (0.0, 1.0, 2.0):
            run.upload(shift)
        run.settle(2.0, 12)


@pytest.mark.parametrize("ardupilot", [True, False], ids=["ardupilot", "px4"])
def test_a_mission_replaced_in_the_middle_of_its_upload_ends_as_the_new_one(ardupilot: bool) -> None:
    for seed in range(SEEDS):
        run = Run(seed, ardupilot, loss=0.3)
        run.client.upload(run.items(0.0), run.now)
        for _ in range(random.Random(seed).randrange(300)):
            run.step()
        run.upload(1.0)
        run.settle(1.0, 12)
