"""Several ranks under torchrun: the same finite weights on all, other batches on each, and a device for each."""

import json
import subprocess
import sys
from dataclasses import asdict

import pytest
import torch
from learning import TINY, options, tiny_run
from safetensors.torch import load_file

from gatar_edge.errors import ConfigError
from gatar_edge.learn.ranks import device_of, uses_bf16

PROGRAM = """
import json, sys
from pathlib import Path
from safetensors.torch import save_file
from gatar_edge.learn.ranks import joined
from gatar_edge.learn.train import Trainer, TrainOptions

with joined("cpu") as ranks:
    for folder, wanted in json.loads(sys.argv[1]).items():
        folder = Path(folder)
        trainer = Trainer(TrainOptions(**wanted), folder, ranks.device, ranks)
        losses = []
        trainer.run(lambda progress: losses.append(progress.loss), checkpoint_every_s=0.0)
        save_file(trainer.network.state_dict(), folder / f"rank{ranks.rank}.safetensors")
        (folder / f"losses{ranks.rank}.json").write_text(json.dumps(losses))
"""


@pytest.fixture(scope="module")
def two_ranks(tmp_path_factory):
    """A folder with two runs, one after the other under one torchrun, which takes seconds to start."""
    folder = tmp_path_factory.mktemp("ranks")
    script = folder / "train_two.py"
    script.write_text(PROGRAM)
    runs = {"whole": {}, "ablation": {"steps": 2, "settings": {**TINY, "attention": False}}}
    wanted = {str(folder / name): asdict(options(ranks=2, **changes)) for name, changes in runs.items()}
    line = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2", str(script)]
    done = subprocess.run([*line, json.dumps(wanted)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    return folder


@pytest.mark.slow
def test_an_ablation_that_leaves_parameters_unused_does_not_hang(two_ranks):
    assert len(list((two_ranks / "ablation").glob("rank?.safetensors"))) == 2


@pytest.mark.slow
def test_two_ranks_learn_from_other_batches_and_hold_the_same_weights(two_ranks):
    folder = two_ranks / "whole"
    one, other = (load_file(folder / f"rank{rank}.safetensors") for rank in range(2))
    alone = load_file(tiny_run() / "model.safetensors")
    assert one.keys() == other.keys() == alone.keys()
    for name, tensor in one.items():
        assert torch.isfinite(tensor).all()
        assert torch.equal(tensor, other[name])
    assert any(not torch.equal(tensor, alone[name]) for name, tensor in one.items())
    assert (folder / "losses0.json").read_text() != (folder / "losses1.json").read_text()
    assert len(list(folder.glob("log.jsonl"))) == 1


def test_a_cpu_is_used_where_there_is_no_gpu(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert device_of("auto") == "cpu"
    with pytest.raises(ConfigError, match="needs a GPU, 0 can be used"):
        device_of("cuda")


def test_each_rank_takes_a_gpu_of_its_own(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    assert [device_of("auto", rank) for rank in range(2)] == ["cuda:0", "cuda:1"]
    assert device_of("cpu", 1) == "cpu"
    with pytest.raises(ConfigError, match="rank 2 of this machine needs a GPU, 2 can be used"):
        device_of("auto", 2)


@pytest.mark.parametrize(
    ("precision", "device", "expected"),
    [("auto", "cpu", False), ("auto", "cuda:0", True), ("bf16", "cpu", True), ("float32", "cuda:0", False)],
)
def test_bf16_is_used_where_it_helps_or_is_asked_for(precision, device, expected):
    assert uses_bf16(precision, device) is expected
