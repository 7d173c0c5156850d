"""The one way in which functions of this package are compiled: cached on disk, without the interpreter's lock."""

from __future__ import annotations

from collections.abc import Callable
from typing import ParamSpec, TypeVar, cast

from numba import njit

P = ParamSpec("P")
R = TypeVar("R")


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """`function` compiled by numba, with its type kept for the type checker."""
    return cast("Callable[P, R]", njit(cache=True, nogil=True)(function))
