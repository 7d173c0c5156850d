"""`gatar verify`."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import click

from gatar_edge.commands._learn import bar, need


@click.command("verify")
@click.argument("model", type=click.Path(path_type=Path, dir_okay=False))
@click.option(
    "--flown",
    type=click.IntRange(0, 1_000_000),
    default=1000,
    show_default=True,
    help="States from missions, beside the random ones.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the proof as JSON.")
def command(model: Path, flown: int, as_json: bool) -> None:
    """Compare an ONNX file with its network for every team size; exit code 1 where they differ.

    The weights are read from the .safetensors file beside the model.

    \b
    Example:
      gatar verify models/gatar-greedy.onnx
    """
    need("gatar verify", "torch", "safetensors", "onnx", extra="export")
    import torch

    from gatar_edge.export.verify import verify

    torch.set_num_threads(1)  # tiny matrices: more threads only wait for each other

    with bar("verify", "") as show:
        proof = verify(model, show, flown=flown)
    if as_json:
        click.echo(json.dumps(proof.as_json()))
    elif proof.ok:
        click.echo(
            f"{proof.model}: equal in {proof.states} states of {proof.robots[0]} to {proof.robots[1]} robots, "
            f"{proof.decisions} decisions; largest difference {proof.max_difference:.1e} "
            f"(tolerance {proof.tolerance:.0e})"
        )
    else:
        click.echo(f"{proof.model}: {proof.error}", err=True)
    sys.exit(0 if proof.ok else 1)
