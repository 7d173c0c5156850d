"""Fine-tuning on outcome: a trained network flies missions, and what shortened them becomes more likely.

Proximal policy optimisation (Schulman et al. 2017) with a critic that sees everything: each round flies new missions
with choices drawn from the network's scores, then takes a few steps towards the choices of steps that were better than
expected. A run folder is that of `learn.train`, with the curves in `log.jsonl`; a run that was cut off goes on with the
round that it was in, and gives the weights of an uninterrupted one. Of several ranks under torchrun each flies its
share of every round's missions, and all learn of all of them.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from safetensors.torch import save_file
from torch import Tensor, nn

from gatar_edge.errors import ConfigError
from gatar_edge.learn.checkpoint import claim, load_checkpoint, save_checkpoint
from gatar_edge.learn.curves import Curves
from gatar_edge.learn.dataset import SPEEDS, DataOptions
from gatar_edge.learn.networks import build
from gatar_edge.learn.networks.gatar import Gatar
from gatar_edge.learn.ranks import ALONE, Ranks
from gatar_edge.learn.train import load_model, tensors_of
from gatar_edge.learn.tuning.critic import Critic
from gatar_edge.learn.tuning.missions import NEVER, Conditions
from gatar_edge.learn.tuning.rollout import Rollout, fly, log_probabilities
from gatar_edge.learn.views import batch_of
from gatar_edge.sim_sitl.world import TRAINING_SEEDS, Team

Array = npt.NDArray[Any]

FIRST_WORLD = TRAINING_SEEDS + 2**40  # beyond those of data sets with seeds below 268
WORLDS_PER_SEED = 2**32
CLIP = 0.2  # of the ratio of probabilities, either way
LEAST_RATE = 0.1  # share of the rate that is left at the end
WARM_UP = 3  # rounds
DIE_BY = 8  # steps, for robots that are to die: as in `campaign`
CHUNK = 256  # views evaluated together
SHOWN = ("tasks", "ages")  # fields of the network's config that hide an input


@dataclass(frozen=True, slots=True)
class TuneOptions:
    """All that decides a run. Either `minutes` or `rounds` ends it; only `rounds` gives the same weights again."""

    run: str  # folder of the finished run that it starts from
    teams: tuple[str, ...]  # flown in every round, so many times as they are named
    sizes: tuple[int, ...] = (15,)  # of the worlds, round by round
    r_comms: tuple[float, ...] = (6.0,)  # drawn per mission, as the next two
    r_senses: tuple[float, ...] = (4.0,)
    losses: tuple[float, ...] = (0.0,)
    kills: tuple[int, ...] = (0,)  # robots that die in the first steps; half a team lives
    minutes: float = 0.0
    rounds: int = 0
    missions: int = 112  # in each round
    epochs: int = 2  # over the choices of a round
    batch: int = 600  # choices a step
    rate: float = 5e-4
    temperature: float = 0.5  # of the draws: below 1 nearer to what the robot decides
    clip: float = 1.0  # of gradients
    seed: int = 0
    threads: int = 1  # of torch
    shown: tuple[str, ...] = ()  # of `SHOWN`: inputs that the network did not see before
    ranks: int = 1

    def checked(self) -> TuneOptions:
        """Raises ConfigError where a value cannot be used."""
        DataOptions(self.teams, self.sizes, self.r_comms, 1, 0, self.r_senses, losses=self.losses).checked()
        if (self.minutes > 0) == (self.rounds > 0):
            raise ConfigError("give either minutes or rounds, and more than 0")
        if self.missions < len(self.teams) * self.ranks:
            ranks = f" and {self.ranks} ranks" if self.ranks > 1 else ""
            raise ConfigError(f"{self.missions} missions a round are too few for {len(self.teams)} teams{ranks}")
        if not self.kills or min(self.kills) < 0:
            raise ConfigError("nobody can be killed less than 0 times")
        if not set(self.shown) <= set(SHOWN):
            raise ConfigError(f"cannot show {', '.join(self.shown)}: only {' and '.join(SHOWN)}")
        return self


@dataclass(frozen=True, slots=True)
class Progress:
    """One round: how its missions went, and how much of the run is done."""

    step: int  # round
    excess: float  # steps that its missions took, as a ratio to tours by one who knows all
    explained: float  # share of the variance that the critic foresaw
    choices: int  # that taught something
    change: float  # Kullback-Leibler divergence from the network that flew, in nats a choice
    done: float  # 0..1
    seconds: float
    rate: float


class Tuner:
    """One run: options, network, optimizer, critic, and where it stands."""

    def __init__(self, options: TuneOptions, folder: Path, ranks: Ranks = ALONE) -> None:
        self.options = options.checked()
        if options.ranks != ranks.count:
            raise ConfigError(f"a run of {options.ranks} ranks was started with {ranks.count}")
        self.folder = folder
        self.ranks = ranks
        torch.set_num_threads(options.threads)
        torch.use_deterministic_algorithms(True)
        self.network, self.description = _start(options)
        self.optimizer = torch.optim.AdamW(self.network.parameters(), lr=options.rate, weight_decay=0.0)
        self.critic = Critic()
        self.step, self.seconds = 0, 0.0
        described = {name: value for name, value in asdict(options).items() if name != "run"}
        wanted = {"options": described, "weights_sha256": _digest(Path(options.run))}
        claim(folder, wanted, writes=ranks.rank == 0)
        saved = load_checkpoint(folder, self.network, self.optimizer, "cpu")
        if saved is not None:
            self.step, self.seconds = int(saved[0]["step"]), float(saved[0]["seconds"])
            self.critic = Critic({kind: sums.numpy() for kind, sums in saved[1].items()})

    @property
    def done(self) -> float:
        """How much of the run is behind: 0..1."""
        options = self.options
        return self.step / options.rounds if options.rounds else self.seconds / (options.minutes * 60)

    def run(self, report: Callable[[Progress], None]) -> Path:
        """Tune to the end; returns the path of the finished weights."""
        with Curves(self.folder, self.step, self.ranks.rank == 0, every=1, means=()) as curves:
            while self.done < 1:
                started = time.monotonic()
                progress = self._round(started)
                self._save()
                curves.add(asdict(progress))
                report(progress)
        return self._finish()

    def _round(self, started: float) -> Progress:
        options, ranks = self.options, self.ranks
        conditions = list(self._conditions(np.random.default_rng([options.seed, self.step])))
        rng = np.random.default_rng([options.seed, self.step, ranks.rank])
        self.network.eval()
        flown = [
            fly(self.network, self.critic, part, options.temperature, int(rng.integers(2**32)), ranks)
            for part in (whole.part(ranks.rank, ranks.count) for whole in conditions)
        ]
        rate = options.rate * min(1.0, (self.step + 1) / WARM_UP)
        rate *= LEAST_RATE + (1 - LEAST_RATE) * (1 - min(1.0, self.done))
        change = self._learn(flown, rate, rng)
        self.step += 1
        self.seconds = ranks.of_first(self.seconds + time.monotonic() - started)
        counts = [(r.steps.sum(), r.least.sum(), r.explained, r.choices.open.sum()) for r in flown]
        steps, least, explained, choices = ranks.sum(np.array(counts, dtype=np.float64)).sum(axis=0)
        return Progress(
            step=self.step,
            excess=float(steps / least),
            explained=float(explained / (len(flown) * ranks.count)),
            choices=int(choices),
            change=change,
            done=min(1.0, self.done),
            seconds=self.seconds,
            rate=rate,
        )

    def _conditions(self, rng: np.random.Generator) -> Iterator[Conditions]:
        """Of this round's missions, one batch a team: the same for the same round, whatever came before."""
        options = self.options
        size = options.sizes[self.step % len(options.sizes)]
        worlds = FIRST_WORLD + options.seed * WORLDS_PER_SEED + self.step * options.missions
        for index, name in enumerate(dict.fromkeys(options.teams)):
            count = options.missions * options.teams.count(name) // len(options.teams)
            first = worlds + index * options.missions // len(options.teams)
            team = Team.parse(name)
            yield Conditions(
                team=team,
                size=size,
                seeds=range(first, first + count),
                r_comm=rng.choice(np.array(options.r_comms), count),
                r_sense=rng.choice(np.array(options.r_senses), count),
                loss=rng.choice(np.array(options.losses), count),
                speeds=np.array(SPEEDS)[rng.integers(len(SPEEDS), size=count)],
                deaths=_deaths(len(team.kinds), rng.choice(np.array(options.kills), count), rng),
            )

    def _learn(self, flown: list[Rollout], rate: float, rng: np.random.Generator) -> float:
        """Some steps of the optimizer; returns how far the network went from the one that flew."""
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        self.network.train()
        total = self.ranks.sum(np.array([sum(float(rollout.choices.open.sum()) for rollout in flown)]))
        batches = max(1, int(total[0]) // self.options.batch)
        changes: list[float] = []
        for _ in range(self.options.epochs):
            shares = [np.array_split(rng.permutation(np.flatnonzero(r.choices.open)), batches) for r in flown]
            for part in zip(*shares, strict=True):
                self.optimizer.zero_grad(set_to_none=True)
                for rollout, indices in zip(flown, part, strict=True):
                    for first in range(0, len(indices), CHUNK):
                        loss, change = self._loss(rollout, np.sort(indices[first : first + CHUNK]))
                        (loss / self.options.batch).backward()  # type: ignore[no-untyped-call]
                        changes += change
                self.ranks.add_gradients(self.network)
                nn.utils.clip_grad_norm_(self.network.parameters(), self.options.clip)
                self.optimizer.step()
        changed, count = self.ranks.sum(np.array([sum(changes), len(changes)], dtype=np.float64))
        return float(changed / max(1.0, count))

    def _loss(self, rollout: Rollout, indices: Array) -> tuple[Tensor, list[float]]:
        """The clipped objective's negative, added up over some choices, and by how much each became less likely."""
        batch = batch_of(rollout.group, indices, with_windows=False)
        choices = rollout.choices
        scores = self.network(**tensors_of(batch, self.network.inputs)).scores
        options = choices.of(indices, batch.view.targets.shape[1])
        likely = log_probabilities(scores, options, self.options.temperature)
        now = likely.gather(1, torch.from_numpy(choices.choice[indices])[:, None])[:, 0]
        gain = now - torch.from_numpy(choices.likelihood[indices])
        ratio, worth = gain.exp(), torch.from_numpy(rollout.worth[indices])
        clipped = ratio.clamp(1 - CLIP, 1 / (1 - CLIP))
        return -torch.minimum(ratio * worth, clipped * worth).sum(), (-gain.detach()).tolist()

    def _save(self) -> None:
        self.ranks.check_alike(self.network)
        if self.ranks.rank > 0:
            return
        note = {"step": self.step, "seconds": self.seconds}
        sums = {kind: torch.from_numpy(value) for kind, value in self.critic.sums.items()}
        save_checkpoint(self.folder, self.network, self.optimizer, note, sums)

    def _finish(self) -> Path:
        path = self.folder / "model.safetensors"
        if self.ranks.rank > 0:
            return path
        save_file(self.network.state_dict(), path)
        tuned = {**asdict(self.options), "rounds": self.step}
        tuned.pop("run")  # a path of the machine that tuned
        description = {**self.description, "train": {**self.description["train"], "tuned": tuned}}
        (self.folder / "model.json").write_text(json.dumps(description, indent=1) + "\n")
        return path


def _start(options: TuneOptions) -> tuple[Gatar, dict[str, Any]]:
    """The network to begin with, and its description. Raises ConfigError where it cannot be tuned."""
    network, description = load_model(Path(options.run))
    if not isinstance(network, Gatar) or not network.config.ahead or network.config.maps:
        raise ConfigError(f"{options.run}: only a network `gatar` with ahead=true and maps=false can be tuned")
    settings = {**description["settings"], **dict.fromkeys(options.shown, True)}
    seeing = build("gatar", settings)
    assert isinstance(seeing, Gatar)
    seeing.shows_more_than(network)
    return seeing, {**description, "settings": settings}


def _deaths(robots: int, kills: Array, rng: np.random.Generator) -> Array:
    """When the robots of each mission die, of whom `kills` [B] do, but half a team at most: int64 [B, N]."""
    deaths = rng.integers(1, DIE_BY + 1, size=(len(kills), robots))
    turns = rng.permuted(np.tile(np.arange(robots), (len(kills), 1)), axis=1)
    deaths[turns >= np.minimum(kills, robots // 2)[:, None]] = NEVER
    return deaths


def _digest(run: Path) -> str:
    with (run / "model.safetensors").open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
