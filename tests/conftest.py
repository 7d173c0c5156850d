"""Fixtures and builders shared by all tests."""

from __future__ import annotations

import gc
import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings
from made_once import keep_in

# The networks are tiny and the tests run in several processes: more threads only wait for each other.
os.environ["OMP_NUM_THREADS"] = "1"

# How long an example takes tells of the machine, not of what is tested.
settings.register_profile("any machine", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("any machine")


@pytest.fixture(scope="session")
def shared_folder() -> Path:
    """Reference data outside the repository, maps and wire transcripts. Tests that need it skip without it."""
    root = Path(__file__).resolve().parents[1]
    folder = Path(os.environ.get("GATAR_SHARED", root.parent / "shared"))
    if not folder.is_dir():
        pytest.skip(f"no reference data at {folder}: set GATAR_SHARED")
    return folder


@pytest.fixture(scope="session", autouse=True)
def _folder_of_the_run(tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest) -> None:
    """One folder for all processes of pytest-xdist: each has its own below it."""
    own = tmp_path_factory.getbasetemp()
    keep_in(own.parent if hasattr(request.config, "workerinput") else own)


@pytest.fixture(scope="session")
def compiled() -> None:
    """Numba's loops: without its cache one process of a run compiles them for a minute, and the others wait."""
    from learning import tiny_data

    tiny_data()


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Among several processes the files with slow tests come first, else one is left alone with them at the end."""
    if hasattr(config, "workerinput"):
        slow = {item.path for item in items if item.get_closest_marker("slow")}
        items.sort(key=lambda item: item.path not in slow)


def pytest_collection_finish() -> None:
    """What was imported stays: without this each collection of garbage walks through all of torch again."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 20, 20)  # the graphs that torch exports make much and hardly any garbage


def pytest_addoption(parser: pytest.Parser) -> None:
    """`--update-refs`: record the golden logs anew, where a change of decisions is intended."""
    parser.addoption("--update-refs", action="store_true", help="record the golden logs in tests/replay anew")
