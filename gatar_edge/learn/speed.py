"""How fast data is made."""

from __future__ import annotations

import time
from dataclasses import dataclass

from gatar_edge.learn.dataset import DataOptions, make_shard
from gatar_edge.learn.labels import NO_LABEL


@dataclass(frozen=True, slots=True)
class Speed:
    """Rates in CPU time of one process."""

    samples_per_s: float  # robot-steps
    labelled_per_s: float  # those to which the teacher gave a target
    bytes_per_sample: float

    def to_json(self) -> dict[str, float]:
        """For machines."""
        return {
            "samples_per_cpu_s": round(self.samples_per_s),
            "labelled_per_cpu_s": round(self.labelled_per_s),
            "bytes_per_sample": round(self.bytes_per_sample, 1),
        }


def measure(options: DataOptions, shards: int) -> Speed:
    """Make shards 1, 2, ... in memory, after shard 0 has compiled everything."""
    make_shard(options, 0)
    samples = labelled = size = 0
    started = time.process_time()
    for number in range(1, shards + 1):
        arrays = make_shard(options, number)
        robots = arrays[1]
        samples += robots.shape[0] * robots.shape[1]
        labelled += int((robots[..., 2] != NO_LABEL).sum())
        size += sum(array.nbytes for array in arrays)
    seconds = max(time.process_time() - started, 1e-9)
    return Speed(samples / seconds, labelled / seconds, size / samples)
