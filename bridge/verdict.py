"""What one check of `doctor` found."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Level(StrEnum):
    """How bad it is."""

    OK = "OK"
    WARN = "WARN"  # it would work, and somebody should know
    FAIL = "FAIL"  # the daemon could not drive the vehicle, or commands would go wrong in silence


@dataclass(frozen=True, slots=True)
class Finding:
    """One sentence, and what to do about it."""

    level: Level
    text: str
    mend: str = ""


def ok(text: str) -> Finding:
    """All is well."""
    return Finding(Level.OK, text)


def warn(text: str, mend: str) -> Finding:
    """It would work."""
    return Finding(Level.WARN, text, mend)


def fail(text: str, mend: str) -> Finding:
    """It would not."""
    return Finding(Level.FAIL, text, mend)
