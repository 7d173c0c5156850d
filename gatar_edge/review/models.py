"""Which allocator a replay runs: the one that flew, proved by its digest, or another on purpose."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from gatar_edge.allocators.base import Allocator
from gatar_edge.allocators.registry import make
from gatar_edge.errors import ConfigError, LogError
from gatar_edge.review.company import Json
from gatar_edge.runinfo import LEARNED, model_file, sha256_of


def allocator_for(info: Json, other: str | None, model: Path | None) -> tuple[Callable[[str], Allocator], bool]:
    """How to make a robot's allocator by its recorded name, and whether it is another than flew.

    Raises LogError where the model that flew is not at hand, ModelError or ConfigError where the other is of no use.
    """
    if model is not None and other not in (None, LEARNED):
        raise ConfigError(f"a model is for the allocator {LEARNED}, not {other}: leave one of them out")
    flown, digest = str(info.get("allocator", "")), str(info.get("model_sha256", ""))
    if other is None and model is None:
        _check_model(flown, str(info.get("model", "")), digest)
        named = flown
    else:
        named = f"{LEARNED}:{model}" if model is not None else str(other)
    factory = make(named)
    same = named == flown or (model is not None and flown.startswith(LEARNED) and sha256_of(model) == digest)
    return (lambda _: factory()), not same


def _check_model(flown: str, name: str, digest: str) -> None:
    """The model under the recorded name must be the one that flew."""
    path = model_file(flown)
    if path is None or not digest:
        return
    if not path.is_file() or sha256_of(path) != digest:
        raise LogError(f"the model that flew is {name or path.name}, sha256 {digest[:16]}: give that file with --model")
