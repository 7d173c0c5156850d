"""Missions flown by a network that chooses by chance: what it chose, and how much each step was worth."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import nn

from gatar_edge.allocators.base import NO_TARGET
from gatar_edge.features import MAX_CANDIDATES
from gatar_edge.learn.dataset import LONGEST_EPISODE
from gatar_edge.learn.ranks import ALONE, Ranks
from gatar_edge.learn.train import tensors_of
from gatar_edge.learn.tuning.critic import Critic, advantages
from gatar_edge.learn.tuning.missions import Conditions, Missions, Moment
from gatar_edge.learn.tuning.options import Options, goals_of, options_of
from gatar_edge.learn.views import Batch, Group, batch_of

Array = npt.NDArray[Any]

CHUNK = 384  # views evaluated together
CUT = 5  # steps that a mission counts as longer that was cut off
SURE = 0.97  # probability from which on a choice teaches nothing
LARGEST_WORTH = 4.0  # of one step, in standard deviations


@dataclass(frozen=True, slots=True)
class Choices:
    """What was chosen in V views, in the order of their group: step by step, mission by mission, robot by robot."""

    choice: Array  # int64 [V], candidate or NO_TARGET
    likelihood: Array  # float32 [V], logarithm of the choice's probability
    open: Array  # bool [V], whether anything else had a chance
    allowed: Array  # bool [V, MAX_CANDIDATES]
    habit: Array  # float32 [V, MAX_CANDIDATES]
    goals: Array  # int64 [V, 2]

    def of(self, indices: Array, width: int) -> Options:
        """The options of some views, as wide as their batch."""
        return Options(self.allowed[indices, :width], self.habit[indices, :width])


@dataclass(frozen=True, slots=True)
class Rollout:
    """Missions of one kind, flown to their end."""

    group: Group
    choices: Choices
    worth: Array  # float32 [V], of the step in which a choice was made, in standard deviations
    steps: Array  # int64 [B], that each mission took
    least: Array  # float64 [B], those of tours by one who knows all
    explained: float  # share of the variance of the steps to come that the critic foresaw


def log_probabilities(scores: torch.Tensor, options: Options, temperature: float) -> torch.Tensor:
    """Of each candidate for ego, from the network's scores [B, N, M + 1]: [B, M]; uniform where none is allowed."""
    likely = scores[:, 0].log_softmax(dim=-1)[:, :-1] + torch.from_numpy(options.habit)
    allowed = torch.from_numpy(options.allowed)
    hidden = torch.finfo(likely.dtype).min
    return (likely / temperature).masked_fill(~allowed, hidden).log_softmax(dim=-1)


def fly(
    network: nn.Module, critic: Critic, conditions: Conditions, temperature: float, seed: int, ranks: Ranks = ALONE
) -> Rollout:
    """Fly all missions; the network, in evaluation mode, decides for each robot on its own view. `seed` below 2^32.

    Other `ranks` fly other missions of the same kind: what a step was worth is measured by all of them.
    """
    missions = Missions(conditions, seed)
    rng = np.random.default_rng(seed)
    count = len(conditions.seeds)
    groups: list[Group] = []
    chosen: list[Choices] = []
    standings, active = [], []
    while not missions.over.all() and missions.step < LONGEST_EPISODE:
        moment = missions.moment()
        choices = _decide(network, moment, temperature, rng)
        missions.act(moment.active, choices.goals.reshape(len(moment.active), missions.robots, 2))
        groups.append(moment.group)
        chosen.append(choices)
        standings.append(moment.standing)
        active.append(moment.active)
    took = np.where(missions.over, missions.steps, missions.step + CUT)
    alive = np.zeros((len(active), count), dtype=np.bool_)
    for t, now in enumerate(active):
        alive[t, now] = True
    to_come = took - np.arange(len(active))[:, None]
    estimates = np.zeros(alive.shape)
    estimates[alive] = critic.estimate(
        f"{conditions.team}-{conditions.size}", np.concatenate(standings), to_come[alive], ranks
    )
    saved = advantages(estimates, alive, ~missions.over)
    worth = np.clip(saved / max(_deviation(saved[alive], ranks), 1e-6), -LARGEST_WORTH, LARGEST_WORTH)
    variance = float(np.var(to_come[alive]))
    return Rollout(
        group=_joined(groups),
        choices=Choices(*(np.concatenate(parts) for parts in zip(*map(_fields, chosen), strict=True))),
        worth=np.repeat(worth[alive], missions.robots).astype(np.float32),
        steps=took,
        least=standings[0][:, 1],
        explained=1 - float(np.mean((estimates - to_come)[alive] ** 2)) / max(variance, 1e-6),
    )


def _deviation(values: Array, ranks: Ranks) -> float:
    """The standard deviation of all ranks' values."""
    count, total, squares = ranks.sum(np.array([len(values), values.sum(), (values**2).sum()], dtype=np.float64))
    return float(np.sqrt(max(0.0, squares / count - (total / count) ** 2)))


def _fields(choices: Choices) -> tuple[Array, ...]:
    return choices.choice, choices.likelihood, choices.open, choices.allowed, choices.habit, choices.goals


def _decide(network: nn.Module, moment: Moment, temperature: float, rng: np.random.Generator) -> Choices:
    """For every robot; the dead have nothing to choose."""
    group, alive, parts = moment.group, moment.alive.reshape(-1), []
    for first in range(0, group.views, CHUNK):
        batch = batch_of(group, np.arange(first, min(group.views, first + CHUNK)), with_windows=False)
        parts.append(_fields(_drawn(network, batch, temperature, rng)))
    choices = Choices(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))
    return replace(choices, open=choices.open & alive, goals=np.where(alive[:, None], choices.goals, -1))


def _drawn(network: nn.Module, batch: Batch, temperature: float, rng: np.random.Generator) -> Choices:
    inputs: tuple[str, ...] = network.inputs  # type: ignore[assignment]
    with torch.inference_mode():
        scores = network(**tensors_of(batch, inputs)).scores
        options = options_of(batch, scores.softmax(dim=-1).numpy())
        likelihoods = log_probabilities(scores, options, temperature).numpy()
    some = options.allowed.any(axis=1)
    views, width = likelihoods.shape
    rows = np.arange(views)
    noise = rng.gumbel(size=(views, MAX_CANDIDATES))[:, :width]  # as many draws whatever the batch's width
    drawn = np.where(options.allowed, likelihoods + noise, -np.inf).argmax(axis=1)
    choice = np.where(some, drawn, NO_TARGET)
    padding = ((0, 0), (0, MAX_CANDIDATES - width))
    return Choices(
        choice=choice,
        likelihood=likelihoods[rows, drawn],
        open=some & (likelihoods.max(axis=1) < np.log(SURE)),
        allowed=np.pad(options.allowed, padding),
        habit=np.pad(options.habit, padding),
        goals=goals_of(batch.view, choice),
    )


def _joined(groups: list[Group]) -> Group:
    """All steps in one group."""
    columns: dict[str, Any] = {
        name: np.concatenate([getattr(group, name) for group in groups])
        for name in ("beliefs", "robots", "known", "votes", "plans", "r_comm", "tasks")
    }
    return replace(groups[0], **columns)
