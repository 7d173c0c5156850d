"""Fine-tuning on outcome: what ego may choose from, what a step was worth, and that the network learns of it."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("torch")
pytest.importorskip("numba")

import torch
from click.testing import CliRunner
from learning import TINY_AHEAD, ahead_data, options, tiny_run
from made_once import made_once
from safetensors.torch import load_file

from gatar_edge.allocators.base import NO_TARGET, Allocation
from gatar_edge.allocators.gatar import decode
from gatar_edge.commands.train import command as train
from gatar_edge.commands.tune import command
from gatar_edge.errors import ConfigError
from gatar_edge.grid import UNREACHABLE
from gatar_edge.learn.dataset import SHARDS_PER_SEED, WORLDS_PER_SHARD
from gatar_edge.learn.evaluate import view_at
from gatar_edge.learn.memory import NOBODY
from gatar_edge.learn.train import Trainer, load_model, tensors_of
from gatar_edge.learn.tuning.critic import Critic, advantages
from gatar_edge.learn.tuning.missions import NEVER, Conditions, Missions
from gatar_edge.learn.tuning.options import _held, goals_of, options_of
from gatar_edge.learn.tuning.rollout import fly, log_probabilities
from gatar_edge.learn.tuning.standing import STANDING
from gatar_edge.learn.tuning.tuner import FIRST_WORLD, TuneOptions, Tuner, _deaths
from gatar_edge.learn.views import batch_of, load_groups
from gatar_edge.sim_sitl.world import TRAINING_SEEDS, Team
from gatar_edge.tasks import Rules, Task, decide
from gatar_edge.types import CellState, TaskKind

TINY = {**TINY_AHEAD, "maps": False, "tasks": False}


@cache
def ahead_run() -> Path:
    """A finished run of a network that looks ahead, reads no window, and does not see what robots are doing."""
    run = options(data=str(ahead_data()), settings=TINY)
    return made_once("ahead-run-to-tune", lambda folder: Trainer(run, folder).run(lambda progress: None))


def tune_options(**changes: object) -> TuneOptions:
    """A run of seconds."""
    values = {"run": str(ahead_run()), "teams": ("2A1G", "1A1G"), "rounds": 2, "missions": 6, "batch": 50}
    return TuneOptions(**{**values, **changes})  # type: ignore[arg-type]


def conditions(count: int = 4, team: str = "2A1G", loss: float = 0.0) -> Conditions:
    one = np.ones(count)
    robots = len(Team.parse(team).kinds)
    return Conditions(
        Team.parse(team), 15, range(count), 6 * one, 4 * one, loss * one, np.ones((count, 2)),
        np.full((count, robots), NEVER),
    )  # fmt: skip


def flown(seed: int = 3):
    network, _ = load_model(ahead_run())
    return network, fly(network, Critic(), conditions(), 0.5, seed)


def test_missions_end_when_all_targets_are_localized_and_none_goes_on() -> None:
    missions = Missions(conditions(), luck=1)
    while not missions.over.all():
        active = missions.moment().active
        first_left = np.array([np.argwhere(missions._left[b])[0] for b in active])
        missions.act(active, first_left[:, None].repeat(missions.robots, axis=1))
        assert set(np.flatnonzero(~missions.over).tolist()) <= set(active.tolist())
        assert (missions.steps[active] == missions.step).all()
        assert missions.step < 1000
    assert len(set(missions.steps.tolist())) > 1


def test_a_robot_knows_of_the_others_goals_what_they_told_it_last() -> None:
    missions, rng = Missions(replace(conditions(1), r_comm=np.full(1, 3.0)), luck=1), np.random.default_rng(1)
    goals, told = np.full((3, 2), 255), {}
    stale = 0
    while not missions.over.all() and missions.step < 60:
        moment = missions.moment()
        for n in range(3):
            for m in range(3):
                age = moment.group.known[0, n, m, 2]
                if age == 0:
                    told[n, m] = tuple(goals[m].tolist())
                if age != NOBODY:
                    assert tuple(moment.group.tasks[0, n, m].tolist()) == told[n, m]  # type: ignore[index]
                    stale += told[n, m] != tuple(goals[m].tolist())
        goals = rng.integers(0, 15, (3, 2))
        missions.act(moment.active, goals[None])
    assert stale > 5  # else nobody was out of range


def test_a_dead_robot_says_and_hears_nothing_and_stands_still() -> None:
    deaths = np.array([[NEVER, 4, NEVER]])
    missions = Missions(replace(conditions(1), r_comm=np.full(1, 100.0), deaths=deaths), luck=1)
    rng = np.random.default_rng(1)
    for step in range(10):
        moment = missions.moment()
        dead = step >= 4
        assert moment.alive.tolist() == [[True, not dead, True]]
        ages = moment.group.known[0, :, :, 2]
        assert (ages[0, 2], ages[2, 0]) == (0, 0)
        assert ages[0, 1] == ages[1, 0] == ages[2, 1] == ((step - 3 if step <= 6 else NOBODY) if dead else 0)
        before = missions._cells.copy()
        missions.act(moment.active, rng.integers(0, 15, (1, 3, 2)))
        stood = (missions._cells == before).all(axis=-1)[0]
        assert stood[1] or not dead
        assert not stood[[0, 2]].all()


def test_nobody_waits_for_targets_that_only_the_dead_could_reach() -> None:
    walled_off = replace(conditions(2, "1A1G"), seeds=(27, 28))  # one target each that no UGV can reach
    alive, lost = (Missions(replace(walled_off, deaths=np.array([[death, NEVER]] * 2)), luck=1) for death in (NEVER, 1))
    assert (alive._left.sum(axis=(1, 2)) - lost._left.sum(axis=(1, 2))).tolist() == [1, 1]
    assert (lost._left <= alive._left).all()


def test_no_choice_of_a_dead_robot_teaches_anything() -> None:
    network, _ = load_model(ahead_run())
    deaths = np.full((4, 3), NEVER)
    deaths[:, 1] = 2
    rollout = fly(network, Critic(), replace(conditions(), deaths=deaths), 0.5, 3)
    first = 2 * 4 * 3  # nobody's mission is over in two steps
    robot = np.arange(first, rollout.group.views) % 3
    assert not rollout.choices.open[first:][robot == 1].any()
    assert rollout.choices.open[first:][robot != 1].any()
    assert (rollout.choices.goals[first:][robot == 1] == -1).all()


def test_as_many_robots_die_as_were_asked_for_but_half_a_team_lives() -> None:
    deaths = _deaths(5, np.array([0, 1, 2, 5]), np.random.default_rng(0))
    assert (deaths < NEVER).sum(axis=1).tolist() == [0, 1, 2, 2]
    assert set(deaths[deaths < NEVER].tolist()) <= set(range(1, 9))
    many = _deaths(4, np.full(200, 1), np.random.default_rng(0))
    assert set(np.argwhere(many < NEVER)[:, 1].tolist()) == {0, 1, 2, 3}


def test_ranks_fly_all_missions_of_a_round_between_them() -> None:
    whole = replace(conditions(7), loss=np.linspace(0, 0.6, 7))
    parts = [whole.part(rank, 3) for rank in range(3)]
    assert sorted(seed for part in parts for seed in part.seeds) == list(whole.seeds)
    for part in parts:
        assert [whole.seeds[round(10 * loss)] for loss in part.loss] == list(part.seeds)


def test_the_same_seed_flies_the_same_missions_and_another_one_does_not() -> None:
    network, one = flown()
    critic = Critic()
    again, other = (fly(network, critic, conditions(), 0.5, seed) for seed in (3, 4))
    assert (one.choices.choice == again.choices.choice).all()
    assert len(one.choices.choice) != len(other.choices.choice) or (one.choices.choice != other.choices.choice).any()


@pytest.mark.slow
def test_the_likeliest_choice_leads_where_the_robot_would_go() -> None:
    """Against the robot's own rules, on the views of a data set."""
    network, _ = load_model(ahead_run())
    (group,) = load_groups(ahead_data())[0]
    batch = batch_of(group, np.arange(0, group.views, 7), with_windows=False)
    with torch.inference_mode():
        scores = network(**tensors_of(batch, network.inputs)).scores  # type: ignore[arg-type]
    probabilities = scores.softmax(dim=-1).numpy()
    possible_choices = options_of(batch, probabilities)
    likely = log_probabilities(scores, possible_choices, 1.0).numpy()
    choices = np.where(possible_choices.allowed.any(axis=1), likely.argmax(axis=1), NO_TARGET)
    goals = goals_of(batch.view, choices)
    held = _held(batch.view, batch.view.listed & (batch.view.dark == 0))
    same, asked = 0, 0
    for b in range(len(choices)):
        rows, listed = np.flatnonzero(batch.view.present[b]), np.flatnonzero(batch.view.listed[b])
        cut = np.ix_(rows, listed)
        possible = batch.inputs["valid"][b][cut] > 0  # type: ignore[index, operator]
        shown = probabilities[b][np.ix_(rows, np.append(listed, -1))]
        order = np.argsort(batch.view.ids[b, rows], kind="stable")
        joint = decode(shown, possible, order, held[b][cut])
        count = int((batch.view.dark[b, listed] == 0).sum())
        places = batch.view.targets[b, listed]
        view = view_at(batch, b)
        view = replace(view, targets=view.targets[:count], lengths=view.lengths[:, :count])
        allocation = Allocation(
            choices=np.where(joint < count, joint, NO_TARGET).astype(np.int32),
            scores=np.where(possible, shown[:, :-1], -np.inf)[:, :count].astype(np.float32),
            steady=True,
            frontier=(int(places[joint[0], 0]), int(places[joint[0], 1])) if joint[0] >= count else None,
        )
        heading = tuple(batch.view.tasks[b, 0].tolist())
        dark = heading[0] >= 0 and batch.view.belief[b][heading] == CellState.UNKNOWN
        task = Task(TaskKind.HOLD if heading[0] < 0 else TaskKind.EXPLORE if dark else TaskKind.TARGET, heading)
        wanted = decide(view, allocation, task, Rules(keep=True, r_sense=4.0))
        if choices[b] != NO_TARGET:
            asked += 1
            same += tuple(goals[b].tolist()) == wanted.cell
    assert asked > 300
    assert same / asked > 0.9  # this network has hardly learned: its scores are near to each other


