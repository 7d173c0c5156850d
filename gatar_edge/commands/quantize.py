"""`gatar quantize`."""

from __future__ import annotations

import json
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import click

from gatar_edge.commands._learn import need

if TYPE_CHECKING:
    from gatar_edge.export.quantize import Comparison


@click.command("quantize")
@click.argument("model", type=click.Path(path_type=Path, dir_okay=False))
@click.option("-o", "--out", type=click.Path(path_type=Path, dir_okay=False), help="Keep the quantized model.")
@click.option("--scenes", type=click.IntRange(1, 10_000), default=30, show_default=True, help="For each team size.")
@click.option("--json", "as_json", is_flag=True, help="Print for machines.")
def command(model: Path, out: Path | None, scenes: int, as_json: bool) -> None:
    """Try 8-bit integers: latency, size and decisions of a model and its quantized twin, and what to do.

    An experiment: static quantization is calibrated on scenes and judged on others.

    \b
    Example:
      gatar quantize models/gatar-greedy.onnx
    """
    need("gatar quantize", "onnx", extra="export")
    from gatar_edge.export.quantize import compare, quantize

    with TemporaryDirectory() as folder:
        target = out or Path(folder) / f"{model.stem}-int8.onnx"
        quantize(model, target, scenes)
        found = compare(model, target, scenes)
    if as_json:
        click.echo(json.dumps(found.as_json()))
        return
    _print(found)


def _print(found: Comparison) -> None:
    click.echo(f"{found.model:28}{'float':>12}{'int8':>12}")
    click.echo(f"{'KiB':28}{found.float_kib:12.0f}{found.int8_kib:12.0f}")
    for robots, least in found.float_us.items():
        click.echo(f"{f'us of CPU, {robots} robots':28}{least:12.0f}{found.int8_us[robots]:12.0f}")
    click.echo(
        f"decides alike for {100 * found.agreement:.1f} % of the robots and {100 * found.ego_agreement:.1f} % of the "
        f"deciding ones in {found.states} states; a probability differs by up to {found.largest_difference:.2f}"
    )
    click.echo("recommended: " + ("the int8 model" if found.recommended else "stay with the float model"))
