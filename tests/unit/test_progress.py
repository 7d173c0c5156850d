"""What the learning commands tell of their progress where there is no terminal."""

from __future__ import annotations

import pytest

from gatar_edge.commands import _learn
from gatar_edge.commands._learn import bar
from gatar_edge.commands.dataset import _with_rate


class Clock:
    """Stands still until it is set."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def monotonic(self) -> float:
        return self.now_s


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(_learn.time, "monotonic", clock.monotonic)
    return clock


def test_time_left_does_not_count_what_an_earlier_call_did(clock: Clock, capsys: pytest.CaptureFixture[str]) -> None:
    with bar("train", "") as show:
        for now_s, share in ((1.0, 0.8), (5.0, 0.85), (11.0, 0.9), (31.0, 1.0)):
            clock.now_s = now_s
            show(share, "step")
    assert capsys.readouterr().err.splitlines() == [
        "train 80 %: step, 1 s",
        "train 90 %: step, 11 s, 10 s left",
        "train 100 %: step, 31 s",
    ]


def test_data_are_told_with_their_rate(clock: Clock) -> None:
    told: list[tuple[float, str]] = []
    progress = _with_rate(lambda share, text: told.append((share, text)))
    for shard in range(1, 31):
        clock.now_s += 0.1 if shard <= 10 else 2.0  # the first ones were there already
        progress(shard * 2048, 60 * 2048)
    assert told[-1] == (0.5, "61,440 robot-steps, 1,024 a second")
