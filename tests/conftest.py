"""Fixtures and builders shared by all tests."""

from __future__ import annotations

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def shared_folder() -> Path:
    """Reference data outside the repository, maps and wire transcripts. Tests that need it skip without it."""
    root = Path(__file__).resolve().parents[1]
    folder = Path(os.environ.get("GATAR_SHARED", root.parent / "shared"))
    if not folder.is_dir():
        pytest.skip(f"no reference data at {folder}: set GATAR_SHARED")
    return folder


def pytest_addoption(parser: pytest.Parser) -> None:
    """`--update-refs`: record the golden logs anew, where a change of decisions is intended."""
    parser.addoption("--update-refs", action="store_true", help="record the golden logs in tests/replay anew")
