"""The pictures: SVG for curves and bars, PNG for the map. Colours of Okabe and Ito, and a sign for each line."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gatar_edge.paper.city import STEPS, Coverage
from gatar_edge.paper.plan import LABELS
from gatar_edge.paper.table import Table
from gatar_edge.types import RobotKind

# the same rule has the same colour and sign in every picture
STYLES = {
    "gatar": ("#0072B2", "o"),
    "gatar-greedy": ("#56B4E9", "s"),
    "gatar-field": ("#0072B2", "o"),
    "gatar-paper": ("#D55E00", "^"),
    "greedy": ("#009E73", "D"),
    "hungarian": ("#CC79A7", "v"),
    "routing": ("#E69F00", "P"),
    "routing+memory": ("#F0E442", "h"),
    "nearest": ("#000000", "x"),
    "random": ("#999999", "+"),
}
KIND_STYLES = {RobotKind.UAV: ("#0072B2", "^", "UAV"), RobotKind.UGV: ("#D55E00", "s", "UGV")}
SIZE_IN = (4.2, 3.4)  # of a panel
LEGEND_IN = 2.2


def curves(
    table: Table, columns: Sequence[tuple[str, str]], x_label: str, path: Path, without: Sequence[str] = ()
) -> None:
    """One panel for each (column, label of its axis), one line for each rule of the table's second column.

    Networks are drawn through, rules dashed. Where the table has `steps lo` and `steps hi`, these are round `steps`.
    """
    figure = Figure(figsize=(SIZE_IN[0] * len(columns) + LEGEND_IN, SIZE_IN[1]), layout="constrained")
    panels = figure.subplots(1, len(columns), squeeze=False)[0]
    x, names = np.array(table.column(table.columns[0]), dtype=float), table.column(table.columns[1])
    shown = [name for name in dict.fromkeys(map(str, names)) if name not in without]
    for panel, (column, label) in zip(panels, columns, strict=True):
        y = np.array(table.column(column), dtype=float)
        for name in shown:
            chosen = np.array([one == name for one in names])
            colour, sign = STYLES[name]
            line = "-" if name.startswith("gatar") else "--"
            panel.plot(x[chosen], y[chosen], color=colour, marker=sign, linestyle=line, label=LABELS.get(name, name))
            if f"{column} lo" in table.columns:
                low, high = (np.array(table.column(f"{column} {end}"), dtype=float)[chosen] for end in ("lo", "hi"))
                panel.fill_between(x[chosen], low, high, color=colour, alpha=0.12, linewidth=0)
        _finish(panel, x_label, label)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside right upper", fontsize="small", frameon=False)
    _save(figure, path)


def ratios(table: Table, path: Path) -> None:
    """Steps against greedy of every allocator, one panel a team, with their intervals; left of the line is faster."""
    teams = list(dict.fromkeys(table.column("team")))
    figure = Figure(figsize=(3.2 * len(teams) + 1.6, 4.0), layout="constrained")
    panels = figure.subplots(1, len(teams), squeeze=False, sharey=True)[0]
    for panel, team in zip(panels, teams, strict=True):
        rows = [row for row in table.rows if row[0] == team]
        middle, low, high = (
            np.array([row[table.columns.index(name)] for row in rows], dtype=float)
            for name in ("against greedy", "ratio lo", "ratio hi")
        )
        y = np.arange(len(rows))[::-1]
        colours = [STYLES.get(str(row[1]), ("#444444", "o"))[0] for row in rows]
        panel.hlines(y, low, high, color=colours)
        panel.scatter(middle, y, c=colours, zorder=3)
        panel.axvline(1.0, color="#888888", linewidth=0.8)
        panel.set_yticks(y, [LABELS.get(str(row[1]), str(row[1])) for row in rows])
        panel.set_title(str(team), fontsize="medium")
        _finish(panel, "steps to 100 %, ratio to greedy", "")
    _save(figure, path)


def city(coverage: Coverage, title: str, path: Path) -> None:
    """The map, the ways of all robots, and who localized which target."""
    figure = Figure(figsize=(6.4, 7.2), layout="constrained")
    panel = figure.subplots()
    panel.imshow(coverage.world.obstacles.T, origin="lower", cmap="Greys", vmax=2.5, interpolation="nearest")
    for robot_id, track in coverage.tracks.items():
        colour, sign, _ = KIND_STYLES[coverage.kind(robot_id)]
        x, y = np.array(track, dtype=float).T
        panel.plot(x, y, color=colour, linewidth=1.0, alpha=0.8)
        panel.scatter(x[:1], y[:1], color=colour, marker=sign, s=36, edgecolors="white", zorder=4)
    for kind, (colour, sign, name) in KIND_STYLES.items():
        x, y = np.array(coverage.found(kind), dtype=float).reshape(-1, 2).T
        panel.scatter(x, y, facecolors="none", edgecolors=colour, marker="o", s=70, linewidths=1.8, zorder=5)
        panel.scatter([], [], color=colour, marker=sign, label=f"{name}: start and way, rings round its targets")
    left = [cell for cell in map(tuple, coverage.world.targets.tolist()) if cell not in coverage.found_by]
    x, y = np.array(left, dtype=float).reshape(-1, 2).T
    panel.scatter(x, y, color="#000000", marker="x", s=28, label="targets not yet localized")
    panel.set_title(title, fontsize="medium")
    figure.legend(loc="outside lower center", fontsize="small", frameon=False)
    panel.set_xlabel("x, cells east")
    panel.set_ylabel("y, cells north")
    _save(figure, path)


def city_title(map_name: str) -> str:
    """Above the picture of `city`."""
    return f"{map_name}: after {STEPS} steps"


def _finish(panel: Axes, x_label: str, y_label: str) -> None:
    panel.set_xlabel(x_label)
    panel.set_ylabel(y_label)
    panel.grid(alpha=0.25)
    panel.spines[["top", "right"]].set_visible(False)


def _save(figure: Figure, path: Path) -> None:
    """The same figures give the same file: no date, no random ids."""
    with mpl.rc_context({"svg.hashsalt": path.stem, "svg.fonttype": "none"}):
        figure.savefig(path, dpi=110, metadata={"Date": None} if path.suffix == ".svg" else {"Software": None})
