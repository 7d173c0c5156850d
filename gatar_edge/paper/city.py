"""City maps: what robots of each kind have covered after 40 steps (the paper's figure of Columbus Circle)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gatar_edge.campaign import Campaign, factory, world_of
from gatar_edge.config import AgentConfig
from gatar_edge.errors import ConfigError
from gatar_edge.paper.table import Table, Value
from gatar_edge.sim_sitl.grid_mission import GridMission
from gatar_edge.sim_sitl.grid_mission import fly as fly_grid
from gatar_edge.sim_sitl.world import World, reachable_targets
from gatar_edge.types import Cell, GridSpec, RobotKind

STEPS = 40  # as in the paper
TEAM, TARGETS, WINDOW = "6A6G", 40, 48
SEED = 9000
AROUND = 2  # half side of the square in which obstacles round a target are counted


@dataclass(frozen=True, slots=True)
class Coverage:
    """One mission cut after `STEPS`."""

    world: World
    tracks: Mapping[int, Sequence[Cell]]  # by robot id
    found_by: Mapping[Cell, int]  # target -> id of the robot that localized it
    reachable: int

    def kind(self, robot_id: int) -> RobotKind:
        """Of a robot."""
        return self.world.team.kinds[robot_id - 1]

    def found(self, kind: RobotKind) -> list[Cell]:
        """Targets localized by robots of a kind."""
        return [cell for cell, robot_id in self.found_by.items() if self.kind(robot_id) is kind]


def map_files(folder: Path) -> list[Path]:
    """The city maps in a folder. Raises ConfigError where there is none."""
    files = sorted(folder.glob("*.map"))
    if not files:
        raise ConfigError(f"{folder} holds no *.map file")
    return files


def cover(map_file: Path, allocator: str, seed: int) -> Coverage:
    """Fly `STEPS` steps on a window of the map. Raises what `campaign.world_of` and `campaign.factory` raise."""
    campaign = Campaign(team=TEAM, targets=TARGETS, map_file=str(map_file), window=WINDOW, seed=seed)
    world = world_of(campaign, seed)
    config = AgentConfig(grid=GridSpec(width=WINDOW, height=WINDOW))
    targets = {(int(x), int(y)) for x, y in reachable_targets(world)}
    tracks: dict[int, list[Cell]] = {robot_id: [] for robot_id in world.team.ids}
    found_by: dict[Cell, int] = {}

    def watch(step: int, cells: Mapping[int, Cell]) -> None:
        for robot_id, cell in cells.items():
            tracks[robot_id].append(cell)
            if step and cell in targets:
                found_by.setdefault(cell, robot_id)

    fly_grid(GridMission(world, config, max_steps=STEPS), factory(allocator), watch)
    return Coverage(world, tracks, found_by, len(targets))


def cover_all(
    files: Sequence[Path], allocators: Mapping[str, str], missions: int, progress: Callable[[float, str], None]
) -> tuple[Table, Coverage]:
    """Every map with every allocator, and the first mission of the first of both, to be drawn."""
    columns = (
        "map", "allocator", "localized", "by UAVs", "by UGVs", "obstacles round UAVs' targets",
        "obstacles round UGVs' targets", "missions",
    )  # fmt: skip
    rows: list[tuple[Value, ...]] = []
    first: Coverage | None = None
    total = len(files) * len(allocators) * missions
    for file in files:
        for label, allocator in allocators.items():
            flown = []
            for seed in range(SEED, SEED + missions):
                flown.append(cover(file, allocator, seed))
                progress((len(rows) * missions + len(flown)) / total, f"{file.stem}, {label}")
            first = first or flown[0]
            rows.append((file.stem, label, *_shares(flown), missions))
    assert first is not None
    return Table("city", columns, tuple(rows)), first


def _shares(flown: Sequence[Coverage]) -> tuple[float, float, float, float | None, float | None]:
    """Shares of the reachable targets: all, by UAVs, by UGVs; and mean obstacle shares round either's targets."""
    targets = sum(one.reachable for one in flown)
    by = {kind: sum(len(one.found(kind)) for one in flown) / targets for kind in RobotKind}
    near = [
        [_obstacles(one.world, cell) for one in flown for cell in one.found(kind)]
        for kind in (RobotKind.UAV, RobotKind.UGV)
    ]
    uavs, ugvs = (float(np.mean(shares)) if shares else None for shares in near)
    return sum(by.values()), by[RobotKind.UAV], by[RobotKind.UGV], uavs, ugvs


def _obstacles(world: World, cell: Cell) -> float:
    low = [max(0, side - AROUND) for side in cell]
    part = world.obstacles[low[0] : cell[0] + AROUND + 1, low[1] : cell[1] + AROUND + 1]
    return float(part.mean())
