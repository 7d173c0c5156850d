"""Vehicles without minds: the simulator's side of a mission whose agents are daemons in processes of their own.

Each vehicle is reached over the gateway; each daemon gets what its robot sees as the datagram of
`gatar_edge.perception`, at an address of its own.
"""

from __future__ import annotations

from collections.abc import Mapping

from gatar_edge.perception import encode_observation
from gatar_edge.sim_sitl.body import Body
from gatar_edge.sim_sitl.fleet import FleetConfig
from gatar_edge.sim_sitl.realtime import UdpGateway
from gatar_edge.sim_sitl.tally import Result, Tally
from gatar_edge.sim_sitl.world import observe
from gatar_edge.types import NS_PER_S

PERCEPTION_NS = NS_PER_S // 5


class Yard:
    """The bodies of a team in their world. Call `advance` with rising times."""

    def __init__(self, config: FleetConfig, gateway: UdpGateway, eyes: Mapping[int, tuple[str, int]]) -> None:
        self.config = config
        self.bodies = [
            Body(config.world, index, config.agent.grid, config.stacks[index], config.speed_m_s)
            for index in range(len(config.world.team.kinds))
        ]
        self.tally = Tally(config.world, "daemons")
        self.began_ns: int | None = None  # when the first vehicle moved off
        self._gateway = gateway
        self._eyes = eyes
        self._now_ns = 0
        self._next_look_ns = 0

    @property
    def over(self) -> bool:
        """Nothing left to localize, or out of time."""
        return self.tally.left == 0 or self.step >= self.config.max_steps

    @property
    def step(self) -> float:
        """The mission's time in steps."""
        return 0.0 if self.began_ns is None else (self._now_ns - self.began_ns) / self.config.step_ns

    def advance(self, now_ns: int) -> None:
        """Let the world go on up to `now_ns`."""
        self._now_ns = now_ns
        for data in self._gateway.receive():
            for body in self.bodies:
                body.autopilot.receive(data, now_ns)
        for body in self.bodies:
            before_m = body.travelled_m
            body.step(now_ns)
            self.tally.travel(body.kind, (body.travelled_m - before_m) / self.config.agent.grid.cell_m)
            self._gateway.send(body.autopilot.take())
        if self.began_ns is None and any(body.travelled_m > 1.0 for body in self.bodies):
            self.began_ns = now_ns
        if now_ns >= self._next_look_ns:
            self._next_look_ns += PERCEPTION_NS
            self._look(now_ns)

    def result(self) -> Result:
        """The mission's figures, as far as they show from outside the minds."""
        return self.tally.result(self.step)

    def _look(self, now_ns: int) -> None:
        for body in self.bodies:
            self.tally.visit(body.cell, self.step)
            seen = observe(self.config.world, body.robot_id, body.cell, self.config.agent.r_sense, now_ns)
            self._gateway.send_to(encode_observation(seen, now_ns), self._eyes[body.robot_id])
