"""`gatar bench sim`: how much faster than real time the fleet simulator flies."""

from __future__ import annotations

import json
import tempfile
import time
from pathlib import Path

import click


@click.command("sim")
@click.option("--team", default="6A6G", show_default=True)
@click.option("--seed", type=click.IntRange(0), default=1, show_default=True)
@click.option("--allocator", default="gatar", show_default=True)
@click.option("--stack", type=click.Choice(["ardupilot", "px4", "mixed"]), default="mixed", show_default=True)
@click.option("--missions", type=click.IntRange(1, 1000), default=3, show_default=True)
@click.option("--json", "as_json", is_flag=True, help="Print for machines.")
def command(team: str, seed: int, allocator: str, stack: str, missions: int, as_json: bool) -> None:
    """Fly whole missions with agents, radio, MAVLink and log, and divide simulated time by CPU time.

    \b
    Example:
      gatar bench sim --team 6A6G --json
    """
    import tcod.map  # noqa: F401  # otherwise loaded at a ground robot's first look: no part of the flight

    from gatar_edge.commands._sim import fleet_config, open_fleet
    from gatar_edge.sim_sitl.fleet import lock_step

    flown_s = used_s = 0.0
    for number in range(missions):
        config = fleet_config(team=team, seed=seed + number, stack=stack)
        with tempfile.TemporaryDirectory() as folder, open_fleet(config, allocator, Path(folder) / "m.mcap") as fleet:
            start_s = time.process_time()
            for now_ns in lock_step(fleet):
                last_ns = now_ns
            used_s += time.process_time() - start_s
            flown_s += last_ns / 1e9
    figures = {"team": team, "missions": missions, "simulated_s": round(flown_s, 1), "cpu_s": round(used_s, 2)}
    figures["times_real_time"] = round(flown_s / used_s, 1)
    if as_json:
        click.echo(json.dumps(figures))
    else:
        click.echo(f"{team}: {flown_s:.0f} s flown in {used_s:.1f} s of one core: {flown_s / used_s:.0f} x real time")
