"""What flew: the description that every log carries, so that it can be explained and replayed without anything else."""

from __future__ import annotations

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

_VERSIONS = ("numpy", "onnxruntime", "tcod", "mcap", "msgspec")


def describe_run(
    config: AgentConfig,
    robots: Sequence[Identity],
    allocator: str,
    *,
    model_sha256: str = "",
    model: str = "",
    first_seqs: Mapping[int, int] | None = None,
    extra: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """The `run_info` of a `Recorder`: what a replay needs, and what a reader asks first. Never holds a key.

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
        "model": model,
        "model_sha256": model_sha256,
        "versions": _versions(),
        **(extra or {}),
    }


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
