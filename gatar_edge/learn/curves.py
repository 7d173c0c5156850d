"""The curves of a run: written to `log.jsonl` as it learns, read and drawn later."""

from __future__ import annotations

import json
from pathlib import Path
from types import TracebackType
from typing import Any

from gatar_edge.errors import ConfigError

LOG = "log.jsonl"
EVERY = 20  # steps of training that make one line
MEANS = ("loss", "exact")  # of training
_PANELS = (
    ("loss", "loss", "tab:blue"),
    ("exact", "exact targets of ego", "tab:green"),
    ("excess", "steps, against one who knows all", "tab:blue"),
    ("change", "change of a choice, nats", "tab:green"),
    ("rate", "rate", "tab:gray"),
)  # a run has the first two, or the next two


class Curves:
    """Appends a line for every so many steps, after those up to `step`: what came later was never saved.

    Of `means` a line has the mean over its steps, of all else what the last step had.
    """

    def __init__(
        self, folder: Path, step: int, writes: bool = True, every: int = EVERY, means: tuple[str, ...] = MEANS
    ) -> None:
        self._every, self._means = every, means
        self._path = folder / LOG
        self._writes = writes
        self._steps: list[dict[str, Any]] = []
        if writes:
            kept = [line for line in _lines(self._path) if line["step"] <= step] if self._path.is_file() else []
            new = folder / "log.new"
            new.write_text("".join(json.dumps(line) + "\n" for line in kept))
            new.replace(self._path)

    def __enter__(self) -> Curves:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._steps and kind is None:
            self._write()

    def add(self, progress: dict[str, Any]) -> None:
        """One step."""
        if not self._writes:
            return
        self._steps.append(progress)
        if progress["step"] % self._every == 0:
            self._write()

    def _write(self) -> None:
        line = {
            **self._steps[-1],
            **{name: sum(s[name] for s in self._steps) / len(self._steps) for name in self._means},
        }
        self._steps = []
        with self._path.open("a", encoding="utf-8") as log:
            log.write(json.dumps(line) + "\n")


def _lines(path: Path) -> list[dict[str, Any]]:
    """Whole lines; a killed run leaves half a line at the end."""
    found = []
    for text in path.read_text(encoding="utf-8").splitlines():
        try:
            line = json.loads(text)
        except ValueError:
            break
        found.append(line)
    return found


def read(folder: Path) -> list[dict[str, Any]]:
    """The lines of a run's log. Raises ConfigError where there is none."""
    try:
        lines = _lines(folder / LOG)
    except OSError as error:
        raise ConfigError(f"{folder} holds no training run: {error}") from None
    if not lines:
        raise ConfigError(f"{folder / LOG} holds no step yet")
    return lines


def share_done(folder: Path) -> float:
    """How much of a run is behind, by its log: 0..1."""
    lines = _lines(folder / LOG) if (folder / LOG).is_file() else []
    return float(lines[-1]["done"]) if lines else 0.0


def plot(folder: Path, out: Path) -> None:
    """Draw what a run learned, and its rate, over its steps: SVG, PNG or PDF by the name. Raises ConfigError."""
    from matplotlib.figure import Figure  # without pyplot: no display is looked for

    lines = read(folder)
    steps = [line["step"] for line in lines]
    figure = Figure(figsize=(8, 7.5), layout="constrained")
    axes = figure.subplots(3, 1, sharex=True, height_ratios=(3, 3, 1))
    shown = [panel for panel in _PANELS if panel[0] in lines[0]]
    for axis, (name, label, colour) in zip(axes, shown, strict=True):
        values = [float(line.get(name, 0.0)) for line in lines]
        axis.set_ylabel(label)
        axis.grid(alpha=0.3)
        if name == "rate":
            axis.plot(steps, values, color=colour)
            axis.set_ylim(bottom=0)
            continue
        axis.plot(steps, values, color=colour, alpha=0.25, linewidth=0.8)
        smoothed = _smoothed(values)
        axis.plot(steps, smoothed, color=colour, label=f"last {smoothed[-1]:.3f}")
        axis.legend(loc="lower right" if name == "exact" else "upper right")
        if name == "exact":
            axis.set_ylim(top=1.0)
        elif name == "loss" and min(values) > 0:
            axis.set_yscale("log")
            axis.yaxis.set_major_formatter("{x:g}")
            axis.yaxis.set_minor_formatter("{x:g}")
    axes[-1].set_xlabel("step")
    axes[0].set_title(f"{folder.name}: {steps[-1]} steps, {lines[-1]['seconds'] / 60:.1f} minutes")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(out, metadata={"Date": None} if out.suffix == ".svg" else None)
    except (OSError, ValueError) as error:
        raise ConfigError(f"cannot draw {out}: {error}") from None


def _smoothed(values: list[float]) -> list[float]:
    """Mean over a window in the middle of which each value stands, a twentieth of the run wide."""
    reach = len(values) // 40 + 1
    windows = (values[max(0, index - reach) : index + reach + 1] for index in range(len(values)))
    return [sum(window) / len(window) for window in windows]
