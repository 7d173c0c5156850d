"""Shards made by the workers of a Dask cluster, and written by the process that asked for them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from gatar_edge import __version__
from gatar_edge.errors import ConfigError, LinkError
from gatar_edge.learn.dataset import DataOptions, make_shard, store, stored

CONNECT_TIMEOUT_S = 10.0
WORKER_TIMEOUT_S = 60.0  # a cluster may still be starting its first worker


def entries_from(
    scheduler: str, options: DataOptions, numbers: list[int], folder: Path
) -> Iterator[tuple[int, dict[str, Any]]]:
    """Number and manifest entry of each shard, as they come in; those that are there whole are not made again.

    Raises LinkError where no scheduler answers or no worker comes, ConfigError for workers of another version.
    """
    from distributed import Client, as_completed

    missing = []
    for number in numbers:
        entry = stored(number, folder)
        if entry is None:
            missing.append(number)
        else:
            yield number, entry
    try:
        client = Client(scheduler, timeout=CONNECT_TIMEOUT_S)
    except (OSError, ValueError) as error:
        raise LinkError(f"no Dask scheduler answers at {scheduler}: {_one_line(error)}") from None
    with client:
        _check_workers(client, scheduler)
        jobs = {client.submit(make_shard, options, number, pure=False): number for number in missing}
        for job in as_completed(list(jobs)):
            number = jobs.pop(job)
            yield number, store(options, number, folder, job.result())
            job.release()


def _check_workers(client: Any, scheduler: str) -> None:
    try:
        client.wait_for_workers(1, timeout=WORKER_TIMEOUT_S)
    except TimeoutError:
        raise LinkError(f"the Dask scheduler at {scheduler} has no workers after {WORKER_TIMEOUT_S:g} s") from None
    for worker, version in client.run(version_here, on_error="return").items():
        if version != __version__:
            raise ConfigError(
                f"worker {worker} has gatar-edge {version}, this is {__version__}: install the same there"
            )


def version_here() -> str:
    """Of the package on the machine that runs this."""
    return __version__


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())[:200]
