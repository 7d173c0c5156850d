"""Data generation: true to the mission's rules, the same for any workers, unharmed by a kill, compact."""

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest
from learning import OPTIONS, tiny_data
from processes import children_of, parents

from gatar_edge import belief as beliefs
from gatar_edge.allocators.greedy import Greedy
from gatar_edge.errors import ConfigError
from gatar_edge.learn import dataset
from gatar_edge.learn.dataset import FILES, MANIFEST, DataOptions, generate, make_shard
from gatar_edge.learn.kernels import unpack
from gatar_edge.learn.views import batch_of, batches, load_groups
from gatar_edge.sim_sitl.world import TRAINING_SEEDS, Team, observe, random_world
from gatar_edge.types import CellState, RobotKind, RobotState
from gatar_edge.view import build_view, hop_counts

pytestmark = pytest.mark.usefixtures("compiled")

SMALL = DataOptions(("2A2G",), (15,), (4.0,), 1, 3)


@pytest.fixture(scope="module")
def shard():
    return make_shard(SMALL, 0)


def unpacked(packed, size=15):
    out = np.zeros((size, size), dtype=np.uint8)
    unpack(packed, out)
    return out


def robots_at(row, kinds):
    return [
        RobotState(n + 1, kinds[n], (int(row[n, 0]), int(row[n, 1])), float(row[n, 7]) / 16) for n in range(len(kinds))
    ]


def test_stored_beliefs_are_those_of_robots_that_see_tell_and_remember(shard):
    packed, robots, *_, steps = shard
    first = steps["world"] == steps["world"][0]
    world = random_world(Team.parse("2A2G"), None, 15, 15, int(steps["world"][0]))
    own = [np.zeros((15, 15), dtype=np.uint8) for _ in range(4)]
    for step in np.flatnonzero(first)[:15]:
        team = robots_at(robots[step], world.team.kinds)
        if (robots[step, :, 7] > 16).any():
            pytest.skip("two cells a step: the second visit is not in the observation")
        own = [beliefs.observed(own[n], observe(world, n + 1, team[n].cell, 4.0, 0)) for n in range(4)]
        hops = hop_counts(team, 4.0, 2)
        told = list(own)
        for n in range(4):
            for m in range(4):
                if hops[n, m] > 0:
                    told[n] = beliefs.merged(told[n], (0, 0), own[m])
            np.testing.assert_array_equal(unpacked(packed[step, n]), told[n])
        own = told


def test_labels_are_the_greedy_experts_on_what_all_robots_know(shard):
    packed, robots, *_ = shard
    kinds = Team.parse("2A2G").kinds
    for step in range(0, 400, 7):
        union = np.max([unpacked(packed[step, n]) for n in range(4)], axis=0)
        team = robots_at(robots[step], kinds)
        view = build_view(0, team[0], team[1:], union, 1000.0, 2, 64)
        choices = Greedy().allocate(view).choices
        for n in range(4):
            label = tuple(robots[step, n, 2:4])
            assert label == ((255, 255) if choices[n] < 0 else tuple(view.targets[choices[n]]))
            knowable = choices[n] >= 0 and unpacked(packed[step, n])[label] == CellState.TARGET
            assert bool(robots[step, n, 4]) == knowable


def test_robots_move_at_their_speed_and_never_into_an_obstacle(shard):
    _, robots, *_, steps = shard
    for step in range(1, len(steps)):
        if steps["step"][step] == 0:
            continue
        gap = np.abs(robots[step, :, :2].astype(int) - robots[step - 1, :, :2].astype(int)).sum(axis=1)
        assert (gap <= np.ceil(robots[step, :, 7] / 16)).all()
    world = random_world(Team.parse("2A2G"), None, 15, 15, int(steps["world"][0]))
    here = robots[steps["world"] == steps["world"][0]]
    ground = [n for n, kind in enumerate(world.team.kinds) if kind is RobotKind.UGV]
    assert not world.obstacles[here[:, ground, 0], here[:, ground, 1]].any()


def test_worlds_come_from_the_training_seeds_and_no_two_shards_share_one():
    seen = set()
    for number in range(2):
        worlds = set(make_shard(SMALL, number)[-1]["world"].tolist())
        assert min(worlds) >= TRAINING_SEEDS
        assert not worlds & seen
        seen |= worlds


def test_a_team_step_takes_at_most_150_bytes_a_robot():
    arrays = make_shard(replace(SMALL, teams=("6A6G",)), 0)
    assert sum(array.nbytes for array in arrays) / (len(arrays[-1]) * 12) <= 150


