"""What is installed on a robot, and that nothing is forgotten."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())

# what the robot runs; everything that must work without the extras
RUNTIME = (
    "gatar_edge.cli",
    "gatar_edge.agent",
    "gatar_edge.policy",
    "gatar_edge.daemon",
    "gatar_edge.record",
    "gatar_edge.allocators.registry",
    "gatar_edge.allocators.gatar",
    "gatar_edge.bridge.driver",
    "gatar_edge.sim_sitl.fleet",
    "gatar_edge.sim_sitl.grid_mission",
    "gatar_edge.review.report",
    "gatar_edge.commands.sim",
    "gatar_edge.commands.vehicle",
    "gatar_edge.commands.log",
)


def test_every_package_folder_is_installed() -> None:
    listed = set(PROJECT["tool"]["setuptools"]["packages"])
    mapped = PROJECT["tool"]["setuptools"]["package-dir"]
    folders = {name: ROOT / folder for name, folder in mapped.items()}
    found = {
        ".".join([name, *init.parent.relative_to(folder).parts])
        for name, folder in folders.items()
        for init in folder.rglob("__init__.py")
        if not any(parent.is_symlink() for parent in init.parents)
    }
    assert found == listed


@pytest.mark.parametrize("name", ["export", "bridge", "sim_sitl", "models"])
def test_the_links_lead_to_the_folders_at_the_top(name: str) -> None:
    assert (ROOT / "gatar_edge" / name).resolve() == ROOT / name


def test_the_robot_runtime_imports_without_torch_onnx_and_numba() -> None:
    program = (
        "import sys\n"
        "for name in ('torch', 'onnx', 'onnxscript', 'numba', 'scipy', 'matplotlib', 'safetensors'):\n"
        "    sys.modules[name] = None\n"
        f"for name in {RUNTIME!r}:\n"
        "    __import__(name)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, cwd=ROOT, check=False)
    assert done.returncode == 0, done.stderr


def test_no_extra_of_learning_is_a_dependency_of_the_robot() -> None:
    names = {requirement.split(">")[0].strip() for requirement in PROJECT["project"]["dependencies"]}
    assert not names & {"torch", "onnx", "onnxscript", "numba", "scipy", "matplotlib", "safetensors"}


def test_models_are_never_pickles() -> None:
    assert {path.suffix for path in (ROOT / "models").iterdir()} <= {
        ".onnx",
        ".md",
        ".safetensors",
        ".json",
        ".npz",
        ".py",
        "",
    }
