"""`gatar export`."""

from __future__ import annotations

from pathlib import Path

import click

from gatar_edge.commands._learn import need


@click.command("export")
@click.argument("run", type=click.Path(path_type=Path, file_okay=False))
@click.option("-o", "--out", type=click.Path(path_type=Path, dir_okay=False), required=True)
def command(run: Path, out: Path) -> None:
    """Turn a finished training run into one ONNX file, with its weights as .safetensors beside it.

    \b
    Example:
      gatar export runs/greedy -o models/gatar-greedy.onnx
      gatar verify models/gatar-greedy.onnx
    """
    need("gatar export", "torch", "safetensors", "onnx", "onnxscript", extra="export")
    from gatar_edge.export.convert import export

    fields = export(run, out)
    click.echo(
        f"{out}: {fields['parameters']:,} parameters, {out.stat().st_size / 1024:.0f} KiB, opset {fields['opset']}"
    )
