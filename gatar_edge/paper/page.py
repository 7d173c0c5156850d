"""The page: every table beside the paper's numbers, and in plain words where classical rules win."""

from __future__ import annotations

from gatar_edge.paper.city import AROUND, STEPS, TARGETS, TEAM, WINDOW
from gatar_edge.paper.distances import Judged
from gatar_edge.paper.missions import Flown
from gatar_edge.paper.plan import LABELS, TABLE_2, Scale
from gatar_edge.paper.table import Table

MAPS_FROM = (
    "Any map in the `.map` format of the Moving AI Lab serves: Berlin, London and Paris at 256 x 256 are among the "
    "street maps of N. Sturtevant's *Benchmarks for Grid-Based Pathfinding* (2012), "
    "<https://movingai.com/benchmarks/street/index.html>, derived from OpenStreetMap and given under ODC-By."
)


X_Y_COLUMNS = (
    "method", "parameters", "views trained on", "x-y p90", "x-y median", "x-y mean", "paper p90", "paper median",
    "paper mean",
)  # fmt: skip
TARGET_COLUMNS = (
    "method", "target p90", "target median", "target mean", "target exact", "knowable mean", "knowable exact",
)  # fmt: skip
ABLATION_COLUMNS = (
    "Gaussian", "product", "reward", "V-cycle", "x-y median", "x-y mean", "target mean", "target exact",
    "paper median", "paper mean",
)  # fmt: skip
MISSION_COLUMNS = (
    "team", "allocator", "steps", "steps lo", "steps hi", "steps to 90 %", "mean time", "against greedy", "ratio lo",
    "ratio hi",
)  # fmt: skip


def page(judged: Judged, flown: Flown, covered: Table | None, scale: Scale, command: str) -> str:
    """Markdown; pictures lie beside it."""
    budget = f"{scale.minutes:g} minutes on one thread" if scale.minutes else f"{scale.steps} steps"
    parts = [
        "# The paper's tables, on our own worlds",
        f"Made by\n\n    {command}\n\nThe paper's numbers are from the authors' data, ours from worlds that no network "
        "was trained on, made as the paper says; labels are the central greedy expert's. So the rows compare with each "
        "other, and with the paper's only roughly.",
        *_table_2(judged.table_2, budget, scale),
        *_table_3(judged.table_3),
        *_curves(judged, scale),
        *_missions(flown, scale),
        *_weather(flown, scale),
        *_city(covered, scale),
    ]
    return "\n\n".join(parts) + "\n"


def _table_2(table: Table, budget: str, scale: Scale) -> list[str]:
    return [
        "## Table 2: all networks at equal budget",
        f"6A6G, r_comm 6, {scale.samples:,} labelled robots; every network was trained for {budget} on the same data, "
        f"{scale.batch} views a step. Cells between the answer and the expert's target. `x-y` is what the paper "
        "measures: the place that the network names (for our network, its score-weighted mean). `target` is where the "
        "robot is sent once one assignment over its graph has been decoded: the metric that counts in flight. "
        "`knowable` leaves out the labels that no robot near enough could tell of.",
        table.markdown(*X_Y_COLUMNS),
        table.markdown(*TARGET_COLUMNS),
        _verdict_2(table),
    ]


def _verdict_2(table: Table) -> str:
    mean = dict(zip(table.column("name"), table.column("target mean"), strict=True))
    x_y = dict(zip(table.column("name"), table.column("x-y mean"), strict=True))
    greedy = _number(mean["greedy"])
    better = [LABELS[str(name)] for name, value in mean.items() if _number(value) < greedy]
    order = sorted(TABLE_2[1:], key=lambda name: _number(x_y[name]))
    first = (
        f"Better than greedy on the same shared view: {', '.join(better)}."
        if better
        else "**Plain greedy on the shared view is better at being greedy than every network here.** It needs no "
        "training, and whoever wants the expert's targets should run the rule."
    )
    return (
        f"{first} Among the networks of the paper's comparison, from the best mean x-y to the worst: "
        f"{', '.join(f'{LABELS[name]} ({_number(x_y[name]):.2f})' for name in order)}. The nearest known target, "
        f"without any communication, is {_number(mean['nearest']):.2f} cells off in the mean."
    )


def _table_3(table: Table) -> list[str]:
    return [
        "## Table 3: ablation of the paper's shape",
        "The same runs and worlds. Without the Gaussian, the bare target cells are in its place: with no targets at "
        "all there would be nothing to learn. The row without the V-cycle is the network `gat`.",
        table.markdown(*ABLATION_COLUMNS),
        _verdict_3(table),
    ]


def _verdict_3(table: Table) -> str:
    mean = dict(zip(table.column("run"), table.column("x-y mean"), strict=True))
    whole = _number(mean["gatar-paper"])
    parts = {
        "without-maps": "the three maps together", "without-reward": "the reward map",
        "without-product": "the product map", "gat": "the V-cycle",
    }  # fmt: skip
    told = [f"{part} {_number(mean[run]) - whole:+.2f}" for run, part in parts.items()]
    return (
        f"Cells of mean x-y that are lost without a part: {', '.join(told)}. There is one run of each, so small "
        "differences, of either sign, mean nothing."
    )


