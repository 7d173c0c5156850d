"""A model that is late, stuck or broken costs its own decision, never the robot's tick."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import numpy as np
import pytest

from gatar_edge.allocators.base import Allocation, Negotiator
from gatar_edge.deadline import Punctual, ThreadRunner, punctual
from gatar_edge.errors import DeadlineError, ModelError
from gatar_edge.types import RobotKind, RobotState
from gatar_edge.view import View, build_view

ANSWER = Allocation(np.array([0], np.int32), np.zeros((1, 1), np.float32))


class Model:
    """Waits for `gate` before it answers."""

    name = "gatar"

    def __init__(self) -> None:
        self.begun, self.gate = threading.Event(), threading.Event()
        self.calls = 0

    def allocate(self, view: View) -> Allocation:
        self.calls += 1
        self.begun.set()
        assert self.gate.wait(60)
        return ANSWER


@pytest.fixture
def model() -> Iterator[Model]:
    model = Model()
    yield model
    model.gate.set()  # let the thread end


VIEW = build_view(0, RobotState(1, RobotKind.UAV, (0, 0), 1.0), [], np.zeros((3, 3), np.uint8), 6.0, 2, 64)


def test_an_answer_in_time_is_passed_on(model: Model) -> None:
    model.gate.set()
    punctual = Punctual(model, 60, ThreadRunner())
    assert punctual.name == "gatar"
    assert punctual.allocate(VIEW) is ANSWER
    assert punctual.allocate(VIEW) is ANSWER


def test_a_stuck_model_is_late_once_and_then_busy_without_any_wait(model: Model) -> None:
    runner = ThreadRunner()
    with pytest.raises(DeadlineError, match="more than 1 ms"):
        Punctual(model, 0.001, runner).allocate(VIEW)
    with pytest.raises(DeadlineError, match="busy"):
        Punctual(model, 60, runner).allocate(VIEW)
    assert model.begun.wait(60)  # its thread may come to run late
    assert model.calls == 1


def test_a_late_answer_is_thrown_away_and_the_model_used_again(model: Model) -> None:
    runner = ThreadRunner()
    with pytest.raises(DeadlineError):
        runner.run(lambda: model.allocate(VIEW), 0.001)
    model.gate.set()
    runner._results.put(runner._results.get(timeout=60))  # wait until it has come
    fresh = Allocation(np.array([0], np.int32), np.ones((1, 1), np.float32))
    assert runner.run(lambda: fresh, 60) is fresh


class Talker(Model):
    """A model that talks to its like."""

    def __init__(self) -> None:
        super().__init__()
        self.told: list[bytes] = []

    def bid(self, view: View) -> tuple[bytes, ...]:
        return (b"bid",)

    def heard(self, payload: bytes, now_ns: int) -> None:
        self.told.append(payload)


def test_an_allocator_that_talks_goes_on_talking_but_not_while_it_is_late() -> None:
    talker = Talker()
    wrapped = punctual(talker, 0.001, ThreadRunner())
    assert isinstance(wrapped, Negotiator)
    wrapped.heard(b"one", 0)
    assert wrapped.bid(VIEW) == (b"bid",)
    with pytest.raises(DeadlineError):
        wrapped.allocate(VIEW)
    wrapped.heard(b"two", 0)
    assert wrapped.bid(VIEW) == ()
    talker.gate.set()
    assert talker.told == [b"one"]


def test_an_allocator_that_does_not_talk_is_not_taken_for_one_that_does(model: Model) -> None:
    assert not isinstance(punctual(model, 1, ThreadRunner()), Negotiator)


def test_what_the_model_raises_reaches_the_agent() -> None:
    def fail() -> Allocation:
        raise ModelError("broken")

    with pytest.raises(ModelError, match="broken"):
        ThreadRunner().run(fail, 60)
