"""From stored team-steps to what each robot would have handed its network: its own K-hop view, features and labels."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from gatar_edge.errors import ConfigError
from gatar_edge.features import Inputs, ViewArrays, features_of
from gatar_edge.learn.dataset import FILES, load_manifest
from gatar_edge.learn.episodes import KNOWABLE, NO_LABEL
from gatar_edge.learn.jit import compiled
from gatar_edge.learn.kernels import TARGET, hop_counts, list_targets, path_lengths, unpack
from gatar_edge.sim_sitl.world import Team

Array = npt.NDArray[Any]

IGNORED = -100  # label of a robot whose target ego does not know, or that only fills up the batch
MAX_CANDIDATES = 64
POOL = 16  # batches drawn together


@dataclass(frozen=True, slots=True)
class Group:
    """All team-steps of one team and one size of world, ready to be cut into views."""

    team: Team
    size: int
    beliefs: Array  # uint8 [S, N, bytes]
    robots: Array  # uint8 [S, N, 8]
    r_comm: Array  # float32 [S]
    hop_limit: int

    @property
    def views(self) -> int:
        """Number of views: one for each robot of each step."""
        return int(self.robots.shape[0] * self.robots.shape[1])


@dataclass(frozen=True, slots=True)
class Batch:
    """B views with what the expert said: `labels` int64 [B, N], index of the candidate, M for none, or IGNORED."""

    inputs: Inputs
    labels: Array
    view: ViewArrays
    chosen: Array  # uint8 [B, 8], ego's row of `Group.robots`

    @property
    def knowable(self) -> Array:
        """Whether ego's label is a target that ego knows: bool [B]."""
        known: Array = (self.chosen[:, 4] & KNOWABLE) > 0
        return known

    @property
    def labelled(self) -> Array:
        """Whether the expert gave ego a target: bool [B]."""
        given: Array = self.chosen[:, 2] != NO_LABEL
        return given


def load_groups(folder: Path) -> tuple[list[Group], dict[str, Any]]:
    """All shards of a data set, joined by team and size, and its manifest. Raises ConfigError."""
    manifest = load_manifest(folder)
    parts: dict[tuple[str, int], list[list[Array]]] = {}
    for shard in manifest["shards"]:
        try:
            arrays = [np.load(folder / shard["name"] / name) for name in FILES]
        except (OSError, ValueError) as error:
            raise ConfigError(f"{folder / shard['name']}: {error}") from None
        parts.setdefault((shard["team"], shard["size"]), []).append(arrays)
    hop_limit = int(manifest["options"]["hop_limit"])
    groups = []
    for (team, size), shards in parts.items():
        beliefs, robots, steps = (np.concatenate([shard[i] for shard in shards]) for i in range(3))
        groups.append(Group(Team.parse(team), size, beliefs, robots, steps["r_comm"], hop_limit))
    return groups, manifest


def batch_of(group: Group, indices: Array) -> Batch:
    """The views `indices` (step * N + robot) of a group."""
    count = group.robots.shape[1]
    steps, egos = np.divmod(indices, count)
    size = len(indices)
    kinds = np.array(group.team.kinds, dtype=np.int64)
    belief = np.empty((size, group.size, group.size), dtype=np.uint8)
    rows = np.full((size, count), -1, dtype=np.int64)
    hops = np.full((size, count, count), -1, dtype=np.int64)
    distances = np.full((size, count, group.size, group.size), -1, dtype=np.int32)
    targets = np.zeros((size, MAX_CANDIDATES, 2), dtype=np.int64)
    counts = np.zeros((size, 2), dtype=np.int64)
    labels = np.full((size, count), IGNORED, dtype=np.int64)
    robots = group.robots[steps]
    _build(
        group.beliefs[steps, egos], robots, egos, kinds, group.r_comm[steps], group.hop_limit,
        belief, rows, hops, distances, targets, counts, labels,
    )  # fmt: skip
    most, listed = int(counts[:, 0].max()), max(1, int(counts[:, 1].max()))
    rows, hops, distances, targets = rows[:, :most], hops[:, :most, :most], distances[:, :most], targets[:, :listed]
    labels = labels[:, :most]
    labels[labels == MAX_CANDIDATES] = listed
    present = rows >= 0
    taken = np.maximum(rows, 0)
    robots = np.take_along_axis(robots.astype(np.int64), taken[..., None], axis=1)
    robots[~present] = 0
    tasks = robots[..., 5:7]
    tasks[tasks == NO_LABEL] = -1
    view = ViewArrays(
        belief=belief, distances=np.ascontiguousarray(distances), robots=robots[..., :2], kinds=kinds[taken],
        speeds=(robots[..., 7] / np.float32(16)).astype(np.float32), ids=np.where(present, rows + 1, 1000),
        tasks=tasks, ages_s=np.zeros(rows.shape, dtype=np.float32),
        present=present, hops=hops, targets=targets,
        listed=np.arange(listed) < counts[:, 1, None],
    )  # fmt: skip
    return Batch(features_of(view), labels, view, group.robots[steps, egos])


