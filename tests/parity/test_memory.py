"""Data for a network that looks ahead: robots out of range and frontiers are what the robot's own code gives."""

from __future__ import annotations

import numpy as np
import pytest
from learning import ahead_data
from msgspec.structs import replace

from gatar_edge.absent import out_of_range, patience_s
from gatar_edge.features import features
from gatar_edge.learn.kernels import unpack
from gatar_edge.learn.memory import FRESH, NOBODY
from gatar_edge.learn.views import Group, batch_of, load_groups
from gatar_edge.types import NS_PER_S, ByteGrid, RobotState, TaskKind
from gatar_edge.view import build_view, hop_counts, with_absent


@pytest.fixture(scope="module")
def group() -> Group:
    return load_groups(ahead_data())[0][0]


def team_at(group: Group, step: int) -> list[RobotState]:
    """Everybody as it is, going where it went at the step before."""
    team = []
    for n, row in enumerate(group.robots[step].astype(int)):
        task, cell = (TaskKind.HOLD, (-1, -1)) if row[5] == 255 else (TaskKind.EXPLORE, (int(row[5]), int(row[6])))
        team.append(RobotState(n + 1, group.team.kinds[n], (int(row[0]), int(row[1])), row[7] / 16, task, cell))
    return team


def belief_at(group: Group, step: int, ego: int) -> ByteGrid:
    belief = np.zeros((group.size, group.size), dtype=np.uint8)
    unpack(group.beliefs[step, ego], belief)
    return belief


def test_robots_out_of_range_are_reckoned_with_where_the_agent_expects_them(group: Group) -> None:
    steps = np.load(ahead_data() / "shard-00000" / "steps.npy")["step"]
    ages = []
    heard: dict[tuple[int, int], tuple[int, RobotState]] = {}
    for step, number in enumerate(steps.tolist()):
        heard = {} if number == 0 else heard
        team, r_comm = team_at(group, step), float(group.r_comm[step])
        hops = hop_counts(team, r_comm, group.hop_limit)
        for n, ego in enumerate(team):
            heard |= {(n, m): (number, other) for m, other in enumerate(team) if hops[n, m] > 0}
            old = {m: (number - then, other) for (k, m), (then, other) in heard.items() if k == n}
            silent = [replace(other, age_ns=age * NS_PER_S) for age, other in old.values() if age > FRESH]
            near = [ego, *(other for m, other in enumerate(team) if hops[n, m] == 1)]
            wanted = {n: (*ego.cell, 0)}
            wanted |= {m: (*other.cell, age) for m, (age, other) in old.items() if age <= FRESH}
            for_s = patience_s(len(old) - len(silent), group.size**2, r_comm)
            for other in out_of_range(silent, near, for_s, r_comm):
                wanted[other.robot_id - 1] = (*other.cell, other.age_ns // NS_PER_S)
            known = group.known[step, n].astype(int)
            assert {m: tuple(row) for m, row in enumerate(known.tolist()) if row[2] != NOBODY} == wanted
            ages += [age for *_, age in wanted.values()]
    assert max(ages) > 10  # else nothing was out of range for long
    assert np.mean(np.array(ages) > FRESH) > 0.05


def test_a_training_view_is_what_a_robot_that_looks_ahead_would_hand_its_network(group: Group) -> None:
    indices = np.random.default_rng(0).integers(group.views, size=64)
    batch = batch_of(group, indices)
    absent_seen = frontiers_seen = 0
    for row, (step, ego) in enumerate(zip(*np.divmod(indices, len(group.team.kinds)), strict=True)):
        team = team_at(group, int(step))
        known = [
            replace(team[m], cell=(int(x), int(y)), age_ns=int(age) * NS_PER_S)
            for m, (x, y, age) in enumerate(group.known[step, ego].tolist())
            if age != NOBODY and m != ego
        ]
        fresh = [other for other in known if other.age_ns <= FRESH * NS_PER_S]
        absent = tuple(other for other in known if other.age_ns > FRESH * NS_PER_S)
        belief = belief_at(group, int(step), int(ego))
        view = build_view(0, team[ego], fresh, belief, float(group.r_comm[step]), group.hop_limit, 64, absent)
        inputs = features(with_absent(view), with_frontiers=True)
        robots, listed = batch.view.present[row].sum(), max(1, batch.view.listed[row].sum())
        for name, axes in (("robots", 1), ("pairs", 2), ("valid", 2), ("maps", 1), ("cells", 2)):
            found = batch.inputs[name][row, :robots]
            np.testing.assert_array_equal(found[:, :listed] if axes == 2 else found, inputs[name], err_msg=name)
        np.testing.assert_array_equal(batch.inputs["hops"][row, :robots, :robots], inputs["hops"])
        np.testing.assert_array_equal(batch.inputs["places"][row, :listed], inputs["places"])
        np.testing.assert_array_equal(batch.inputs["offsets"][row, :listed], inputs["offsets"])
        absent_seen += len(absent)
        frontiers_seen += int((inputs["places"][:, 0] > 0).sum())
    assert absent_seen > 5
    assert frontiers_seen > 64
