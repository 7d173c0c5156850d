"""The data and the trained networks behind the tables; what is there already is not made again."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from gatar_edge.learn.dataset import DataOptions, generate
from gatar_edge.learn.train import Trainer, TrainOptions
from gatar_edge.paper.plan import Run, Scale

Progress = Callable[[float, str], None]

# Half of it the team and the range of Table 2, the rest for the curves over teams and ranges
TEAMS = ("6A6G", "6A6G", "3A3G", "6A6G", "1A1G", "6A6G", "2A2G", "4A2G")
R_COMMS = (6.0, 6.0, 6.0, 6.0, 3.0, 5.0, 8.0, 0.0, 10.0)
R_SENSES = (4.0, 4.0, 3.0, 5.0)
WARM_UP = 200  # steps, or a fifth of a short run


def make_data(folder: Path, scale: Scale, workers: int, progress: Progress) -> Path:
    """The paper's expert's labels under `folder`. Raises ConfigError where that holds other data."""
    options = DataOptions(
        teams=TEAMS, sizes=(15,), r_comms=R_COMMS, samples=scale.data_samples, seed=0, r_senses=R_SENSES
    )
    generate(options, folder, workers, lambda done, of: progress(done / of, f"data: {done:,} robot-steps"))
    return folder


def train(run: Run, data: Path, folder: Path, scale: Scale, progress: Progress) -> Path:
    """The finished run under `folder`, trained to the end if it is not. Raises ConfigError where another run is there.

    One thread: more of them wait for each other on networks as small as these.
    """
    options = TrainOptions(
        run.network, str(data), minutes=scale.minutes, steps=scale.steps, batch=scale.batch, threads=1,
        warm_up=min(WARM_UP, 1 + scale.steps // 5) if scale.steps else WARM_UP,
        settings={**run.settings, **scale.sizes.get(run.network, {})},
    )  # fmt: skip
    trainer = Trainer(options, folder)
    if trainer.done >= 1 and (folder / "model.json").is_file():
        return folder
    trainer.run(lambda now: progress(now.done, f"{run.name}: step {now.step}, loss {now.loss:.3f}"))
    return folder