@compiled
def _build(
    packed: Array, robots: Array, egos: Array, kinds: Array, r_comm: Array, hop_limit: int,
    belief: Array, rows: Array, hops: Array, distances: Array, targets: Array, counts: Array, labels: Array,
) -> None:  # fmt: skip
    """Fill one view a row: ego first, the robots within the hop limit by id, what ego knows, and everybody's label.

    "No target" is a label only where ego knows fewer targets than robots: else the expert knew of robots and targets
    that ego cannot know of, and a team that learns to wait for them waits in vain.
    """
    team = robots.shape[1]
    width, height = belief.shape[1:]
    team_hops = np.empty((team, team), dtype=np.int64)
    queue = np.empty(width * height, dtype=np.int64)
    most = targets.shape[1]
    for b in range(len(egos)):
        unpack(packed[b], belief[b])
        hop_counts(robots[b, :, :2], r_comm[b], hop_limit, team_hops)
        rows[b, 0] = egos[b]
        count = 1
        for n in range(team):
            if n != egos[b] and team_hops[egos[b], n] >= 0:
                rows[b, count] = n
                count += 1
        known = list_targets(belief[b], targets[b])
        counts[b, 0], counts[b, 1] = count, known
        for i in range(team):
            hops[b, i, i] = 0
        for i in range(count):
            n = rows[b, i]
            path_lengths(belief[b], kinds[n] == 1, int(robots[b, n, 0]), int(robots[b, n, 1]), distances[b, i], queue)
            for j in range(count):
                hops[b, i, j] = team_hops[n, rows[b, j]]
            if robots[b, n, 2] == 255 and known < count:
                labels[b, i] = most
            for m in range(known):
                if targets[b, m, 0] == robots[b, n, 2] and targets[b, m, 1] == robots[b, n, 3]:
                    labels[b, i] = m


def batches(groups: list[Group], size: int, seed: int, first: int = 0) -> Iterator[Batch]:
    """Endless random batches, each of one group; batch `first` is the same whether or not earlier ones were drawn.

    `POOL` batches are drawn together and cut by size of view, because a batch is as wide as its widest view: with views
    of 1 to 12 robots and 0 to 30 candidates that saves two thirds of the work. Views without candidates are left out.
    """
    weights = np.array([group.views for group in groups], dtype=np.float64)
    weights /= weights.sum()
    number = first
    while True:
        rng = np.random.default_rng([seed, number // POOL])
        group = groups[int(rng.choice(len(groups), p=weights))]
        pool = _with_candidates(group, rng, size * POOL)
        order = rng.permutation(POOL)
        for slot in range(number % POOL, POOL):
            yield batch_of(group, pool[order[slot] * size : (order[slot] + 1) * size])
            number += 1


def _with_candidates(group: Group, rng: np.random.Generator, wanted: int) -> Array:
    """Indices of `wanted` random views in which at least one candidate is known, sorted by robots x candidates."""
    found: list[Array] = []
    pairs: list[Array] = []
    while sum(len(part) for part in found) < wanted:
        indices = rng.integers(group.views, size=wanted)
        steps, egos = np.divmod(indices, group.robots.shape[1])
        counts = np.empty((wanted, 2), dtype=np.int64)
        _count(group.beliefs[steps, egos], group.robots[steps], egos, group.r_comm[steps], group.hop_limit, counts)
        keep = counts[:, 1] > 0
        found.append(indices[keep])
        pairs.append(counts[keep].prod(axis=1))
    chosen = np.concatenate(found)[:wanted]
    return chosen[np.argsort(np.concatenate(pairs)[:wanted], kind="stable")]


@compiled
def _count(packed: Array, robots: Array, egos: Array, r_comm: Array, hop_limit: int, out: Array) -> None:
    """Robots and known targets of each view into `out` [B, 2]."""
    team = robots.shape[1]
    hops = np.empty((team, team), dtype=np.int64)
    for b in range(len(egos)):
        hop_counts(robots[b, :, :2], r_comm[b], hop_limit, hops)
        out[b, 0] = (hops[egos[b]] >= 0).sum()
        known = 0
        bit = 0
        while bit + 3 <= packed.shape[1] * 8:
            value = int(packed[b, bit >> 3])
            if (bit & 7) > 5:
                value |= int(packed[b, (bit >> 3) + 1]) << 8
            known += ((value >> (bit & 7)) & 7) == TARGET
            bit += 3
        out[b, 1] = known
