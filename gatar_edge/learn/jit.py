"""The one way in which functions of this package are compiled: cached on disk, without the interpreter's lock.

numba compiles a function again when the file of that function changed, but not when one that it calls did, or a
constant from elsewhere: it would go on with the old code in silence. So the cache lies in a folder that is named after
the text of all that is compiled, and of what that takes its constants from.
"""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import ParamSpec, TypeVar, cast

import numba
from numba import njit

P = ParamSpec("P")
R = TypeVar("R")

_PACKAGE = Path(__file__).parent.parent
_CONSTANTS = ("absent.py", "explore.py", "features.py", "types.py", "allocators/tours.py")
_PREFIX = "gatar-numba-"


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """`function` compiled by numba, with its type kept for the type checker."""
    return cast("Callable[P, R]", njit(cache=True, nogil=True)(function))


def digest_of(package: Path) -> str:
    """Of the text of all that is compiled in `package`, and of the modules of its constants."""
    learn = [path.read_bytes() for path in sorted((package / "learn").rglob("*.py"))]
    texts = [text for text in learn if b"@compiled" in text]
    texts += [(package / name).read_bytes() for name in _CONSTANTS]
    whole = hashlib.blake2b(digest_size=8)
    for text in texts:
        whole.update(hashlib.blake2b(text).digest())
    return whole.hexdigest()


def cache_folder(home: Path, digest: str) -> Path:
    """Where compiled functions of these sources are kept in `home`; those of other sources are removed."""
    folder = home / f"{_PREFIX}{digest}"
    for other in home.glob(f"{_PREFIX}*"):
        if other != folder:
            shutil.rmtree(other, ignore_errors=True)
    return folder


numba.config.CACHE_DIR = str(
    cache_folder(Path(numba.config.CACHE_DIR or Path(__file__).parent / "__pycache__"), digest_of(_PACKAGE))
)
