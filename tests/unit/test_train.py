"""The training loop: it learns, repeats itself, and goes on where it was cut off."""

import json
import shutil
import signal
import subprocess
import sys
from dataclasses import asdict
from itertools import islice

import pytest
import torch
from click.testing import CliRunner
from learning import TINY_AHEAD, TINY_OF, ahead_data, options, tiny_data, tiny_run
from safetensors.torch import load_file

from gatar_edge.commands.train import command
from gatar_edge.errors import ConfigError
from gatar_edge.learn.networks import NETWORKS, build
from gatar_edge.learn.train import Trainer, load_model, loss_of, tensors_of
from gatar_edge.learn.views import batches

pytestmark = pytest.mark.slow


class CutError(Exception):
    """Stands for a power cut."""


def cut_after(step):
    def report(progress):
        if progress.step == step:
            raise CutError

    return report


def same(one, other):
    left, right = load_file(one), load_file(other)
    return left.keys() == right.keys() and all(torch.equal(left[name], right[name]) for name in left)


def loss_before_and_after(run, folder):
    trainer = Trainer(run, folder)

    def loss():  # over the same views before and after: some are far harder than others
        with torch.inference_mode():
            judged = islice(batches(trainer.groups, 32, seed=1), 8)
            return sum(
                float(loss_of(trainer.network(**tensors_of(batch, trainer.network.inputs)), batch)) for batch in judged
            )

    before = loss()
    trainer.run(lambda progress: None)
    return before, loss()


@pytest.mark.parametrize("network", sorted(NETWORKS))
def test_the_loss_of_every_network_falls(network, tmp_path):
    run = options(network=network, settings=TINY_OF[network], steps=60, rate=5e-3)
    before, after = loss_before_and_after(run, tmp_path)
    assert after < 0.8 * before


def test_the_loss_of_a_network_that_looks_ahead_falls(tmp_path):
    run = options(data=str(ahead_data()), settings=TINY_AHEAD, steps=60, rate=5e-3)
    before, after = loss_before_and_after(run, tmp_path)
    assert after < 0.8 * before


def test_the_same_seed_gives_the_same_weights(tmp_path):
    weights = Trainer(options(), tmp_path).run(lambda progress: None)
    assert same(weights, tiny_run() / "model.safetensors")


def test_another_seed_gives_other_weights(tmp_path):
    weights = Trainer(options(seed=1), tmp_path).run(lambda progress: None)
    assert not same(weights, tiny_run() / "model.safetensors")


def test_a_run_that_was_cut_off_ends_with_the_weights_of_one_that_was_not(tmp_path):
    with pytest.raises(CutError):
        Trainer(options(), tmp_path).run(cut_after(7), checkpoint_every_s=0.0)
    again = Trainer(options(), tmp_path)
    assert 0 < again.step < 12
    assert same(again.run(lambda progress: None), tiny_run() / "model.safetensors")


def test_a_run_goes_on_when_its_data_were_moved(tmp_path):
    moved = tmp_path / "moved"
    shutil.copytree(tiny_data(), moved)
    Trainer(options(), tmp_path / "run")
    assert Trainer(options(data=str(moved)), tmp_path / "run").step == 0
    with pytest.raises(ConfigError, match="another run"):
        Trainer(options(data=str(ahead_data())), tmp_path / "run")


def test_a_run_that_was_killed_ends_with_the_weights_of_one_that_was_not(tmp_path):
    program = (
        "import json, os, signal, sys\n"
        "from pathlib import Path\n"
        "from gatar_edge.learn.train import Trainer, TrainOptions\n"
        "def report(progress):\n"
        "    if progress.step == 7:\n"
        "        os.kill(os.getpid(), signal.SIGKILL)\n"
        "Trainer(TrainOptions(**json.loads(sys.argv[1])), Path(sys.argv[2])).run(report, checkpoint_every_s=0.0)\n"
    )
    line = [sys.executable, "-c", program, json.dumps(asdict(options())), str(tmp_path)]
    assert subprocess.run(line, check=False).returncode == -signal.SIGKILL
    again = Trainer(options(), tmp_path)
    assert 0 < again.step < 12
    assert same(again.run(lambda progress: None), tiny_run() / "model.safetensors")


def test_the_folder_of_another_run_is_refused(tmp_path):
    Trainer(options(), tmp_path)
    with pytest.raises(ConfigError, match="another run"):
        Trainer(options(rate=1.0), tmp_path)


