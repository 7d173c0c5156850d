"""Which allocator a replay runs: the one that flew, proved by its digest, or another on purpose."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path

from gatar_edge.allocators.base import Allocator
from gatar_edge.allocators.registry import make
from gatar_edge.errors import LogError, ModelError
from gatar_edge.review.explain import Json

LEARNED = "gatar"


def allocator_for(info: Json, other: str | None, model: Path | None) -> tuple[Callable[[str], Allocator], bool]:
    """How to make a robot's allocator by its recorded name, and whether it is another than flew.

    Raises LogError where the model that flew is not at hand, ModelError or ConfigError where the other is of no use.
    """
    if other is not None:
        named = f"{LEARNED}:{model}" if model is not None else other
        factory = make(named)
        return (lambda _: factory()), True
    flown, digest = str(info.get("allocator", "")), str(info.get("model_sha256", ""))
    if model is not None:
        factory = make(f"{LEARNED}:{model}")
        return (lambda _: factory()), not digest or sha256_of(model) != digest
    rule, _, path = flown.partition(":")
    if rule == LEARNED and digest:
        _check_model(path, digest)
    factory = make(flown)
    return (lambda _: factory()), False


def sha256_of(path: Path) -> str:
    """The digest by which a log names its model. Raises ModelError."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise ModelError(f"model {path} cannot be read: {error.strerror}") from error


def _check_model(path: str, digest: str) -> None:
    if path and Path(path).is_file() and sha256_of(Path(path)) != digest:
        raise LogError(f"{path} is not the model that flew (sha256 {digest[:12]}): give that one with --model")
