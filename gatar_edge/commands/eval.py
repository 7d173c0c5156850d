"""`gatar eval`: the paper's Table 2 for one model; its subcommands compare missions."""

from __future__ import annotations

import importlib
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from gatar_edge.commands._learn import bar, need
from gatar_edge.commands._options import FiniteRange

if TYPE_CHECKING:
    from gatar_edge.allocators.base import Allocator
    from gatar_edge.learn.evaluate import Score

PARTS = {
    "missions": "fly many missions with every allocator",
    "paper": "train the paper's networks and make its tables and figures",
}
PAPER = {"mean": 1.6308, "median": 0.8156, "p90": 4.3928}  # Table 2, GATAR, 6A6G, on the authors' data
LABELS = {
    "gatar": "gatar (chosen target)", "gatar_xy": "gatar (x-y output)", "greedy_shared": "greedy on the shared view",
    "nearest": "nearest, no communication", "random": "random known target",
}  # fmt: skip


class LazyParts(click.Group):
    """Lists the subcommands without importing any of them."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(PARTS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in PARTS:
            return None
        command: click.Command = importlib.import_module(f"gatar_edge.commands.eval_{cmd_name}").command
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl(list(PARTS.items()))


@click.group("eval", cls=LazyParts, invoke_without_command=True)
@click.option("--model", type=click.Path(path_type=Path, dir_okay=False), help="ONNX file.  [default: gatar-greedy]")
@click.option("--team", default="6A6G", show_default=True)
@click.option("--size", type=click.IntRange(5, 254), default=15, show_default=True, help="Cells a side of a world.")
@click.option("--r-sense", type=FiniteRange(0, 100), default=4.0, show_default=True, help="Cells.")
@click.option("--r-comm", type=FiniteRange(0, 1000), default=6.0, show_default=True, help="Cells.")
@click.option("--samples", type=click.IntRange(1, 10_000_000), default=3000, show_default=True, help="Labelled robots.")
@click.option("--seed", type=click.IntRange(0, 999_999), default=0, show_default=True, help="Of the first test world.")
@click.option("--json", "as_json", is_flag=True)
@click.pass_context
def command(ctx: click.Context, /, model: Path | None, as_json: bool, **conditions: Any) -> None:
    """How far from the central expert's target is what each rule gives a robot on its own view.

    Worlds come from the test seeds (0 to 999999), which neither training (2000000 and up) nor the choice of settings
    (1000000 and up) has seen.

    \b
    Examples:
      gatar eval --team 6A6G --r-comm 6 --samples 3000 --seed 7
      gatar eval missions --team 3A3G --missions 100
    """
    if ctx.invoked_subcommand is not None:
        return
    need("gatar eval", "numba")
    from gatar_edge.allocators.gatar import Gatar
    from gatar_edge.allocators.greedy import Greedy
    from gatar_edge.allocators.nearest import Nearest
    from gatar_edge.allocators.random import Random
    from gatar_edge.learn.evaluate import Conditions, evaluate
    from gatar_edge.policy import GREEDY_MODEL

    chosen = Conditions(**conditions)
    network = Gatar(model or GREEDY_MODEL)
    rules: dict[str, Allocator] = {
        "gatar": network,
        "nearest": Nearest(),
        "random": Random(),
        "greedy_shared": Greedy(),
    }
    with bar("eval", "") as show:
        scores = evaluate(rules, chosen, show)
    if as_json:
        about = {**conditions, "model": network.policy.manifest.name}
        click.echo(json.dumps({**_as_json(scores), "conditions": about}, indent=1))
    else:
        click.echo(table(scores, f"{chosen.team}, r_comm {chosen.r_comm:g}, test worlds {chosen.seed}.."))


def _as_json(scores: dict[str, Score]) -> dict[str, Any]:
    return {name: {**score.every.to_json(), "knowable": score.knowable.to_json()} for name, score in scores.items()}


def table(scores: dict[str, Score], title: str) -> str:
    """For people: distances in cells, and which rule is the best."""
    lines = [
        f"{title}: cells between a rule's target and the central expert's",
        f"{'':<28}{'mean':>8}{'median':>8}{'p90':>8}{'exact':>8}   on labels the robot can know of: mean, exact",
    ]
    for name, score in scores.items():
        one, known = score.every, score.knowable
        lines.append(
            f"{LABELS[name]:<28}{one.mean:>8.3f}{one.median:>8.2f}{one.p90:>8.2f}{one.exact:>8.1%}"
            f"   {known.mean:>8.3f}{known.exact:>8.1%}"
        )
    lines.append(
        f"{'(paper, its own data)':<28}{PAPER['mean']:>8.3f}{PAPER['median']:>8.2f}{PAPER['p90']:>8.2f}{'-':>8}"
    )
    every, known = scores["gatar"].every, scores["gatar"].knowable
    lines.append(f"{every.samples} labelled robots, {known.samples} of them with a label they can know of.")
    gap = every.mean - scores["greedy_shared"].every.mean
    if gap > 0:
        lines.append(
            f"Greedy on the shared view is better by {gap:.3f} cells: a network that imitates this expert does not "
            "beat the same rule run on the same view."
        )
    return "\n".join(lines)
