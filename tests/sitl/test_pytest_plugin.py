"""The fixtures as somebody else's project gets them."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib.metadata import entry_points
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
MODULE = "gatar_edge.sim_sitl.pytest_plugin"


def run(*command: str, cwd: Path = ROOT) -> subprocess.CompletedProcess[str]:
    """Python with this checkout importable, installed or not."""
    options = {"cwd": cwd, "env": os.environ | {"PYTHONPATH": str(ROOT)}, "timeout": 120}
    return subprocess.run([sys.executable, *command], check=False, capture_output=True, text=True, **options)


def plugin() -> list[str]:
    """The option that loads the plugin where the package is not installed and so has no entry point."""
    installed = any(point.value == MODULE for point in entry_points(group="pytest11"))
    return [] if installed else ["-p", MODULE]


def test_the_example_project_passes() -> None:
    done = run("-m", "pytest", "-q", *plugin(), cwd=ROOT / "examples" / "pytest_fixture")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "4 passed" in done.stdout


def test_a_foreign_test_run_pays_nothing_for_the_plugin(tmp_path: Path) -> None:
    (tmp_path / "test_foreign.py").write_text(
        "import sys, threading\n"
        "def test_nothing_is_loaded():\n"
        "    heavy = {'numpy', 'pymavlink', 'msgspec', 'gatar_edge.sim_sitl.served'} & set(sys.modules)\n"
        "    assert not heavy\n"
        "    assert threading.active_count() == 1\n"
    )
    done = run("-m", "pytest", "-q", "-p", "no:randomly", "-p", "no:hypothesispytest", *plugin(), cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_entry_point_names_a_module_that_is_there() -> None:
    assert f'gatar_edge = "{MODULE}"' in (ROOT / "pyproject.toml").read_text()
    assert run("-c", f"import {MODULE}").returncode == 0
