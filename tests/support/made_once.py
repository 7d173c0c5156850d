"""What is costly to make and never changes: one process of a test run makes it, all of them read it."""

from __future__ import annotations

import fcntl
import shutil
from collections.abc import Callable
from pathlib import Path

_home: list[Path] = []


def keep_in(home: Path) -> None:
    """The folder of this test run, the same for all its processes."""
    _home[:] = [home]


def made_once(name: str, make: Callable[[Path], object]) -> Path:
    """The folder that `make` fills; whoever wants it while another process makes it waits."""
    folder, part = _home[0] / name, _home[0] / f"{name}.part"
    with (_home[0] / f"{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not folder.exists():
            shutil.rmtree(part, ignore_errors=True)  # of one who failed
            part.mkdir()
            make(part)
            part.rename(folder)
    return folder
