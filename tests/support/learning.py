"""A tiny data set and a tiny finished run, made once for all tests of learning and export."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from tempfile import mkdtemp

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


@cache
def tiny_data() -> Path:
    """A folder with two shards."""
    folder = Path(mkdtemp(prefix="gatar-data-"))
    generate(OPTIONS, folder, workers=1)
    return folder


@cache
def ahead_data() -> Path:
    """A folder with one shard of the teacher that looks ahead."""
    folder = Path(mkdtemp(prefix="gatar-ahead-data-"))
    generate(AHEAD_OPTIONS, folder, workers=1)
    return folder


def options(**changes: object) -> TrainOptions:
    """A run of seconds."""
    values = {"network": "gatar", "data": str(tiny_data()), "steps": 12, "batch": 16, "warm_up": 5, "settings": TINY}
    return TrainOptions(**{**values, **changes})  # type: ignore[arg-type]


@cache
def tiny_run(network: str = "gatar") -> Path:
    """A finished run."""
    folder = Path(mkdtemp(prefix="gatar-run-"))
    Trainer(options(network=network, settings=TINY_OF[network]), folder).run(lambda progress: None)
    return folder


@cache
def ahead_model() -> Path:
    """The ONNX file of a finished run of a network that looks ahead."""
    from gatar_edge.export.convert import export

    folder = Path(mkdtemp(prefix="gatar-ahead-run-"))
    Trainer(options(data=str(ahead_data()), settings=TINY_AHEAD), folder).run(lambda progress: None)
    export(folder, folder / "ahead.onnx")
    return folder / "ahead.onnx"
