"""What the learning commands share: a clear word about missing parts, and a progress display."""

from __future__ import annotations

import importlib.util
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import click

from gatar_edge.errors import MissingExtraError

LINE_EVERY_S = 10.0


def need(command: str, *modules: str, extra: str = "learn") -> None:
    """Raise MissingExtraError for the first of `modules` that is not installed."""
    for module in modules:
        if importlib.util.find_spec(module) is None:
            raise MissingExtraError(command, extra, module)


Show = Callable[[float, str], None]


@contextmanager
def bar(title: str, unit: str) -> Iterator[Show]:
    """A function (share done, text) that draws a bar with the time left on a terminal, and plain lines elsewhere."""
    if sys.stderr.isatty():
        yield from _terminal(title, unit)
    else:
        yield _lines(title, unit)


def _terminal(title: str, unit: str) -> Iterator[Show]:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    columns = (
        TextColumn(title), BarColumn(), TextColumn("{task.percentage:>3.0f}%"),
        TextColumn("{task.description} " + unit), TimeElapsedColumn(), TimeRemainingColumn(),
    )  # fmt: skip
    with Progress(*columns, console=Console(stderr=True)) as progress:
        task = progress.add_task("", total=1.0)
        yield lambda share, text: progress.update(task, completed=min(1.0, share), description=text)


def _lines(title: str, unit: str) -> Show:
    """The time left is told by what was done since the last line: what an earlier call did took no time of this one."""
    started = time.monotonic()
    last: tuple[float, float] | None = None  # when a line was written, and the share that was done

    def show(share: float, text: str) -> None:
        nonlocal last
        now = time.monotonic() - started
        if share < 1 and last is not None and now - last[0] < LINE_EVERY_S:
            return
        left = ""
        if last is not None and last[1] < share < 1:
            left = f", {(now - last[0]) / (share - last[1]) * (1 - share):.0f} s left"
        last = now, share
        click.echo(f"{title} {100 * min(1.0, share):.0f} %: {f'{text} {unit}'.rstrip()}, {now:.0f} s{left}", err=True)

    return show
