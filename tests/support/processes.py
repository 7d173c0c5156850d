"""Which processes live, and who started them."""

from __future__ import annotations

from pathlib import Path


def parents() -> dict[int, int]:
    """Every process that lives, and who started it; one that only waits to be reaped does not live."""
    found = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, parent = stat.read_text().rpartition(")")[2].split()[:2]
        except OSError:  # it has just ended
            continue
        if state != "Z":
            found[int(stat.parent.name)] = int(parent)
    return found


def children_of(process: int) -> set[int]:
    """Those that it started, and that live."""
    return {child for child, parent in parents().items() if parent == process}