def test_no_choice_is_a_target_that_others_get_or_that_cannot_be_reached() -> None:
    _, rollout = flown()
    batch = batch_of(rollout.group, np.arange(rollout.group.views), with_windows=False)
    chosen = rollout.choices.choice
    some = chosen != NO_TARGET
    assert some.mean() > 0.9
    reached = batch.inputs["valid"][np.arange(len(chosen)), 0, np.maximum(chosen, 0)]  # type: ignore[index]
    assert (reached[some] > 0).all()
    assert rollout.choices.allowed[np.arange(len(chosen)), np.maximum(chosen, 0)][some].all()


def test_a_robot_with_nothing_to_explore_takes_what_nobody_is_on_its_way_to() -> None:
    """Two robots side by side whose scores give the one target to each other; nothing is unknown."""
    belief = np.full((1, 5, 5), CellState.FREE, dtype=np.uint8)
    belief[0, 4, 4] = CellState.TARGET
    distances = np.add.outer(np.arange(5), np.arange(5))[None, None].repeat(2, axis=1).astype(np.int32)
    view = SimpleNamespace(
        belief=belief, distances=distances, robots=np.zeros((1, 2, 2), dtype=np.int64),
        speeds=np.ones((1, 2), dtype=np.float32), ids=np.array([[1, 2]]), tasks=np.full((1, 2, 2), -1),
        ages_s=np.zeros((1, 2), dtype=np.float32), present=np.ones((1, 2), dtype=np.bool_),
        targets=np.array([[[4, 4]]]), listed=np.ones((1, 1), dtype=np.bool_), dark=np.zeros((1, 1), dtype=np.int64),
    )  # fmt: skip
    batch = SimpleNamespace(view=view, inputs={"valid": np.ones((1, 2, 1), dtype=np.float32)})
    others = np.array([[[0.1, 0.9], [0.9, 0.1]]])
    assert options_of(batch, others).allowed.tolist() == [[True]]  # type: ignore[arg-type]
    view.tasks[0, 1] = (4, 4)
    assert options_of(batch, others).allowed.tolist() == [[False]]  # type: ignore[arg-type]
    view.tasks[0, 1] = (-1, -1)
    belief[0, 2, 2] = CellState.UNKNOWN
    assert options_of(batch, others).allowed.tolist() == [[False]]  # type: ignore[arg-type]
    distances[0, 0, 2, 2] = UNREACHABLE
    assert options_of(batch, others).allowed.tolist() == [[True]]  # type: ignore[arg-type]