def test_any_number_of_workers_makes_the_same_shards(tmp_path):
    manifest = generate(OPTIONS, tmp_path, workers=2)
    assert manifest == json.loads((tiny_data() / MANIFEST).read_text())


@pytest.mark.parametrize("workers", [1, 2])
def test_a_killed_run_leaves_no_process_goes_on_and_ends_with_the_same_data(tmp_path, workers):
    out = tmp_path / "data"
    line = ["dataset", "--team", "1A1G", "--team", "2A2G", "--r-comm", "6", "--r-comm", "3", "--samples", str(6 * 1024)]
    line += ["--seed", "5", "--out", str(out), "--workers", str(workers)]
    process = subprocess.Popen([sys.executable, "-m", "gatar_edge", *line], stderr=subprocess.DEVNULL)
    while process.poll() is None and not list(out.glob("shard-*")):
        time.sleep(0.01)
    started = children_of(process.pid)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    while started & parents().keys():  # the test's own limit ends this
        time.sleep(0.05)
    assert generate(OPTIONS, out, workers=1) == json.loads((tiny_data() / MANIFEST).read_text())


def test_a_damaged_shard_is_made_again(tmp_path):
    generate(SMALL, tmp_path, workers=1)
    path = tmp_path / "shard-00000" / FILES[0]
    whole = path.read_bytes()
    path.write_bytes(whole[:-1] + b"\xff")
    generate(SMALL, tmp_path, workers=1)
    assert path.read_bytes() == whole


@pytest.mark.parametrize("left", [b"", b"half of the we"])
def test_a_damaged_shard_is_named_to_who_trains_on_it(tmp_path, left):
    generate(SMALL, tmp_path, workers=1)
    (tmp_path / "shard-00000" / FILES[0]).write_bytes(left)
    with pytest.raises(ConfigError, match="shard-00000"):
        load_groups(tmp_path)


@pytest.mark.parametrize("left", ["", "{}", '{"name": "sha'])
def test_a_shard_whose_note_is_damaged_is_made_again(tmp_path, left):
    manifest = generate(SMALL, tmp_path, workers=1)
    (tmp_path / "shard-00000" / "shard.json").write_text(left)
    assert generate(SMALL, tmp_path, workers=1) == manifest


def test_a_whole_shard_is_not_made_again(tmp_path, monkeypatch):
    generate(SMALL, tmp_path, workers=1)
    monkeypatch.setattr(dataset, "make_shard", lambda *args: pytest.fail("made again"))
    generate(SMALL, tmp_path, workers=1)


def test_a_folder_of_other_options_is_refused(tmp_path):
    generate(SMALL, tmp_path, workers=1)
    with pytest.raises(ConfigError, match="other options"):
        generate(replace(SMALL, seed=4), tmp_path, workers=1)


@pytest.mark.parametrize(
    "change", [{"teams": ("6X",)}, {"sizes": (300,)}, {"samples": 0}, {"r_comms": (-1.0,)}, {"r_senses": ()}]
)
def test_options_that_cannot_be_used_are_refused(tmp_path, change):
    with pytest.raises(ConfigError):
        generate(replace(SMALL, **change), tmp_path, workers=1)


def test_a_folder_without_a_manifest_is_not_a_data_set(tmp_path):
    with pytest.raises(ConfigError, match="not a complete data set"):
        load_groups(tmp_path)


def test_a_training_view_is_the_view_that_the_robot_would_build():
    groups, _ = load_groups(tiny_data())
    group = next(group for group in groups if len(group.team.kinds) == 4)
    indices = np.random.default_rng(0).integers(group.views, size=32)
    batch = batch_of(group, indices)
    for row, (step, ego) in enumerate(zip(*np.divmod(indices, 4), strict=True)):
        team = robots_at(group.robots[step], group.team.kinds)
        near = hop_counts(team, float(group.r_comm[step]), 2)[ego] > 0
        others = [team[n] for n in range(4) if near[n]]
        view = build_view(0, team[ego], others, unpacked(group.beliefs[step, ego]), float(group.r_comm[step]), 2, 64)
        count, listed = len(view.robots), len(view.targets)
        assert batch.view.present[row].sum() == count
        np.testing.assert_array_equal(batch.view.hops[row, :count, :count], view.hops)
        np.testing.assert_array_equal(batch.view.targets[row, :listed], view.targets)
        np.testing.assert_array_equal(batch.view.distances[row, :count], view.distances)


def test_batches_can_be_taken_up_in_the_middle():
    groups, _ = load_groups(tiny_data())
    source = batches(groups, 8, seed=1)
    skipped = [next(source) for _ in range(5)][-1]
    np.testing.assert_array_equal(next(batches(groups, 8, seed=1, first=4)).labels, skipped.labels)