def test_a_run_needs_exactly_one_end(tmp_path):
    with pytest.raises(ConfigError, match="minutes or steps"):
        Trainer(options(steps=0), tmp_path)
    with pytest.raises(ConfigError, match="minutes or steps"):
        Trainer(options(minutes=1.0), tmp_path)


def test_a_run_of_two_ranks_is_not_started_by_one(tmp_path):
    with pytest.raises(ConfigError, match="2 ranks was started with 1"):
        Trainer(options(ranks=2), tmp_path)


def test_bf16_learns_other_weights_that_are_finite(tmp_path):
    weights = Trainer(options(bf16=True), tmp_path).run(lambda progress: None)
    assert not same(weights, tiny_run() / "model.safetensors")
    assert all(torch.isfinite(tensor).all() for tensor in load_file(weights).values())


def test_a_run_by_the_clock_ends(tmp_path):
    trainer = Trainer(options(steps=0, minutes=0.01), tmp_path)
    trainer.run(lambda progress: None)
    assert trainer.seconds >= 0.6


def test_an_unfinished_run_has_no_model(tmp_path):
    with pytest.raises(ConfigError, match="not a finished training run"):
        load_model(tmp_path)


@pytest.mark.parametrize(
    ("name", "left"), [("model.safetensors", b"half of the we"), ("model.json", b"{}"), ("model.json", b'{"netw')]
)
def test_a_damaged_finished_run_is_one_clear_line(name, left, tmp_path):
    for whole in ("model.json", "model.safetensors"):
        (tmp_path / whole).write_bytes((tiny_run() / whole).read_bytes())
    (tmp_path / name).write_bytes(left)
    with pytest.raises(ConfigError, match=r"not a finished training run|not of one run"):
        load_model(tmp_path)


def test_a_damaged_checkpoint_is_named_and_kept(tmp_path):
    Trainer(options(), tmp_path)
    (tmp_path / "checkpoint.safetensors").write_bytes(b"half of the we")
    with pytest.raises(ConfigError, match="remove it to begin this run anew"):
        Trainer(options(), tmp_path)
    assert (tmp_path / "checkpoint.safetensors").is_file()


def test_a_finished_run_says_what_it_is():
    network, description = load_model(tiny_run())
    assert not network.training
    assert description["parameters"] == sum(p.numel() for p in network.parameters())
    assert description["train"]["steps"] == 12
    lines = [json.loads(line) for line in (tiny_run() / "log.jsonl").read_text().splitlines()]
    assert [line["step"] for line in lines] == [12]
    assert lines[0]["loss"] > 0


@pytest.mark.parametrize(("name", "settings"), [("other", {}), ("gatar", {"breadth": 3})])
def test_an_unknown_network_or_setting_is_named(name, settings):
    with pytest.raises(ConfigError, match=r"other|breadth"):
        build(name, settings)


@pytest.mark.parametrize(
    ("name", "settings", "said"),
    [
        ("gatar", {"width": -3}, "width is -3"),
        ("gatar", {"width": 33}, "width is 33, must be a multiple of heads, 4"),
        ("gatar", {"width": "wide"}, 'width is "wide"'),
        ("gatar", {"maps": 3}, "maps is 3, must be like true"),
        ("gatar", {"levels": []}, r"levels is \[\]"),
        ("gatar", {"levels": [1, 0]}, r"levels is \[1, 0\]"),
        ("gatar", {"channels": [True]}, "channels are 4, got 1"),
        ("gat", {"heads": 0}, "heads is 0"),
        ("gatar-paper", {"bottom": 6}, "bottom is 6, must be a multiple of heads, 4"),
    ],
)
def test_a_setting_with_which_a_network_could_not_run_is_refused(name, settings, said):
    with pytest.raises(ConfigError, match=said):
        build(name, settings)


@pytest.mark.parametrize(
    "wrong", [["--rate", "nan"], ["--epochs", "inf"], ["--minutes", "inf"], ["--steps", "-1"], ["--rate", "0"]]
)
def test_a_number_with_which_nothing_can_be_learned_is_wrong_usage(wrong, tmp_path):
    result = CliRunner().invoke(command, ["--data", str(tiny_data()), "--out", str(tmp_path / "run"), *wrong])
    assert result.exit_code == 2
    assert f"Invalid value for '{wrong[0]}'" in result.output
    assert not (tmp_path / "run").exists()