def test_missions_that_go_as_expected_teach_nothing() -> None:
    alive = np.array([[True, True], [True, True], [False, True]])
    estimates = np.array([[2.0, 3.0], [1.0, 2.0], [0.0, 1.0]])
    assert advantages(estimates, alive, cut=np.array([False, False])).tolist() == np.zeros((3, 2)).tolist()


def test_a_step_after_which_less_is_left_was_worth_what_it_saved() -> None:
    alive = np.ones((3, 1), dtype=np.bool_)
    estimates = np.array([[5.0], [2.0], [1.0]])  # the first step saved two
    saved = advantages(estimates, alive, cut=np.array([False]))[:, 0]
    assert saved.tolist() == [2.0, 0.0, 0.0]


def test_a_mission_that_was_cut_off_saved_nothing_by_that() -> None:
    alive = np.ones((2, 1), dtype=np.bool_)
    assert advantages(np.array([[9.0], [9.0]]), alive, cut=np.array([True]))[-1, 0] == -1.0


def test_the_critic_learns_from_earlier_missions_of_a_kind_and_keeps_kinds_apart() -> None:
    rng = np.random.default_rng(0)
    standing = rng.uniform(0, 10, (400, STANDING))
    slow, fast = standing @ np.linspace(1, 2, STANDING), standing @ np.linspace(0, 1, STANDING)
    critic = Critic()
    critic.estimate("slow", standing, slow)
    critic.estimate("fast", standing, fast)
    assert np.abs(critic.estimate("slow", standing, np.zeros(400)) - slow).max() < 0.5
    assert np.abs(critic.estimate("fast", standing, np.zeros(400)) - fast).max() < 0.5


