"""`gatar bench missions`: whole missions over bad links and with deaths, watched for what must never happen."""

from __future__ import annotations

import json
import random
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import click

from gatar_edge.commands._options import FiniteRange
from gatar_edge.errors import ConfigError

if TYPE_CHECKING:
    from gatar_edge.mission_watch import Seen
    from gatar_edge.sim_sitl.fleet_config import FleetConfig

KILLED_S = (2.0, 12.0)  # of the mission


@dataclass(frozen=True, slots=True)
class Flown:
    """One mission, judged."""

    seed: int
    steps: float
    killed: int
    left: int  # targets not localized that a living robot can reach
    seen: Seen

    @property
    def failed(self) -> bool:
        """Whether something happened that must never happen."""
        return bool(self.left or self.seen.in_obstacle or self.seen.outside_fence or self.seen.orphaned)


def with_kills(config: FleetConfig, kills: int, seed: int) -> FleetConfig:
    """The same mission, in which `kills` robots die at times drawn from the seed. Raises ConfigError."""
    ids = config.world.team.ids
    if kills >= len(ids):
        raise ConfigError(f"{kills} kills leave nobody of a team of {len(ids)}")
    rng = random.Random(f"kills/{seed}")
    deaths = {robot_id: int(rng.uniform(*KILLED_S) * 1e9) for robot_id in rng.sample(ids, kills)}
    return replace(config, faults=replace(config.faults, kill_ns=deaths))


def fly_watched(config: FleetConfig, allocator: str) -> Flown:
    """Fly until everything that a living robot can reach is localized, or out of steps."""
    from gatar_edge.allocators.registry import make
    from gatar_edge.mission_watch import Watch
    from gatar_edge.sim_sitl.fleet import Fleet, lock_step

    fleet = Fleet(config, make(allocator))
    watch = Watch(fleet)
    for _ in lock_step(fleet):
        watch.look()
        if fleet.began_ns is not None and watch.left() == 0:
            break
    killed = sum(not robot.alive for robot in fleet.robots)
    return Flown(config.world.seed, round(fleet.step, 1), killed, watch.left(), watch.finish())


def summary(flown: list[Flown]) -> dict[str, Any]:
    """The figures over all missions."""
    separations = [mission.seen.separation_m for mission in flown]
    taken = sorted(ticks for mission in flown for ticks in mission.seen.taken_ticks)
    planned = sorted(ticks for mission in flown for ticks in mission.seen.planned_ticks)
    replanned = sorted(ticks for mission in flown for ticks in mission.seen.replanned_ticks)
    neglected = sorted(ticks for mission in flown for ticks in mission.seen.neglected_ticks)
    steps = sorted(mission.steps for mission in flown)
    return {
        "missions": len(flown),
        "failed_seeds": [mission.seed for mission in flown if mission.failed],
        "targets_left": sum(mission.left for mission in flown),
        "ugv_in_obstacle": sum(mission.seen.in_obstacle for mission in flown),
        "commands_outside_fence": sum(len(mission.seen.outside_fence) for mission in flown),
        "least_uav_separation_m": round(min(separations), 2) if min(separations) < float("inf") else None,
        "steps_median": steps[len(steps) // 2],
        "steps_max": steps[-1],
        "killed": sum(mission.killed for mission in flown),
        "orphaned_targets": len(taken),
        "replanned_ticks_p95": _p95(replanned),
        "neglected_ticks_p95": _p95(neglected),
        "planned_ticks_median": planned[len(planned) // 2] if planned else None,
        "planned_ticks_p95": _p95(planned),
        "taken_ticks_median": taken[len(taken) // 2] if taken else None,
        "taken_ticks_p95": _p95(taken),
    }


def _p95(values: list[int]) -> int | None:
    return values[int(0.95 * (len(values) - 1))] if values else None


def seeds_of(text: str) -> range:
    """The seeds of `7` or `1-50`. Raises ConfigError."""
    first, dash, last = text.partition("-")
    numbers = (first, last if dash else first)
    if not all(part.isascii() and part.isdigit() and len(part) < 7 for part in numbers) or int(first) > int(numbers[1]):
        raise ConfigError(f"seeds {text!r} are not of the form 7 or 1-50")
    return range(int(first), int(numbers[1]) + 1)


@click.command("missions")
@click.option("--team", default="3A3G", show_default=True)
@click.option("--seeds", default="1-50", show_default=True, help="One seed a mission.")
@click.option("--allocator", default="greedy", show_default=True)
@click.option("--stack", type=click.Choice(["ardupilot", "px4", "mixed"]), default="mixed", show_default=True)
@click.option("--loss", type=FiniteRange(0, 0.95), default=0.2, show_default=True, help="On the radio.")
@click.option("--telemetry-loss", type=FiniteRange(0, 0.9), default=0.2, show_default=True)
@click.option("--kills", type=click.IntRange(0, 63), default=0, show_default=True, help="Robots that die in flight.")
@click.option("--max-steps", type=click.IntRange(1, 100_000), default=300, show_default=True)
@click.option("--json", "as_json", is_flag=True, help="Print for machines.")
def command(seeds: str, allocator: str, kills: int, as_json: bool, **options: Any) -> None:
    """Fly missions over bad links; exit code 1 if a target is left, a UGV enters an obstacle, or a command leaves
    the fence.

    A dead robot's target, where no other robot pursued it, counts from the tick at which the robot's last message has
    expired. In ticks:

    \b
      replanned  until no living robot's joint solution counts on the dead one any more
      planned    until some living robot's joint solution gives the target to a living robot: a solution gives each
                 robot one target, so that a target far from all waits while all have nearer ones
      taken      until somebody pursues it, or has localized it: robots finish the targets that they have first
      neglected  of these, ticks at which a robot that knew of it and could have gone had no target at all

    \b
    Example:
      gatar bench missions --seeds 1-50
      gatar bench missions --team 6A6G --kills 4 --seeds 1-20 --json
    """
    from gatar_edge.commands._sim import fleet_config

    flown = []
    for seed in seeds_of(seeds):
        config = with_kills(fleet_config(seed=seed, **options), kills, seed)
        flown.append(fly_watched(config, allocator))
        mission = flown[-1]
        if not as_json:
            fate = "FAILED" if mission.failed else "ok"
            click.echo(f"seed {seed:4}: {fate}, {mission.steps:g} steps, {mission.killed} killed, {mission.left} left")
    figures = summary(flown)
    if as_json:
        click.echo(json.dumps(figures))
    else:
        for name, value in figures.items():
            click.echo(f"{name.replace('_', ' '):24} {value}")
    if figures["failed_seeds"]:
        raise SystemExit(1)
