"""Missions of all allocators, and curves of steps against lost messages, late messages and killed robots."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
import numpy.typing as npt

from gatar_edge.campaign import Campaign, Figures, Flight, fly_all
from gatar_edge.learn.statistics import mean_interval, ratio_interval
from gatar_edge.paper.plan import Scale
from gatar_edge.paper.table import Table, Value

SEED = 9000  # of the first mission; the same in `gatar eval missions`
RULES = ("nearest", "random", "greedy", "hungarian", "routing", "routing+memory", "cbba", "central-greedy",
         "central-hungarian", "central-routing")  # fmt: skip
CURVES = ("gatar-greedy", "gatar-field", "greedy", "hungarian", "routing")
REFERENCE = "greedy"
AVERAGED = ("steps_90", "mean_time", "localized", "retasks", "duplicates", "bytes_per_robot_step")


@dataclass(frozen=True, slots=True)
class Flown:
    """The comparison, and one table for each curve."""

    comparison: Table
    loss: Table
    delay: Table
    kills: Table


def fly(
    models: Mapping[str, str], scale: Scale, workers: int, results: Path, progress: Callable[[float, str], None]
) -> Flown:
    """Fly everything; `models` are allocators by the name that the tables give them, such as gatar:MODEL.onnx.

    Flights found in `results` are not flown again. Raises what `campaign.fly_all` raises.
    """
    named = {**models, **{rule: rule for rule in RULES}}
    curved = {name: allocator for name, allocator in named.items() if name in CURVES}
    base = Campaign(seed=SEED, size=scale.size)
    compared = [(team, _with(base, scale.missions, team=team)) for team in scale.mission_teams]
    curve = _with(base, scale.curve_missions, team=scale.curve_team)
    loss = [(value, msgspec.structs.replace(curve, loss=value)) for value in scale.losses]
    delay = [(value, msgspec.structs.replace(curve, delay_ticks=value)) for value in scale.delays]
    kills = [(value, msgspec.structs.replace(curve, kills=value)) for value in scale.kills]
    wanted = (
        Flight(campaign, allocator, seed)
        for campaigns, allocators in ((compared, named), (loss, curved), (delay, curved), (kills, curved))
        for _, campaign in campaigns
        for seed in campaign.seeds
        for allocator in allocators.values()
    )
    flights = list(dict.fromkeys(wanted))  # the curves begin with the same missions
    flown = fly_all(flights, workers, results, lambda done: progress(done / len(flights), f"{done} missions"))
    return Flown(
        _table("missions", "team", compared, named, flown),
        _table("loss", "loss", loss, curved, flown),
        _table("delay", "delay_ticks", delay, curved, flown),
        _table("kills", "kills", kills, curved, flown),
    )


def _with(campaign: Campaign, missions: int, team: str) -> Campaign:
    return msgspec.structs.replace(campaign, missions=missions, team=team)


def _table(
    name: str,
    axis: str,
    campaigns: Sequence[tuple[Value, Campaign]],
    allocators: Mapping[str, str],
    flown: Mapping[Flight, Figures],
) -> Table:
    columns = (
        axis, "allocator", "steps", "steps lo", "steps hi", "steps to 90 %", "mean time", "localized",
        "against greedy", "ratio lo", "ratio hi", "retasks", "duplicates", "bytes a robot and step", "missions",
    )  # fmt: skip
    rows: list[tuple[Value, ...]] = []
    for value, campaign in campaigns:
        for label, allocator in allocators.items():
            every = [flown[Flight(campaign, allocator, seed)] for seed in campaign.seeds]
            greedy = [flown[Flight(campaign, REFERENCE, seed)] for seed in campaign.seeds]
            steps = mean_interval(_values(every, "steps_100"))
            ratio = ratio_interval(_values(every, "steps_100"), _values(greedy, "steps_100"))
            to_90, mean_time, localized, *rest = (float(_values(every, field).mean()) for field in AVERAGED)
            rows.append((
                value, label, steps.mean, steps.lo, steps.hi, to_90, mean_time, localized,
                ratio.mean, ratio.lo, ratio.hi, *rest, len(every),
            ))  # fmt: skip
    return Table(name, columns, tuple(rows))


def _values(figures: Sequence[Figures], field: str) -> npt.NDArray[np.float64]:
    return np.array([getattr(one, field) for one in figures], dtype=np.float64)
