"""`gatar bench fuzz`: random and mutated bytes into everything that reads bytes from outside."""

from __future__ import annotations

import json
import time
from typing import Any

import click


def config_sample() -> bytes:
    """A complete vehicle.toml."""
    from gatar_edge.commands.init import configuration

    options = {
        "robot_id": 1,
        "kind": "UAV",
        "speed_m_s": 5.0,
        "cell_m": 10.0,
        "r_sense": 4.0,
        "r_comm": 6.0,
        "altitude_m": 20.0,
        "allocator": "greedy",
        "url": "udpin:127.0.0.1:14551",
        "listen": "127.0.0.1:14600",
        "peers": ["127.0.0.1:14601"],
        "perception": "127.0.0.1:14700",
        "launch": "armed",
        "http": "",
    }
    return configuration("robot1.toml", (47.397742, 8.545594), (15, 15), "team.key", options).encode()


@click.command("fuzz")
@click.option(
    "--count", type=click.IntRange(1, 100_000_000), default=20_000, show_default=True, help="Inputs a parser."
)
@click.option("--seed", type=click.IntRange(0), default=1, show_default=True)
@click.option("--only", default="", help="Parsers whose name contains this.")
@click.option("--json", "as_json", is_flag=True, help="Print for machines.")
def command(count: int, seed: int, only: str, as_json: bool) -> None:
    """Feed random and mutated bytes to every parser: only typed errors may come out; exit code 1 otherwise.

    MAVLink of both directions to drivers and simulated autopilots of every dialect, messages of neighbours,
    observations, vehicle.toml and faults.toml. Most mutants get a correct checksum, so that their contents are read.

    \b
    Example:
      gatar bench fuzz --count 100000
    """
    from gatar_edge.fuzzing import fuzz, targets

    rows: list[dict[str, Any]] = []
    for target in targets(config_sample()):
        if only not in target.name:
            continue
        start_s = time.process_time()
        findings = list(fuzz(target, count, seed))
        row = {"parser": target.name, "inputs": count, "cpu_s": round(time.process_time() - start_s, 1)}
        rows.append(row | {"findings": [f"input {f.number}: {f.problem} <- {f.data.hex()}" for f in findings]})
        if not as_json:
            click.echo(f"{target.name:32} {count} inputs, {row['cpu_s']} s: {rows[-1]['findings'] or 'ok'}")
    if as_json:
        click.echo(json.dumps({"seed": seed, "parsers": rows}))
    if any(row["findings"] for row in rows):
        raise SystemExit(1)
