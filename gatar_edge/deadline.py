"""An allocator that answers in time or not at all: it works in a thread of its own, and the robot does not wait for it.

A model that is late is left to finish; until it has, each tick is decided by the fallback at once. One that never
returns costs the robot its model, not its loop.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from typing import Protocol

from gatar_edge.allocators.base import Allocation, Allocator, Negotiator
from gatar_edge.errors import DeadlineError
from gatar_edge.view import View

Job = Callable[[], Allocation]


class Runner(Protocol):
    """Runs one job within a time. Raises DeadlineError where that did not suffice, and what the job raises."""

    @property
    def busy(self) -> bool: ...
    def run(self, job: Job, timeout_s: float) -> Allocation: ...


def punctual(allocator: Allocator, deadline_s: float, runner: Runner) -> Punctual:
    """The allocator with a deadline, and with its talk where it talks to its like."""
    if isinstance(allocator, Negotiator):
        return PunctualNegotiator(allocator, deadline_s, runner)
    return Punctual(allocator, deadline_s, runner)


class Punctual:
    """An `Allocator` with a deadline; the agent's fallback steps in where it raises."""

    def __init__(self, allocator: Allocator, deadline_s: float, runner: Runner) -> None:
        self._allocator = allocator
        self._deadline_s = deadline_s
        self._runner = runner

    @property
    def name(self) -> str:
        """The name of the allocator within."""
        return self._allocator.name

    def allocate(self, view: View) -> Allocation:
        """The allocator's proposal. Raises DeadlineError where it is late, or busy with an earlier view."""
        return self._runner.run(lambda: self._allocator.allocate(view), self._deadline_s)


class PunctualNegotiator(Punctual):
    """The same for a `Negotiator`, which neither talks nor listens while its thread is still at work on a late view."""

    def __init__(self, allocator: Negotiator, deadline_s: float, runner: Runner) -> None:
        super().__init__(allocator, deadline_s, runner)
        self._negotiator = allocator

    def bid(self, view: View) -> tuple[bytes, ...]:
        """See `Negotiator.bid`."""
        return () if self._runner.busy else self._negotiator.bid(view)

    def heard(self, payload: bytes, now_ns: int) -> None:
        """See `Negotiator.heard`."""
        if not self._runner.busy:
            self._negotiator.heard(payload, now_ns)


class ThreadRunner:
    """One worker thread, which does not keep the process alive."""

    def __init__(self) -> None:
        self._jobs: queue.SimpleQueue[Job] = queue.SimpleQueue()
        self._results: queue.SimpleQueue[Allocation | Exception] = queue.SimpleQueue()
        self._busy = False  # with a job whose result nobody waits for any more
        threading.Thread(target=self._work, name="allocator", daemon=True).start()

    @property
    def busy(self) -> bool:
        """Whether a job that was late is still at work."""
        return self._busy and self._results.empty()

    def run(self, job: Job, timeout_s: float) -> Allocation:
        """See `Runner`."""
        if self.busy:
            raise DeadlineError("the allocator is still busy with an earlier tick")
        if self._busy:
            self._results.get()  # the late one: of a world that is past
        self._jobs.put(job)
        self._busy = True
        try:
            result = self._results.get(timeout=timeout_s)
        except queue.Empty:
            raise DeadlineError(f"the allocator took more than {timeout_s * 1000:g} ms") from None
        self._busy = False
        if isinstance(result, Exception):
            raise result
        return result

    def _work(self) -> None:
        while True:
            job = self._jobs.get()
            try:
                self._results.put(job())
            except Exception as error:  # handed to who asked
                self._results.put(error)
