"""What options of several commands share."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import click


class FiniteRange(click.FloatRange):
    """A range of numbers that are numbers: click's own lets `nan` through, which is on no side of any limit."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """See `click.ParamType`."""
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value!r} is no finite number", param, ctx)
        return number


def anchored(allocator: str) -> str:
    """The allocator with the model of "gatar:FILE" where the caller stands, for a file in another folder."""
    rule, _, file = allocator.partition(":")
    return f"{rule}:{Path(file).absolute()}" if file else allocator