def _curves(judged: Judged, scale: Scale) -> list[str]:
    return [
        "## Distance against communication range and team size",
        f"{scale.curve_samples:,} labelled robots a point, networks as in Table 2: one model for all ranges and teams. "
        "GATAR in the paper's shape is measured by its x-y, as in the paper; all others by the target.",
        "![Distance against range](range.svg)",
        _verdict_curve(judged.ranges, "r_comm", "range"),
        "![Distance against team size](team.svg)",
        _verdict_curve(judged.teams, "robots", "team size"),
        "The paper reports up to 43.2 % less p90 distance than nearest, and medians below 1 cell for all ranges.",
    ]


def _verdict_curve(table: Table, axis: str, what: str) -> str:
    values = list(dict.fromkeys(table.column(axis)))
    mean = {(row[0], row[1]): _number(row[table.columns.index("mean")]) for row in table.rows}
    behind = [value for value in values if mean[value, "greedy"] < mean[value, "gatar-greedy"]]
    if not behind:
        return f"At no {what} is greedy on the shared view nearer to the expert, in the mean, than gatar-greedy."
    return (
        f"Greedy on the shared view is nearer to the expert, in the mean, than gatar-greedy at {axis} "
        f"{', '.join(f'{value:g}' for value in map(_number, behind))} ({len(behind)} of {len(values)} points)."
    )


def _missions(flown: Flown, scale: Scale) -> list[str]:
    return [
        "## Missions",
        f"{scale.missions} missions a team and allocator on the same worlds, ideal vehicles, tasks kept until they "
        "end; 95 % intervals by bootstrap over missions, ratios paired by mission. `central-` rules hear every robot "
        "at any distance: bounds, not rivals.",
        "![Steps against greedy](missions.svg)",
        flown.comparison.markdown(*MISSION_COLUMNS),
        *(_verdict_missions(flown.comparison, team) for team in scale.mission_teams),
    ]


def _verdict_missions(table: Table, team: str) -> str:
    rows = {str(row[1]): row for row in table.rows if row[0] == team}
    steps = {name: _number(row[table.columns.index("steps")]) for name, row in rows.items()}
    ours = min((name for name in steps if name in {"gatar-greedy", "gatar-field"}), key=lambda name: steps[name])
    rivals = [name for name in steps if not name.startswith(("gatar", "central"))]
    wins = sorted((name for name in rivals if steps[name] < steps[ours]), key=lambda name: steps[name])
    if not wins:
        return f"{team}: no classical rule on the shared view needs fewer steps than {ours} ({steps[ours]:.2f})."
    told = ", ".join(f"{name} ({steps[name]:.2f})" for name in wins)
    return f"{team}: {told} need{'s' if len(wins) == 1 else ''} fewer steps than {ours} ({steps[ours]:.2f})."


def _weather(flown: Flown, scale: Scale) -> list[str]:
    return [
        "## Lost messages, late messages, killed robots",
        f"{scale.curve_missions} missions of {scale.curve_team} a point. Killed robots fall silent and stand still "
        "in the first steps, the same ones for every allocator.",
        "![Loss](loss.svg) ![Delay](delay.svg) ![Kills](kills.svg)",
        *(_verdict_weather(table) for table in (flown.loss, flown.delay, flown.kills)),
    ]


def _verdict_weather(table: Table) -> str:
    axis, steps = table.columns[0], table.columns.index("steps")
    worst = _number(table.rows[-1][0])
    told = []
    for name in dict.fromkeys(table.column("allocator")):
        own = [_number(row[steps]) for row in table.rows if row[1] == name]
        told.append(f"{name} {own[-1] / max(own[0], 1e-9):.2f}")
    return f"Steps at {axis} {worst:g} against none: {', '.join(told)}."


def _city(covered: Table | None, scale: Scale) -> list[str]:
    title = "## City maps"
    if covered is None:
        return [title, f"Left out: no maps were given (`--maps DIR`). {MAPS_FROM}"]
    return [
        title,
        f"{TEAM} with {TARGETS} targets in {WINDOW} x {WINDOW} windows, cut after {STEPS} steps; "
        f"{scale.city_missions} windows a map. Shares of the reachable targets; obstacles as the share of blocked "
        f"cells in the {2 * AROUND + 1} x {2 * AROUND + 1} square round a localized target. No network was trained on "
        f"city maps, and none is part of this repository. {MAPS_FROM}",
        covered.markdown(),
        "![Coverage](city.png)",
        "In the paper, UAVs cover the dense areas and UGVs the open ones; the last columns say whether that is so.",
    ]


def _number(value: object) -> float:
    assert isinstance(value, int | float)
    return float(value)
