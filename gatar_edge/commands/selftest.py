"""`gatar selftest`."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import click


@click.command("selftest")
@click.option(
    "--models", type=click.Path(path_type=Path, file_okay=False), help="Folder of models; the shipped ones by default."
)
@click.option("--record", is_flag=True, help="Make the golden vectors anew from the models' weights; needs torch.")
@click.option("--json", "as_json", is_flag=True, help="Print for machines.")
def command(models: Path | None, record: bool, as_json: bool) -> None:
    """Prove that this installation decides as it should: exit code 1 where it does not. Needs no torch.

    Golden moments go through the real code: signed messages, path lengths, features, every shipped model, decisions.
    Run it on each robot after an installation or an update.

    \b
    Example:
      gatar selftest
      gatar selftest --record      # after a model or a feature has changed
    """
    from gatar_edge.policy import MODELS
    from gatar_edge.selftest import selftest

    folder = models or MODELS
    if record:
        _record(folder)
    checks = []
    for check in selftest(folder):
        checks.append(check)
        if not as_json:
            click.echo(f"{'OK  ' if check.ok else 'FAIL'} {check.name}: {check.detail}")
    ok = all(check.ok for check in checks)
    if as_json:
        click.echo(json.dumps({"ok": ok, "checks": [check.as_json() for check in checks]}))
    sys.exit(0 if ok else 1)


def _record(folder: Path) -> None:
    from gatar_edge.commands._learn import need

    need("gatar selftest --record", "torch", "safetensors", "onnx", extra="export")
    import torch

    from gatar_edge.export.golden import record

    torch.set_num_threads(1)
    for path in record(folder):
        click.echo(f"{path}: {path.stat().st_size / 1024:.0f} KiB", err=True)