@pytest.mark.slow
@pytest.mark.parametrize("worth", [1.0, -1.0])
def test_choices_of_good_steps_become_likelier_and_of_bad_steps_less(tmp_path: Path, worth: float) -> None:
    tuner = Tuner(tune_options(epochs=8, rate=2e-3), tmp_path)
    tuner.network.eval()
    rollout = fly(tuner.network, Critic(), conditions(), 0.5, 1)
    judged = replace(rollout, worth=np.full_like(rollout.worth, worth))
    change = tuner._learn([judged], 2e-3, np.random.default_rng(0))
    assert change * worth < -1e-3


@pytest.mark.slow
def test_a_run_that_was_cut_off_ends_with_the_weights_of_one_that_was_not(tmp_path: Path) -> None:
    class CutError(Exception):
        pass

    def cut(progress: object) -> None:
        raise CutError

    whole = Tuner(tune_options(), tmp_path / "whole").run(lambda progress: None)
    with pytest.raises(CutError):
        Tuner(tune_options(), tmp_path / "cut").run(cut)
    resumed = Tuner(tune_options(), tmp_path / "cut")
    assert resumed.step == 1
    left, right = load_file(whole), load_file(resumed.run(lambda progress: None))
    start = load_file(ahead_run() / "model.safetensors")
    assert all(torch.equal(left[name], right[name]) for name in left)
    assert not all(torch.equal(left[name], start[name]) for name in left)


