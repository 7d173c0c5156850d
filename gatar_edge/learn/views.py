"""From stored team-steps to what each robot would have handed its network: its own K-hop view, features and labels."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from gatar_edge.errors import ConfigError
from gatar_edge.features import MAX_CANDIDATES, Inputs, ViewArrays, features_of
from gatar_edge.learn.dataset import FILES, load_manifest
from gatar_edge.learn.jit import compiled
from gatar_edge.learn.kernels import TARGET, hop_counts, path_lengths, unpack
from gatar_edge.learn.labels import KNOWABLE, NO_LABEL
from gatar_edge.learn.memory import FRESH, NOBODY
from gatar_edge.learn.plans import list_candidates
from gatar_edge.sim_sitl.world import Team
from gatar_edge.view import FAR_HOPS

Array = npt.NDArray[Any]

IGNORED = -100  # label of a robot whose target ego does not know, or that only fills up the batch
FRONTIERS_USUAL = 8  # for sorting views by size
POOL = 16  # batches drawn together


@dataclass(frozen=True, slots=True)
class Group:
    """All team-steps of one team and one size of world, ready to be cut into views."""

    team: Team
    size: int
    beliefs: Array  # uint8 [S, N, bytes]
    robots: Array  # uint8 [S, N, 8]
    known: Array  # uint8 [S, N, N, 3]
    votes: Array  # uint8 [S, N, VOTES, 3]
    plans: Array  # uint8 [S, N, N]
    r_comm: Array  # float32 [S]
    hop_limit: int
    frontiers: bool = False  # among the candidates, as the teacher had them
    tasks: Array | None = None  # uint8 [S, N, N, 2], what each robot was last told of each one's goal; None: as it is

    @property
    def views(self) -> int:
        """Number of views: one for each robot of each step."""
        return int(self.robots.shape[0] * self.robots.shape[1])


@dataclass(frozen=True, slots=True)
class Batch:
    """B views with what the teacher said: `labels` int64 [B, N], index of the candidate, M for none, or IGNORED.

    `shares` float32 [B, M + 1] are ego's shares of the candidates and of none; 0 throughout where it knows none of
    them.
    """

    inputs: Inputs
    labels: Array
    shares: Array
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
        except (OSError, ValueError, EOFError) as error:
            raise ConfigError(f"{folder / shard['name']}: {error}") from None
        parts.setdefault((shard["team"], shard["size"]), []).append(arrays)
    hop_limit = int(manifest["options"]["hop_limit"])
    groups = []
    for (team, size), shards in parts.items():
        beliefs, robots, known, votes, plans, steps = (np.concatenate(arrays) for arrays in zip(*shards, strict=True))
        ahead = manifest["options"]["teacher"] == "foresight"
        groups.append(
            Group(Team.parse(team), size, beliefs, robots, known, votes, plans, steps["r_comm"], hop_limit, ahead)
        )
    return groups, manifest


def batch_of(group: Group, indices: Array, with_windows: bool = True) -> Batch:
    """The views `indices` (step * N + robot) of a group; `with_windows` as in `features_of`."""
    count = group.robots.shape[1]
    steps, egos = np.divmod(indices, count)
    size = len(indices)
    kinds = np.array(group.team.kinds, dtype=np.int64)
    belief = np.empty((size, group.size, group.size), dtype=np.uint8)
    rows = np.full((size, count), -1, dtype=np.int64)
    hops = np.full((size, count, count), -1, dtype=np.int64)
    distances = np.full((size, count, group.size, group.size), -1, dtype=np.int32)
    targets = np.zeros((size, MAX_CANDIDATES, 2), dtype=np.int64)
    dark = np.zeros((size, MAX_CANDIDATES), dtype=np.int64)
    counts = np.zeros((size, 2), dtype=np.int64)
    labels = np.full((size, count), IGNORED, dtype=np.int64)
    shares = np.zeros((size, MAX_CANDIDATES + 1), dtype=np.float32)
    robots, known = group.robots[steps], group.known[steps, egos]
    _build(
        group.beliefs[steps, egos], known, egos, kinds, group.r_comm[steps], group.hop_limit, group.frontiers,
        group.plans[steps, egos], group.votes[steps, egos],
        belief, rows, hops, distances, targets, dark, counts, labels, shares,
    )  # fmt: skip
    most, listed = int(counts[:, 0].max()), max(1, int(counts[:, 1].max()))
    rows, hops, distances, targets = rows[:, :most], hops[:, :most, :most], distances[:, :most], targets[:, :listed]
    labels = labels[:, :most]
    labels[labels == MAX_CANDIDATES] = listed
    shares = np.concatenate([shares[:, :listed], shares[:, -1:]], axis=1)
    present = rows >= 0
    taken = np.maximum(rows, 0)
    told = robots[..., 5:7] if group.tasks is None else group.tasks[steps, egos]
    robots, known, tasks = (
        np.take_along_axis(rows_of.astype(np.int64), taken[..., None], axis=1) for rows_of in (robots, known, told)
    )
    for rows_of in (robots, known, tasks):
        rows_of[~present] = 0
    tasks[tasks == NO_LABEL] = -1
    view = ViewArrays(
        belief=belief, distances=np.ascontiguousarray(distances), robots=known[..., :2], kinds=kinds[taken],
        speeds=(robots[..., 7] / np.float32(16)).astype(np.float32), ids=np.where(present, rows + 1, 1000),
        tasks=tasks, ages_s=known[..., 2].astype(np.float32),
        present=present, hops=hops, targets=targets,
        listed=np.arange(listed) < counts[:, 1, None], dark=dark[:, :listed],
    )  # fmt: skip
    return Batch(features_of(view, with_windows), labels, shares, view, group.robots[steps, egos])


@compiled
def _build(
    packed: Array, known: Array, egos: Array, kinds: Array, r_comm: Array, hop_limit: int, frontiers: bool,
    plans: Array, votes: Array,
    belief: Array, rows: Array, hops: Array, distances: Array, targets: Array, dark: Array, counts: Array,
    labels: Array, shares: Array,
) -> None:  # fmt: skip
    """Fill one view a row: ego first, those with whom it reckons by id, what ego knows, and everybody's label."""
    team = known.shape[1]
    width, height = belief.shape[1:]
    queue = np.empty(width * height, dtype=np.int64)
    most = targets.shape[1]
    for b in range(len(egos)):
        unpack(packed[b], belief[b])
        rows[b, 0] = egos[b]
        count = 1
        for n in range(team):
            if n != egos[b] and known[b, n, 2] != NOBODY:
                rows[b, count] = n
                count += 1
        for i in range(team):
            hops[b, i, i] = 0
        _link(rows[b, :count], known[b], r_comm[b], hop_limit, hops[b])
        for i in range(count):
            n = rows[b, i]
            path_lengths(belief[b], kinds[n] == 1, int(known[b, n, 0]), int(known[b, n, 1]), distances[b, i], queue)
        _, listed = list_candidates(belief[b], distances[b, :count], frontiers, targets[b], dark[b])
        counts[b, 0], counts[b, 1] = count, listed
        for i in range(count):
            choice = plans[b, rows[b, i]]
            if choice == NO_LABEL:
                labels[b, i] = most
            elif choice < listed:
                labels[b, i] = choice
        _share(votes[b], targets[b, :listed], shares[b])


