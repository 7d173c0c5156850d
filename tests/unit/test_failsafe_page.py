"""docs/failsafe.md promises nothing that no test proves."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "failsafe.md").read_text()


def test_every_test_that_the_page_names_exists() -> None:
    written = "\n".join(path.read_text() for path in (ROOT / "tests").rglob("test_*.py"))
    existing = set(re.findall(r"^def (test_\w+)", written, re.MULTILINE))
    named = set(re.findall(r"`(test_[a-z0-9_]+)`", PAGE))
    assert named - existing == set()
    assert len(named) > 30


def test_every_failure_on_the_page_names_a_test() -> None:
    before_the_autopilots = PAGE.split("## When the companion dies")[0]
    rows = [line for line in before_the_autopilots.splitlines() if line.startswith("| ")]
    failures = [row for row in rows if not row.startswith("| what fails")]
    assert len(failures) > 20
    assert [row for row in failures if "`test_" not in row] == []
