"""The data and the trained networks behind the tables; what is there already is not made again."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from multiprocessing import get_context
from pathlib import Path

from gatar_edge.learn.curves import share_done
from gatar_edge.learn.dataset import DataOptions, generate
from gatar_edge.learn.ranks import joined
from gatar_edge.learn.train import Trainer, TrainOptions
from gatar_edge.paper.plan import Run, Scale
from gatar_edge.workers import end_with_parent

Progress = Callable[[float, str], None]

# Half of it the team and the range of Table 2, the rest for the curves over teams and ranges
TEAMS = ("6A6G", "6A6G", "3A3G", "6A6G", "1A1G", "6A6G", "2A2G", "4A2G")
R_COMMS = (6.0, 6.0, 6.0, 6.0, 3.0, 5.0, 8.0, 0.0, 10.0)
R_SENSES = (4.0, 4.0, 3.0, 5.0)
WARM_UP = 200  # steps, or a fifth of a short run
LOOK_EVERY_S = 1.0  # at how far the networks are


def make_data(folder: Path, scale: Scale, workers: int, progress: Progress) -> Path:
    """The paper's expert's labels under `folder`. Raises ConfigError where that holds other data."""
    options = DataOptions(
        teams=TEAMS, sizes=(15,), r_comms=R_COMMS, samples=scale.data_samples, seed=0, r_senses=R_SENSES
    )
    generate(options, folder, workers, lambda done, of: progress(done / of, f"data: {done:,} robot-steps"))
    return folder


def train_all(
    runs: Sequence[Run], data: Path, folder: Path, scale: Scale, workers: int, device: str, progress: Progress
) -> dict[str, Path]:
    """The finished runs under `folder`, by name; those that are not are trained to the end, so many at a time.

    `device` as `ranks.joined` takes it. Raises ConfigError where another run is in the place of one.
    """
    places = {run.name: folder / run.name for run in runs}
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=end_with_parent) as pool:
        left = {pool.submit(_train, run, data, places[run.name], scale, device) for run in runs}
        try:
            while left:
                ended, left = wait(left, timeout=LOOK_EVERY_S, return_when=FIRST_COMPLETED)
                for job in ended:
                    job.result()
                share = sum(share_done(place) for place in places.values()) / len(places)
                progress(share, f"{len(runs) - len(left)} of {len(runs)} networks trained")
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
    return places


def _train(run: Run, data: Path, folder: Path, scale: Scale, device: str) -> None:
    """One thread: more of them wait for each other on networks as small as these."""
    options = TrainOptions(
        run.network, str(data), minutes=scale.minutes, steps=scale.steps, batch=scale.batch, threads=1,
        warm_up=min(WARM_UP, 1 + scale.steps // 5) if scale.steps else WARM_UP,
        settings={**run.settings, **scale.sizes.get(run.network, {})},
    )  # fmt: skip
    with joined(device) as ranks:
        trainer = Trainer(options, folder, ranks.device, ranks)
        if trainer.done < 1 or not (folder / "model.json").is_file():
            trainer.run(lambda now: None)
