"""What a simulated mission is made of."""

from __future__ import annotations

from dataclasses import dataclass, field

from gatar_edge.config import AgentConfig
from gatar_edge.sim_sitl.body import StackName
from gatar_edge.sim_sitl.faults import Faults
from gatar_edge.sim_sitl.world import World
from gatar_edge.types import NS_PER_S


@dataclass(frozen=True, slots=True)
class FleetConfig:
    """One simulated mission."""

    world: World
    agent: AgentConfig
    stacks: tuple[StackName, ...]  # by robot index
    faults: Faults = field(default_factory=Faults)  # times of kills count from the end of the launch
    speed_m_s: float = 5.0
    altitude_m: float = 15.0
    altitude_step_m: float = 2.0  # every UAV has its own layer
    min_separation_m: float = 0.0  # between ground robots at rest; 0: not asked
    physics_s: float = 0.1
    tick_s: float = 0.5
    launch_timeout_s: float = 120.0
    max_steps: int = 500

    @property
    def step_ns(self) -> int:
        """A step: the time in which a robot at cruise speed crosses one cell."""
        return int(self.agent.grid.cell_m / self.speed_m_s * NS_PER_S)
