"""Log lines for people and journald: `level what key=value ...`, and repeated ones at most once in ten seconds."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Protocol

from gatar_edge.foxglove import Level
from gatar_edge.types import NS_PER_S

REPEAT_NS = 10 * NS_PER_S
MAX_KINDS = 256  # of lines remembered for the limit

Value = str | int | float | bool | None


class TextLog(Protocol):
    """Where lines are kept with the mission: see `record.Recorder.text`."""

    def text(self, level: Level, robot_id: int, text: str, now_ns: int) -> None: ...


@dataclass(slots=True)
class _Said:
    when_ns: int
    suppressed: int = 0


class Journal:
    """Says things once, and how often it did not say them."""

    def __init__(self, robot_id: int, log: TextLog | None = None) -> None:
        self._robot_id = robot_id
        self._log = log
        self._logger = logging.getLogger("gatar")
        self._said: dict[str, _Said] = {}

    def info(self, what: str, now_ns: int, **values: Value) -> None:
        """Something worth knowing happened."""
        self._say(Level.INFO, what, now_ns, values)

    def note(self, what: str, now_ns: int) -> None:
        """Something for the mission log alone."""
        if self._log is not None:
            self._log.text(Level.DEBUG, self._robot_id, what, now_ns)

    def warning(self, what: str, now_ns: int, **values: Value) -> None:
        """Something is not as it should be; the robot copes."""
        self._say(Level.WARNING, what, now_ns, values)

    def error(self, what: str, now_ns: int, **values: Value) -> None:
        """Something is wrong, and a person should look."""
        self._say(Level.ERROR, what, now_ns, values)

    def _say(self, level: Level, what: str, now_ns: int, values: dict[str, Value]) -> None:
        said = self._said.get(what)
        if said is not None and now_ns - said.when_ns < REPEAT_NS:
            said.suppressed += 1
            return
        if said is not None and said.suppressed:
            values = {**values, "suppressed": said.suppressed}
        if said is None and len(self._said) >= MAX_KINDS:
            self._said.pop(next(iter(self._said)))
        self._said[what] = _Said(now_ns)
        line = " ".join([what, *(f"{name}={_shown(value)}" for name, value in values.items())])
        self._logger.log(logging.getLevelNamesMapping()[level.name], line)
        if self._log is not None:
            self._log.text(level, self._robot_id, line, now_ns)


def _shown(value: Value) -> str:
    text = f"{value:.6g}" if isinstance(value, float) else str(value)
    text = "".join(char if char.isprintable() else "?" for char in text)[:300]
    return f'"{text}"' if " " in text or not text else text