def test_a_network_that_is_shown_more_says_the_same_at_first(tmp_path: Path) -> None:
    before, _ = load_model(ahead_run())
    tuner = Tuner(tune_options(shown=("tasks",)), tmp_path)
    (group,) = load_groups(ahead_data())[0]
    inputs = tensors_of(batch_of(group, np.arange(500, 520), with_windows=False), before.inputs)  # type: ignore[arg-type]
    with torch.inference_mode():
        assert torch.equal(before(**inputs).scores, tuner.network.eval()(**inputs).scores)
    assert tuner.network.config.tasks


def test_rounds_fly_worlds_of_their_own_beyond_those_of_data_sets(tmp_path: Path) -> None:
    tuner = Tuner(tune_options(), tmp_path)
    first = [seed for part in tuner._conditions(np.random.default_rng(0)) for seed in part.seeds]
    tuner.step = 1
    second = [seed for part in tuner._conditions(np.random.default_rng(0)) for seed in part.seeds]
    assert len({*first, *second}) == 12
    assert min(first) >= FIRST_WORLD >= TRAINING_SEEDS + 268 * SHARDS_PER_SEED * WORLDS_PER_SHARD


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"rounds": 0}, "minutes or rounds"),
        ({"minutes": 1.0}, "minutes or rounds"),
        ({"teams": ("9X",)}, "9X"),
        ({"missions": 1}, "too few"),
        ({"sizes": (3,)}, "size 3"),
        ({"shown": ("maps",)}, "maps"),
        ({"kills": (-1,)}, "killed"),
        ({"ranks": 4}, "4 ranks"),
        ({"ranks": 2}, "started with 1"),
    ],
)
def test_options_that_cannot_be_used_are_named(tmp_path: Path, changes: dict[str, object], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        Tuner(tune_options(**changes), tmp_path)


def test_a_network_that_does_not_look_ahead_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="ahead=true"):
        Tuner(tune_options(run=str(tiny_run())), tmp_path)


def test_a_folder_of_another_run_is_left_alone(tmp_path: Path) -> None:
    Tuner(tune_options(), tmp_path)
    with pytest.raises(ConfigError, match="another run"):
        Tuner(tune_options(rate=1e-3), tmp_path)


@pytest.mark.slow
def test_two_ranks_tune_one_network(tmp_path: Path) -> None:
    """They end with an error where their weights are not the same (`Ranks.check_alike`)."""
    arguments = ["--team", "1A1G", "--missions", "4", "--rounds", "2", "--kills", "1"]
    for name, ranks in (("one", 1), ("two", 2)):
        line = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", str(ranks)]
        line += ["-m", "gatar_edge", "tune", str(ahead_run()), *arguments, "--out", str(tmp_path / name)]
        done = subprocess.run(line, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr[-3000:]
    one, two = (load_file(tmp_path / name / "model.safetensors") for name in ("one", "two"))
    assert all(torch.isfinite(weights).all() for weights in two.values())
    assert any(not torch.equal(weights, one[name]) for name, weights in two.items())
    first = [json.loads((tmp_path / name / "log.jsonl").read_text().splitlines()[0]) for name in ("one", "two")]
    assert len((tmp_path / "two" / "log.jsonl").read_text().splitlines()) == 2
    assert first[0]["choices"] == pytest.approx(first[1]["choices"], rel=0.5)  # the same worlds, all of them


@pytest.mark.slow
def test_the_command_tunes_and_its_curves_are_drawn(tmp_path: Path) -> None:
    out = tmp_path / "tuned"
    arguments = [str(ahead_run()), "--team", "1A1G", "--missions", "3", "--rounds", "2", "--out", str(out)]
    result = CliRunner().invoke(command, arguments)
    assert result.exit_code == 0, result.output
    assert "2 rounds" in result.output
    _, description = load_model(out)
    assert description["train"]["tuned"]["rounds"] == 2
    drawn = CliRunner().invoke(train, ["--plot", str(out)])
    assert drawn.exit_code == 0, drawn.output
    assert "<svg" in (out / "curves.svg").read_text()
