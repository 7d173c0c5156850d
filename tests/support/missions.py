"""Small recorded missions for tests."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from gatar_edge.agent import Agent, Identity
from gatar_edge.allocators.base import Allocator
from gatar_edge.allocators.greedy import Greedy
from gatar_edge.config import AgentConfig
from gatar_edge.keys import DEMO_KEY
from gatar_edge.record import Recorder
from gatar_edge.review.lockstep import Lockstep
from gatar_edge.runinfo import describe_run
from gatar_edge.sim_sitl.world import Team, random_world
from gatar_edge.types import GridSpec


def record_mission(
    path: Path,
    make: Callable[[], Allocator] = Greedy,
    *,
    team: str = "2A2G",
    targets: int = 12,
    size: int = 12,
    seed: int = 4,
    steps: int = 60,
    close: bool = True,
) -> Lockstep:
    """Fly a mission in lock-step into a log at `path`; without `close`, the log is left as a kill would leave it."""
    crew = Team.parse(team)
    world = random_world(crew, targets, size, size, seed)
    config = AgentConfig(grid=GridSpec(width=size, height=size))
    robots = [Identity(number, kind, 1.0) for number, kind in zip(crew.ids, crew.kinds, strict=True)]
    info = describe_run(config, robots, make().name, extra={"team": team, "seed": seed, "step_s": 1.0})
    recorder = Recorder(path, info, 0)
    agents = [Agent(robot, config, make(), DEMO_KEY) for robot in robots]
    mission = Lockstep.from_start(world, agents, config.r_comm, recorder)
    mission.fly(steps)
    if close:
        recorder.close()
    return mission
