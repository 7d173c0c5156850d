"""Many missions on the bare grid, the same for every allocator: what `gatar eval missions` counts.

A flight hangs on its campaign, allocator and seed alone, so any number of workers gives the same figures, and a file of
results lets a campaign that was cut off go on.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from multiprocessing import get_context
from pathlib import Path

import msgspec
import numpy as np

from gatar_edge.allocators.registry import Make, hears_all, make
from gatar_edge.config import AgentConfig
from gatar_edge.errors import ConfigError
from gatar_edge.sim_sitl.faults import LinkFaults
from gatar_edge.sim_sitl.grid_mission import STEP_NS, GridMission, fly
from gatar_edge.sim_sitl.maps import read_map, window_world
from gatar_edge.sim_sitl.tally import Result
from gatar_edge.sim_sitl.world import Team, World, random_world
from gatar_edge.types import BoolGrid, GridSpec
from gatar_edge.workers import end_with_parent

KILLED_BY = 8  # steps: most missions of twelve robots take longer


class Campaign(msgspec.Struct, frozen=True, kw_only=True):
    """Under what conditions the missions are flown. Their seeds are `seed`, `seed` + 1, ..."""

    team: str = "6A6G"
    seed: int = 0
    missions: int = 100
    size: int = 15  # cells a side of a random world
    targets: int | None = None  # None: 20 to 30, by the seed
    map_file: str = ""  # a window of this city map in place of a random world
    window: int = 48
    r_sense: float = 4.0
    r_comm: float = 6.0
    loss: float = 0.0
    delay_ticks: int = 0
    kills: int = 0  # robots that fall silent and stand still in the first `KILLED_BY` steps
    follow: bool = False  # the allocator at every tick; else tasks are kept, as on vehicles
    max_steps: int = 500

    @property
    def seeds(self) -> range:
        """One a mission."""
        return range(self.seed, self.seed + self.missions)


class Figures(msgspec.Struct, frozen=True):
    """What one flight counts for in a comparison; a flight that did not end counts with its length."""

    steps_100: float
    steps_90: float
    steps_50: float
    mean_time: float
    localized: float  # share of the reachable targets
    retasks: int
    duplicates: int
    bytes_per_robot_step: float
    fallbacks: int


@dataclass(frozen=True, slots=True)
class Flight:
    """One mission to fly."""

    campaign: Campaign
    allocator: str
    seed: int

    @property
    def key(self) -> str:
        """Equal for flights that must have equal figures: a model counts by its bytes, not by its name."""
        same = msgspec.structs.replace(self.campaign, seed=0, missions=0)
        network, _, path = self.allocator.partition(":")
        who = _model_digest(path) if network == "gatar" else self.allocator
        text = msgspec.json.encode([same, who, self.seed])
        return hashlib.blake2b(text, digest_size=12).hexdigest()


def world_of(campaign: Campaign, seed: int) -> World:
    """The world of one seed. Raises ConfigError or WorldError where the campaign cannot be flown."""
    team = Team.parse(campaign.team)
    if not campaign.map_file:
        return random_world(team, campaign.targets, campaign.size, campaign.size, seed)
    if campaign.targets is None:
        raise ConfigError("a city map needs a number of targets: --targets 40")
    return window_world(_city(campaign.map_file), campaign.window, team, campaign.targets, seed)


def deaths_of(campaign: Campaign, seed: int) -> dict[int, int]:
    """Step of death by robot id: the same robots at the same steps for every allocator, and one more with each kill.

    Raises ConfigError where nobody would be left.
    """
    team = Team.parse(campaign.team)
    if not 0 <= campaign.kills < len(team.kinds):
        raise ConfigError(f"{campaign.kills} robots killed: {team} can lose 0 to {len(team.kinds) - 1}")
    rng = np.random.default_rng([seed, len(team.kinds)])
    order, steps = rng.permutation(team.ids), rng.integers(1, KILLED_BY + 1, size=len(team.ids))
    return dict(zip(order[: campaign.kills].tolist(), steps.tolist(), strict=False))


def fly_one(flight: Flight) -> Figures:
    """Fly one mission. Raises ConfigError, ModelError or WorldError."""
    campaign, world = flight.campaign, world_of(flight.campaign, flight.seed)
    central = hears_all(flight.allocator)
    config = AgentConfig(
        grid=GridSpec(width=world.shape[0], height=world.shape[1]),
        r_sense=campaign.r_sense,
        r_comm=float(sum(world.shape)) if central else campaign.r_comm,
        keep_task=not campaign.follow,
    )
    delay_ns = campaign.delay_ticks * STEP_NS
    radio = LinkFaults() if central else LinkFaults(campaign.loss, delay_min_ns=delay_ns, delay_max_ns=delay_ns)
    mission = GridMission(world, config, radio, campaign.max_steps, deaths=deaths_of(campaign, flight.seed))
    return _figures(fly(mission, factory(flight.allocator)))


def fly_all(
    flights: Sequence[Flight],
    workers: int = 1,
    results: Path | None = None,
    progress: Callable[[int], None] = lambda done: None,
) -> dict[Flight, Figures]:
    """Fly all missions over `workers` processes; `progress` is told how many are done.

    With `results`, a file of JSON lines, flights found there are not flown again and new ones are added.
    Raises what `fly_one` raises, and ConfigError where the file cannot be used.
    """
    known = load_results(results) if results is not None else {}
    figures = {flight: known[flight.key] for flight in flights if flight.key in known}
    progress(len(figures))
    left = [flight for flight in flights if flight not in figures]
    for flight, flown in _fly_each(left, workers):
        figures[flight] = flown
        if results is not None:
            with results.open("ab") as file:
                file.write(msgspec.json.encode({"key": flight.key, "figures": flown}) + b"\n")
        progress(len(figures))
    return {flight: figures[flight] for flight in flights}


class _Line(msgspec.Struct):
    key: str
    figures: Figures


_BEGINNING = b'{"key":"'  # of every line


def load_results(path: Path) -> dict[str, Figures]:
    """Figures by `Flight.key`; makes the file where there is none.

    A last line of ours that was cut off is taken away; raises ConfigError for any other, and where the file cannot be
    written.
    """
    try:
        path.open("ab").close()
        lines = path.read_bytes().split(b"\n")
        found = [msgspec.json.decode(line, type=_Line) for line in lines[:-1]]
    except (OSError, msgspec.MsgspecError) as error:
        raise ConfigError(f"{path} cannot be used as a file of results: {error}") from error
    if lines[-1]:
        if lines[-1][: len(_BEGINNING)] != _BEGINNING[: len(lines[-1])]:  # somebody else's file
            raise ConfigError(f"{path} cannot be used as a file of results: its last line is no result")
        path.write_bytes(b"".join(line + b"\n" for line in lines[:-1]))
    return {line.key: line.figures for line in found}


def _fly_each(flights: Sequence[Flight], workers: int) -> Iterator[tuple[Flight, Figures]]:
    if workers <= 1 or len(flights) < 2:
        for flight in flights:
            yield flight, fly_one(flight)
        return
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=end_with_parent) as pool:
        jobs = {pool.submit(fly_one, flight): flight for flight in flights}
        try:
            for job in as_completed(jobs):
                yield jobs[job], job.result()
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


@cache
def factory(allocator: str) -> Make:
    """How to make the allocator, with one model or planner a process; tours are compiled where numba is installed."""
    if "routing" not in allocator or find_spec("numba") is None:
        return make(allocator)
    from gatar_edge.learn.compiled import compiled_planner

    return make(allocator, compiled_planner())


@cache
def _model_digest(path: str) -> str:
    """Of a model file, "" for the default; the path itself where it cannot be read, which `make` will say."""
    from gatar_edge.policy import DEFAULT_MODEL

    try:
        return hashlib.sha256((Path(path) if path else DEFAULT_MODEL).read_bytes()).hexdigest()
    except OSError:
        return path


@cache
def _city(path: str) -> BoolGrid:
    return read_map(Path(path))


def _figures(result: Result) -> Figures:
    return Figures(
        steps_100=min(result.steps_to(100), result.steps),
        steps_90=min(result.steps_to(90), result.steps),
        steps_50=min(result.steps_to(50), result.steps),
        mean_time=result.mean_time,
        localized=result.localized / result.reachable if result.reachable else 1.0,
        retasks=result.retasks,
        duplicates=result.duplicates,
        bytes_per_robot_step=result.message_bytes / len(result.robot_kinds) / max(1, result.steps),
        fallbacks=result.fallbacks,
    )
