"""Batches made in a thread of its own, while the network learns from earlier ones."""

from __future__ import annotations

from collections.abc import Iterator
from queue import Full, Queue
from threading import Event, Thread

from gatar_edge.learn.views import Batch, Group, batches

AHEAD = 4  # batches made in advance


class Loader:
    """Makes batches in a thread of its own, a few ahead of the training."""

    def __init__(self, groups: list[Group], size: int, seed: int, first: int, with_windows: bool) -> None:
        self._queue: Queue[Batch | Exception] = Queue(AHEAD)
        self._stop = Event()
        self._thread = Thread(target=self._work, args=(batches(groups, size, seed, first, with_windows),), daemon=True)
        self._thread.start()

    def __next__(self) -> Batch:
        item = self._queue.get()
        if isinstance(item, Exception):
            raise item
        return item

    def close(self) -> None:
        """Stop the thread and wait for it."""
        self._stop.set()
        self._thread.join()

    def _work(self, source: Iterator[Batch]) -> None:
        try:
            for batch in source:
                if not self._put(batch):
                    return
        except Exception as error:  # handed to the trainer, which raises it
            self._put(error)

    def _put(self, item: Batch | Exception) -> bool:
        while not self._stop.is_set():
            try:
                self._queue.put(item, timeout=0.1)
            except Full:
                continue
            return True
        return False
