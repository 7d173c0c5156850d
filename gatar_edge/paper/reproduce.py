"""From nothing to the page: data, runs, tables, missions, pictures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from gatar_edge.export.convert import export
from gatar_edge.paper import charts
from gatar_edge.paper.city import cover_all, map_files
from gatar_edge.paper.distances import Judged, judge
from gatar_edge.paper.missions import Flown, fly
from gatar_edge.paper.page import page
from gatar_edge.paper.plan import Scale, runs, shipped_models
from gatar_edge.paper.runs import make_data, train_all
from gatar_edge.paper.table import Table

Progress = Callable[[float, str], None]
PAGE = "paper.md"
TRAINED_FROM, JUDGED_FROM, FLOWN_FROM, COVERED_FROM = 0.02, 0.5, 0.6, 0.95  # shares of the whole, for the display


@dataclass(frozen=True, slots=True)
class Places:
    """Where things are and go."""

    out: Path
    runs: Path
    data: Path | None = None  # None: made under `runs`
    maps: Path | None = None  # of *.map files; None: no city


@dataclass(frozen=True, slots=True)
class Results:
    """All tables; `city` is None without maps."""

    judged: Judged
    flown: Flown
    city: Table | None


def reproduce(
    places: Places, scale: Scale, workers: int, progress: Progress, command: str, device: str = "cpu"
) -> Results:
    """Make what is missing, and write tables, pictures and the page; `command` is told on it.

    `device` trains the networks.

    Training, data and missions go on where an earlier call was cut off. Raises ConfigError and WorldError for places
    that cannot be used, before anything long.
    """
    files = map_files(places.maps) if places.maps is not None else []
    places.out.mkdir(parents=True, exist_ok=True)
    data = places.data or make_data(places.runs / "data", scale, workers, _part(progress, 0, TRAINED_FROM))
    trained = _part(progress, TRAINED_FROM, JUDGED_FROM)
    folders = train_all(runs(), data, places.runs, scale, workers, device, trained)
    judged = judge(folders, scale, _part(progress, JUDGED_FROM, FLOWN_FROM))
    models = {**shipped_models(), "gatar-paper": f"gatar:{_exported(folders['gatar-paper'])}"}
    flown = fly(models, scale, workers, places.runs / "missions.jsonl", _part(progress, FLOWN_FROM, COVERED_FROM))
    covered = None
    if files:
        allocators = dict([*list(shipped_models().items())[-1:], ("greedy", "greedy")])
        covered, first = cover_all(files, allocators, scale.city_missions, _part(progress, COVERED_FROM, 1))
        charts.city(first, charts.city_title(files[0].stem), places.out / "city.png")
    results = Results(judged, flown, covered)
    _write(results, scale, places.out)
    (places.out / PAGE).write_text(page(judged, flown, covered, scale, command), encoding="utf-8")
    return results


def _part(progress: Progress, start: float, end: float) -> Progress:
    """The display of one part of the work."""
    return lambda share, text: progress(start + (end - start) * min(1.0, share), text)


def _exported(folder: Path) -> Path:
    out = folder / f"{folder.name}.onnx"
    weights = folder / "model.safetensors"
    if not out.is_file() or out.stat().st_mtime < weights.stat().st_mtime:
        export(folder, out)
    return out


def _write(results: Results, scale: Scale, out: Path) -> None:
    judged, flown = results.judged, results.flown
    tables = [judged.table_2, judged.table_3, judged.ranges, judged.teams]
    tables += [flown.comparison, flown.loss, flown.delay, flown.kills, *([results.city] if results.city else [])]
    for table in tables:
        table.write(out)
    distances = (("p90", "p90 distance, cells"), ("median", "median distance, cells"))
    charts.curves(judged.ranges, distances, "communication range, cells", out / "range.svg", ["random"])
    charts.curves(judged.teams, distances[:1], "robots", out / "team.svg")
    charts.ratios(flown.comparison, out / "missions.svg")
    steps = (("steps", "steps to 100 %"),)
    charts.curves(flown.loss, steps, "share of messages lost", out / "loss.svg")
    charts.curves(flown.delay, steps, "delay of every message, steps", out / "delay.svg")
    charts.curves(flown.kills, steps, f"robots killed of {scale.curve_team}", out / "kills.svg")
