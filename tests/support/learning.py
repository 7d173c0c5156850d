"""A tiny data set and a tiny finished run, made once for all tests of learning and export."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from made_once import made_once

from gatar_edge.learn.dataset import DataOptions, generate
from gatar_edge.learn.train import Trainer, TrainOptions

OPTIONS = DataOptions(("1A1G", "2A2G"), (15,), (6.0, 3.0), 6 * 1024, 5)
AHEAD_OPTIONS = DataOptions(("2A2G",), (15,), (3.0, 6.0), 1, 5, teacher="foresight")
TINY = {"width": 8, "heads": 2, "levels": [1, 2, 1], "conv_channels": 2}
TINY_AHEAD = {**TINY, "ahead": True, "tour": True, "tasks": True, "ages": True}
_SHAPE = {"width": 16, "conv_channels": 2, "hidden": 8}
TINY_OF = {
    "gatar": TINY,
    "gatar-paper": {**_SHAPE, "heads": 2, "bottom": 4},
    "gat": {**_SHAPE, "heads": 2},
    "gnn": _SHAPE,
    "gnn-vcycle": {**_SHAPE, "bottom": 4},
    "magat": {**_SHAPE, "heads": 2},
}  # every network of the registry, small enough to train in seconds
_ONE_ROUND = {**TINY_AHEAD, "levels": [2]}  # as far as robots out of range; each further round takes seconds to export


@cache
def tiny_data() -> Path:
    """A folder with two shards."""
    return made_once("data", lambda folder: generate(OPTIONS, folder, workers=1))


@cache
def ahead_data() -> Path:
    """A folder with one shard of the teacher that looks ahead."""
    return made_once("ahead-data", lambda folder: generate(AHEAD_OPTIONS, folder, workers=1))


def options(**changes: object) -> TrainOptions:
    """A run of seconds."""
    values = {"network": "gatar", "data": str(tiny_data()), "steps": 12, "batch": 16, "warm_up": 5, "settings": TINY}
    return TrainOptions(**{**values, **changes})  # type: ignore[arg-type]


@cache
def tiny_run(network: str = "gatar") -> Path:
    """A finished run. Nobody may write into it."""
    run = options(network=network, settings=TINY_OF[network])
    return made_once(f"run-{network}", lambda folder: Trainer(run, folder).run(lambda progress: None))


@cache
def tiny_model() -> Path:
    """The ONNX file of that run, with its weights beside it. Nobody may write there."""
    from gatar_edge.export.convert import export

    return made_once("model", lambda folder: export(tiny_run(), folder / "tiny.onnx")) / "tiny.onnx"


@cache
def ahead_model() -> Path:
    """The ONNX file of a finished run of a network that looks ahead."""
    from gatar_edge.export.convert import export

    def make(folder: Path) -> None:
        run = options(data=str(ahead_data()), settings=_ONE_ROUND)
        Trainer(run, folder / "run").run(lambda progress: None)
        export(folder / "run", folder / "ahead.onnx")

    return made_once("ahead-model", make) / "ahead.onnx"
