"""What flew: the description that every log carries, so that it can be explained and replayed without anything else."""

from __future__ import annotations

import hashlib
import platform
import subprocess
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import msgspec

from gatar_edge import __version__
from gatar_edge.agent import Identity
from gatar_edge.channels import FORMAT
from gatar_edge.config import AgentConfig
from gatar_edge.errors import ModelError

LEARNED = "gatar"  # the allocator that runs a model
_VERSIONS = ("numpy", "onnxruntime", "tcod", "mcap", "msgspec")


def describe_run(
    config: AgentConfig,
    robots: Sequence[Identity],
    allocator: str,
    *,
    model: str = "",
    model_sha256: str = "",
    first_seqs: Mapping[int, int] | None = None,
    extra: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """The `run_info` of a `Recorder`: what a replay needs, and what a reader asks first. Never holds a key.

    `model` is the file of the learned allocator, where `allocator` does not name it (`gatar:FILE`) and it is not the
    shipped one; `model_sha256` its digest, where that is known already.
    `extra` adds fields of the mission, such as team, seed, r_comm of the radio, step_s, or the command line.
    """
    return {
        "format": FORMAT,
        "config": msgspec.to_builtins(config),
        "robots": [
            {
                "robot_id": robot.robot_id,
                "kind": robot.kind.value,
                "speed_cells_s": robot.speed_cells_s,
                "first_seq": (first_seqs or {}).get(robot.robot_id, 1),
            }
            for robot in robots
        ],
        "allocator": allocator,
        **_model(allocator, model, model_sha256),
        "versions": _versions(),
        **(extra or {}),
    }


def sha256_of(path: Path) -> str:
    """The digest by which a log names its model. Raises ModelError."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise ModelError(f"model {path} cannot be read: {error.strerror}") from error


def model_file(allocator: str, model: str = "") -> Path | None:
    """The file of a learned allocator, by the name of the allocator; None for the other allocators."""
    rule, _, named = allocator.partition(":")
    if rule != LEARNED:
        return None
    if model or named:
        return Path(model or named)
    from gatar_edge.policy import DEFAULT_MODEL  # onnxruntime: only where it runs anyway

    return DEFAULT_MODEL


def _model(allocator: str, model: str, digest: str) -> dict[str, str]:
    path = model_file(allocator, model)
    if path is None:
        return {"model": "", "model_sha256": ""}
    return {"model": path.name, "model_sha256": digest or sha256_of(path)}


@cache
def _versions() -> dict[str, str]:
    found = {"gatar-edge": __version__, "python": platform.python_version(), "machine": platform.machine()}
    for name in _VERSIONS:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    revision = _revision(Path(__file__).resolve().parent.parent)
    return found | ({"git": revision} if revision else {})


def _revision(root: Path) -> str:
    """The git revision where this runs from a checkout, else empty."""
    if not (root / ".git").exists():
        return ""
    try:
        call = ["git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=12"]
        return subprocess.run(call, capture_output=True, text=True, timeout=2, check=True).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return ""
