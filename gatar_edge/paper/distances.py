"""How far from the expert's target each network and rule sends a robot: Tables 2 and 3, and the curves."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gatar_edge.allocators.base import Allocator
from gatar_edge.allocators.gatar import Gatar
from gatar_edge.allocators.greedy import Greedy
from gatar_edge.allocators.nearest import Nearest
from gatar_edge.allocators.random import Random
from gatar_edge.learn.evaluate import Conditions, Distances, Score, evaluate
from gatar_edge.learn.network_rule import network_rule
from gatar_edge.learn.train import load_model
from gatar_edge.paper.plan import LABELS, PAPER_TABLE_2, TABLE_2, TABLE_3, Scale
from gatar_edge.paper.table import Table, Value
from gatar_edge.policy import GREEDY_MODEL

SEED = 7  # of the first world; the same in `gatar eval`
CURVES = ("gatar", "gatar-paper", "greedy", "nearest", "random")
Progress = Callable[[float, str], None]
Runs = Mapping[str, Path]


@dataclass(frozen=True, slots=True)
class Judged:
    """Tables 2 and 3, and distance against range and team."""

    table_2: Table
    table_3: Table
    ranges: Table
    teams: Table


def judge(runs: Runs, scale: Scale, progress: Progress) -> Judged:
    """Judge finished runs by name, and the rules, on worlds that no run has seen."""
    chosen = {name: folder for name, folder in runs.items() if name in CURVES}
    near = [Conditions("6A6G", scale.curve_samples, SEED, r_comm=r_comm) for r_comm in scale.ranges]
    teams = [Conditions(team, scale.curve_samples, SEED) for team in scale.teams]
    work = [(runs, Conditions("6A6G", scale.samples, SEED)), *((chosen, one) for one in (*near, *teams))]
    scores = []
    for number, (judged, conditions) in enumerate(work):
        scores.append(_scores(judged, conditions, number / len(work), progress))
    return Judged(
        _table_2(scores[0], runs),
        _table_3(scores[0]),
        _curve("range", "r_comm", list(scale.ranges), scores[1 : 1 + len(near)]),
        _curve("team", "robots", [_size(team) for team in scale.teams], scores[1 + len(near) :]),
    )


def _scores(runs: Runs, conditions: Conditions, done: float, progress: Progress) -> dict[str, Score]:
    rules: dict[str, Allocator] = {
        "gatar-greedy": Gatar(GREEDY_MODEL), "greedy": Greedy(), "nearest": Nearest(), "random": Random(),
    }  # fmt: skip
    networks = {name: network_rule(load_model(folder)[0]) for name, folder in runs.items()}
    what = f"{conditions.team}, r_comm {conditions.r_comm:g}"
    return evaluate(rules, conditions, lambda share, text: progress(done, f"{what}: {text}"), networks)


def _table_2(scores: Mapping[str, Score], runs: Runs) -> Table:
    columns = (
        "name", "method", "parameters", "views trained on", "x-y p90", "x-y median", "x-y mean",
        "target p90", "target median", "target mean", "target exact", "knowable mean", "knowable exact",
        "paper p90", "paper median", "paper mean",
    )  # fmt: skip
    rows: list[tuple[Value, ...]] = []
    for name in (*TABLE_2, "gatar-greedy", "greedy", "nearest", "random"):
        about = description(runs[name]) if name in runs else {}
        views = about["steps"] * about["train"]["batch"] if about else None
        place = scores[f"{name}_xy"].every if f"{name}_xy" in scores else None
        target, known = scores[name].every, scores[name].knowable
        rows.append((
            name, LABELS[name], about.get("parameters"), views,
            *(_three(place) if place else (None,) * 3), *_three(target), target.exact,
            known.mean, known.exact, *PAPER_TABLE_2.get(name, (None,) * 3),
        ))  # fmt: skip
    return Table("table2", columns, tuple(rows))


def _table_3(scores: Mapping[str, Score]) -> Table:
    columns = (
        "Gaussian", "product", "reward", "V-cycle", "run", "x-y median", "x-y mean", "target mean", "target exact",
        "paper median", "paper mean",
    )  # fmt: skip
    rows: list[tuple[Value, ...]] = []
    for row in TABLE_3:
        marks = ("yes" if part else "-" for part in (row.gaussian, row.product, row.reward, row.vcycle))
        place, target = scores[f"{row.run}_xy"].every, scores[row.run].every
        rows.append((*marks, row.run, place.median, place.mean, target.mean, target.exact, *row.paper))
    return Table("table3", columns, tuple(rows))


def _curve(name: str, axis: str, values: Sequence[float], points: Sequence[Mapping[str, Score]]) -> Table:
    columns = (axis, "rule", "p90", "median", "mean", "exact", "samples")
    rows: list[tuple[Value, ...]] = []
    for value, scores in zip(values, points, strict=True):
        for rule in (*CURVES, "gatar-greedy"):
            key = f"{rule}_xy" if rule == "gatar-paper" else rule  # its own metric in the paper
            one = scores[key].every
            rows.append((value, rule, *_three(one), one.exact, one.samples))
    return Table(name, columns, tuple(rows))


def description(folder: Path) -> dict[str, Any]:
    """What a finished run says of itself."""
    about: dict[str, Any] = json.loads((folder / "model.json").read_text())
    return about


def _three(distances: Distances) -> tuple[float, float, float]:
    return distances.p90, distances.median, distances.mean


def _size(team: str) -> int:
    aerial, ground = team.removesuffix("G").split("A")
    return int(aerial) + int(ground)
