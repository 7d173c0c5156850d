"""Compact training data: `.npy` shards of team-steps and a JSON manifest with a SHA-256 of each.

One shard holds `STEPS` team-steps of one team and one size of world:

    beliefs.npy  uint8 [S, N, ceil(3 W H / 8)]   what each robot knows, three bits a cell
    robots.npy   uint8 [S, N, 8]                 x, y, label x, label y (255: none), flags (1: label is knowable),
                                                 task x, task y (255: none), speed in sixteenths of a cell a step
    known.npy    uint8 [S, N, N, 3]              where each robot reckons with each: x, y, age in steps (255: nowhere)
    votes.npy    uint8 [S, N, 2, 3]              the teacher's first choices: x, y (255: none), share of 255
    plans.npy    uint8 [S, N, N]                 each robot's plan for each: candidate (255: none, 254: not known)
    steps.npy    structured [S]                  seed of the world, step, r_comm, driver

A shard depends on the options and its number alone, so any number of workers makes the same ones, and a run that was
killed goes on with the first shard that is missing or not whole.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from gatar_edge.errors import ConfigError
from gatar_edge.sim_sitl.world import TRAINING_SEEDS, Team, random_world
from gatar_edge.workers import end_with_parent

FORMAT_VERSION = 3
STEPS = 1024  # team-steps in a shard
MANIFEST = "manifest.json"
FILES = ("beliefs.npy", "robots.npy", "known.npy", "votes.npy", "plans.npy", "steps.npy")
STEP_DTYPE = np.dtype([("world", "<u8"), ("step", "<u2"), ("r_comm", "<f4"), ("driver", "u1")])
WORLDS_PER_SHARD = 4096  # seeds set aside for one shard
SHARDS_PER_SEED = 1_000_000
LONGEST_EPISODE = 120  # steps; an exploration that finds nothing more is cut here
DRIVERS = (0, 0, 0, 1, 1, 2)  # drawn per episode: expert 1/2, own view 1/3, expert with slips 1/6
TEACHERS = ("greedy", "routing", "foresight")
SPEEDS = ((1.0, 1.0),) * 4 + ((1.0, 0.5), (2.0, 1.0))  # of UAV and UGV in cells a step, drawn per episode


@dataclass(frozen=True, slots=True)
class DataOptions:
    """All that decides the content of a data set."""

    teams: tuple[str, ...]
    sizes: tuple[int, ...]
    r_comms: tuple[float, ...]
    samples: int  # labelled robots wanted, at least
    seed: int
    r_senses: tuple[float, ...] = (4.0,)
    hop_limit: int = 2
    first_world: int = TRAINING_SEEDS
    teacher: str = "greedy"
    losses: tuple[float, ...] = (0.0,)  # of messages, drawn per episode

    def checked(self) -> DataOptions:
        """Raises ConfigError where a value cannot be used."""
        for team in self.teams:
            Team.parse(team)
        for size in self.sizes:
            if not 5 <= size <= 254:
                raise ConfigError(f"size {size}: a data set takes worlds of 5 to 254 cells a side")
        if not 1 <= self.samples <= 10**9 or not 0 <= self.seed < 2**20:
            raise ConfigError(f"samples {self.samples}, seed {self.seed}: must be 1 to 1e9 and 0 to {2**20 - 1}")
        for name, ranges in (("r_comm", self.r_comms), ("r_sense", self.r_senses)):
            if not ranges or not all(0 <= r <= 1000 for r in ranges):
                raise ConfigError(f"{name} {ranges}: must be 0 to 1000 cells")
        if self.teacher not in TEACHERS:
            raise ConfigError(f"teacher {self.teacher!r} is not one of {', '.join(TEACHERS)}")
        if not self.losses or not all(0 <= loss <= 1 for loss in self.losses):
            raise ConfigError(f"loss {self.losses}: must be 0 to 1")
        return self

    def shard_kind(self, number: int) -> tuple[Team, int]:
        """Team and size of one shard: every combination in turn."""
        team = Team.parse(self.teams[number % len(self.teams)])
        return team, self.sizes[number // len(self.teams) % len(self.sizes)]

    def shard_numbers(self) -> list[int]:
        """As many shards as give the samples."""
        numbers: list[int] = []
        have = 0
        while have < self.samples:
            numbers.append(len(numbers))
            have += STEPS * len(self.shard_kind(numbers[-1])[0].kinds)
        return numbers


def make_shard(options: DataOptions, number: int) -> tuple[Any, ...]:
    """The arrays of one shard, as `FILES` names them."""
    from gatar_edge.learn import plans
    from gatar_edge.learn.episodes import episode
    from gatar_edge.learn.labels import VOTES

    team, size = options.shard_kind(number)
    count = len(team.kinds)
    beliefs = np.zeros((STEPS, count, -(-3 * size * size // 8)), dtype=np.uint8)
    robots = np.zeros((STEPS, count, 8), dtype=np.uint8)
    known = np.zeros((STEPS, count, count, 3), dtype=np.uint8)
    votes = np.zeros((STEPS, count, VOTES, 3), dtype=np.uint8)
    plan = np.zeros((STEPS, count, count), dtype=np.uint8)
    steps = np.zeros(STEPS, dtype=STEP_DTYPE)
    kinds = np.array(team.kinds, dtype=np.int64)
    rng = np.random.default_rng([options.seed, number])
    filled, index = 0, 0
    while filled < STEPS:
        seed = options.first_world + (options.seed * SHARDS_PER_SEED + number) * WORLDS_PER_SHARD + index
        world = random_world(team, None, size, size, seed)
        r_comm = float(rng.choice(np.array(options.r_comms)))
        r_sense = float(rng.choice(np.array(options.r_senses)))
        driver = int(rng.choice(DRIVERS))
        speeds = np.array(SPEEDS[int(rng.integers(len(SPEEDS)))])[kinds]
        loss = float(rng.choice(np.array(options.losses))) if len(options.losses) > 1 else options.losses[0]
        part = np.s_[filled : min(STEPS, filled + LONGEST_EPISODE)]
        done = episode(
            world.obstacles, world.targets.astype(np.int64), np.array(world.starts, dtype=np.int64), kinds, speeds,
            r_sense, r_comm, options.hop_limit, loss, plans.TEACHERS[options.teacher], driver, seed % 2**32,
            beliefs[part], robots[part], known[part], votes[part], plan[part],
        )  # fmt: skip
        here = steps[filled : filled + done]
        here["world"], here["step"], here["r_comm"], here["driver"] = seed, np.arange(done), r_comm, driver
        filled += done
        index += 1
    return beliefs, robots, known, votes, plan, steps


def write_shard(options: DataOptions, number: int, folder: Path) -> dict[str, Any]:
    """Make shard `number` under `folder` unless it is there whole; returns its entry in the manifest."""
    return stored(number, folder) or store(options, number, folder, make_shard(options, number))


def stored(number: int, folder: Path) -> dict[str, Any] | None:
    """The entry of a shard that is there whole."""
    place = folder / _name(number)
    note = place / "shard.json"
    try:
        entry: dict[str, Any] = json.loads(note.read_text())
        whole = all(_sha256(place / name) == entry["sha256"][name] for name in FILES)
    except (OSError, ValueError, KeyError):  # as a power cut may leave it
        return None
    return entry if whole else None


def store(options: DataOptions, number: int, folder: Path, arrays: tuple[Any, ...]) -> dict[str, Any]:
    """Write the arrays of a shard, whole or not at all; returns its entry."""
    place = folder / _name(number)
    work = folder / f".{place.name}-{os.getpid()}"
    work.mkdir(parents=True, exist_ok=True)
    team, size = options.shard_kind(number)
    for name, array in zip(FILES, arrays, strict=True):
        np.save(work / name, array)
    entry = {
        "name": place.name, "team": str(team), "size": size, "steps": STEPS, "samples": STEPS * len(team.kinds),
        "sha256": {name: _sha256(work / name) for name in FILES},
    }  # fmt: skip
    (work / "shard.json").write_text(json.dumps(entry))
    shutil.rmtree(place, ignore_errors=True)
    work.rename(place)
    return entry


def generate(
    options: DataOptions,
    folder: Path,
    workers: int,
    progress: Callable[[int, int], None] = lambda done, of: None,
    scheduler: str = "",
) -> dict[str, Any]:
    """Make all shards of a data set and its manifest; goes on where an earlier call was cut off.

    With `scheduler`, the address of a Dask cluster, its workers make the shards and this process writes them, so that
    they need no common file system. Raises ConfigError where `folder` holds a data set of other options, and LinkError
    where the cluster cannot be reached.
    """
    numbers = options.checked().shard_numbers()
    description = json.loads(json.dumps({"format": FORMAT_VERSION, "options": asdict(options)}))
    _claim(folder, description)
    entries: dict[int, dict[str, Any]] = {}
    total = 0
    if scheduler:
        from gatar_edge.learn.cluster import entries_from

        source = entries_from(scheduler, options, numbers, folder)
    else:
        source = _entries(options, numbers, folder, workers)
    for number, entry in source:
        entries[number] = entry
        total += entry["samples"]
        progress(total, options.samples)
    shards = [entries[number] for number in numbers]
    manifest = {**description, "samples": total, "shards": shards}
    manifest["sha256"] = hashlib.sha256(json.dumps([e["sha256"] for e in shards]).encode()).hexdigest()
    _replace(folder / MANIFEST, json.dumps(manifest, indent=1) + "\n")
    return manifest


def _entries(
    options: DataOptions, numbers: list[int], folder: Path, workers: int
) -> Iterator[tuple[int, dict[str, Any]]]:
    if workers <= 1:
        for number in numbers:
            yield number, write_shard(options, number, folder)
        return
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=end_with_parent) as pool:
        jobs = {pool.submit(write_shard, options, number, folder): number for number in numbers}
        for job in as_completed(jobs):
            yield jobs[job], job.result()


def _claim(folder: Path, description: dict[str, Any]) -> None:
    """Write down what this folder is for, or find that it is for the same."""
    folder.mkdir(parents=True, exist_ok=True)
    for leftover in folder.glob(".shard-*"):
        shutil.rmtree(leftover)
    note = folder / "options.json"
    if note.is_file() and json.loads(note.read_text()) != description:
        raise ConfigError(f"{folder} holds a data set of other options (see {note.name}): choose another folder")
    _replace(note, json.dumps(description, indent=1) + "\n")


def load_manifest(folder: Path) -> dict[str, Any]:
    """The manifest of a complete data set. Raises ConfigError."""
    try:
        manifest: dict[str, Any] = json.loads((folder / MANIFEST).read_text())
    except (OSError, ValueError) as error:
        raise ConfigError(
            f"{folder} is not a complete data set ({error}): run `gatar dataset --out {folder}`"
        ) from None
    if manifest.get("format") != FORMAT_VERSION:
        raise ConfigError(f"{folder}: data format {manifest.get('format')}, this version reads {FORMAT_VERSION}")
    return manifest


def _name(number: int) -> str:
    return f"shard-{number:05d}"


def _replace(path: Path, text: str) -> None:
    new = path.with_suffix(".new")
    new.write_text(text)
    new.replace(path)


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
