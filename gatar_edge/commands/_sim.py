"""What the commands around the fleet simulator share: building a mission, opening it with its log, showing progress."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from gatar_edge.errors import ConfigError

if TYPE_CHECKING:
    from gatar_edge.sim_sitl.fleet import Fleet, Gateway
    from gatar_edge.sim_sitl.fleet_config import FleetConfig
    from gatar_edge.sim_sitl.yard import Yard


def fleet_config(
    *,
    team: str,
    seed: int,
    targets: int | None = None,
    size: int = 15,
    r_sense: float = 4.0,
    r_comm: float = 6.0,
    stack: str = "ardupilot",
    loss: float = 0.0,
    telemetry_loss: float = 0.0,
    faults_file: Path | None = None,
    max_steps: int = 500,
) -> FleetConfig:
    """The mission that the options describe. Raises ConfigError and WorldError."""
    from gatar_edge.config import AgentConfig
    from gatar_edge.sim_sitl.faults import Faults, LinkFaults
    from gatar_edge.sim_sitl.faults_file import load_faults
    from gatar_edge.sim_sitl.fleet_config import FleetConfig
    from gatar_edge.sim_sitl.world import Team, random_world
    from gatar_edge.types import GridSpec

    if faults_file is not None:
        if loss or telemetry_loss:
            raise ConfigError("--faults excludes --loss and --telemetry-loss: the file says it all")
        faults = load_faults(faults_file)
    else:
        faults = Faults(LinkFaults(loss=loss), LinkFaults(loss=telemetry_loss), LinkFaults(loss=telemetry_loss))
    world = random_world(Team.parse(team), targets, size, size, seed)
    grid = GridSpec(width=size, height=size)
    families: dict[str, tuple[Any, Any]] = {"mixed": ("ardupilot", "px4")}
    pair = families.get(stack, (stack, stack))
    return FleetConfig(
        world=world,
        agent=AgentConfig(grid=grid, r_sense=r_sense, r_comm=r_comm),
        stacks=tuple(pair[index % 2] for index in range(len(world.team.kinds))),
        faults=faults,
        max_steps=max_steps,
    )


@contextlib.contextmanager
def open_fleet(
    config: FleetConfig, allocator: str, log_path: Path | None, gateway: Gateway | None = None
) -> Iterator[Fleet]:
    """The fleet with its log, which is closed however the mission ends."""
    from gatar_edge.campaign import factory as factory_of
    from gatar_edge.record import Recorder
    from gatar_edge.sim_sitl.fleet import Fleet

    factory = factory_of(allocator)
    # a mission can be flown again: to wait for the disk, many times a second in virtual time, would protect nothing
    log = Recorder(log_path, run_info(config, allocator), 0, durable=False) if log_path is not None else None
    fleet = Fleet(config, factory, log, gateway)
    try:
        yield fleet
        if log is not None:
            log.result(fleet.result().to_json(), fleet.now_ns)
    finally:
        if log is not None:
            log.close()


def run_info(config: FleetConfig, allocator: str) -> dict[str, Any]:
    """What the log says of this run."""
    from gatar_edge.agent import Identity
    from gatar_edge.runinfo import describe_run

    world = config.world
    speed_cells_s = config.speed_m_s / config.agent.grid.cell_m
    robots = [Identity(i, kind, speed_cells_s) for i, kind in zip(world.team.ids, world.team.kinds, strict=True)]
    extra = {
        "team": str(world.team),
        "seed": world.seed,
        "targets": len(world.targets),
        "step_s": config.step_ns / 1e9,
        "stacks": list(config.stacks),
        "radio_loss": config.faults.radio.loss,
        "simulated": True,
    }
    return describe_run(config.agent, robots, allocator, extra=extra)


@contextlib.contextmanager
def progress(fleet: Fleet | Yard, quiet: bool) -> Iterator[Callable[[], None]]:
    """A bar on a terminal, a plain line every ten steps elsewhere, nothing when quiet."""
    if quiet:
        yield lambda: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    if not console.is_terminal:
        yield _plain_lines(fleet)
        return
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("launch", total=fleet.tally.reachable)

        def update() -> None:
            phase = "launch" if fleet.began_ns is None else f"step {fleet.step:5.1f}"
            done = fleet.tally.reachable - fleet.tally.left
            bar.update(task, completed=done, description=f"{phase}  targets localized")

        yield update


def _plain_lines(fleet: Fleet | Yard) -> Callable[[], None]:
    said = -10.0

    def update() -> None:
        nonlocal said
        if fleet.began_ns is not None and fleet.step >= said + 10:
            said = fleet.step
            done = fleet.tally.reachable - fleet.tally.left
            click.echo(f"step {fleet.step:5.1f}: {done}/{fleet.tally.reachable} targets localized", err=True)

    return update