@compiled
def _link(rows: Array, known: Array, r_comm: float, hop_limit: int, hops: Array) -> None:
    """Hops among the robots of one view, as `view.with_absent` counts them."""
    count = len(rows)
    cells = np.empty((count, 2), dtype=np.int64)
    fresh = 0
    inner = np.empty(count, dtype=np.int64)
    for i in range(count):
        if known[rows[i], 2] <= FRESH:
            cells[fresh] = known[rows[i], :2]
            inner[fresh] = i
            fresh += 1
    between = np.empty((fresh, fresh), dtype=np.int64)
    hop_counts(cells[:fresh], r_comm, hop_limit, between)
    away = np.ones(count, dtype=np.bool_)
    for i in range(fresh):
        away[inner[i]] = between[0, i] < 0
    for i in range(fresh):
        for j in range(fresh):
            hops[inner[i], inner[j]] = between[i, j]
    for i in range(count):
        for j in range(count):
            if i != j and (away[i] or away[j]):
                hops[i, j] = FAR_HOPS


@compiled
def _share(votes: Array, candidates: Array, out: Array) -> None:
    """Ego's shares of the candidates and, last, of none; all 0 where most of the votes went to what it does not know.

    A robot that has anything to do does it: votes for none count only where there are no others.
    """
    none, known, total = 0.0, 0.0, 0.0
    for v in range(len(votes)):
        total += votes[v, 2]
        if votes[v, 0] == NO_LABEL:
            none += votes[v, 2]
            continue
        for m in range(len(candidates)):
            if candidates[m, 0] == votes[v, 0] and candidates[m, 1] == votes[v, 1]:
                out[m] += votes[v, 2]
                known += votes[v, 2]
    if known == 0:
        out[-1] = 1.0 if none > 0 and none == total else 0.0
    elif known < (total - none) / 2:
        out[:] = 0
    else:
        for m in range(len(candidates)):
            out[m] /= known


def batches(groups: list[Group], size: int, seed: int, first: int = 0, with_windows: bool = True) -> Iterator[Batch]:
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
            yield batch_of(group, pool[order[slot] * size : (order[slot] + 1) * size], with_windows)
            number += 1


def _with_candidates(group: Group, rng: np.random.Generator, wanted: int) -> Array:
    """Indices of `wanted` random views in which at least one candidate is known, sorted by robots x candidates."""
    found: list[Array] = []
    pairs: list[Array] = []
    while sum(len(part) for part in found) < wanted:
        indices = rng.integers(group.views, size=wanted)
        steps, egos = np.divmod(indices, group.robots.shape[1])
        counts = np.empty((wanted, 2), dtype=np.int64)
        _count(group.beliefs[steps, egos], group.known[steps, egos], counts)
        counts[:, 1] += FRONTIERS_USUAL * group.frontiers
        keep = counts[:, 1] > 0
        found.append(indices[keep])
        pairs.append(counts[keep].prod(axis=1))
    chosen = np.concatenate(found)[:wanted]
    return chosen[np.argsort(np.concatenate(pairs)[:wanted], kind="stable")]


@compiled
def _count(packed: Array, known: Array, out: Array) -> None:
    """Robots and known targets of each view into `out` [B, 2]."""
    for b in range(len(packed)):
        out[b, 0] = (known[b, :, 2] != NOBODY).sum()
        targets = 0
        bit = 0
        while bit + 3 <= packed.shape[1] * 8:
            value = int(packed[b, bit >> 3])
            if (bit & 7) > 5:
                value |= int(packed[b, (bit >> 3) + 1]) << 8
            targets += ((value >> (bit & 7)) & 7) == TARGET
            bit += 3
        out[b, 1] = targets
