"""The selftest of an installation: passes as shipped, without torch, and fails for everything that could be wrong."""

import json
import shutil
import subprocess
import sys

import numpy as np
import pytest
from click.testing import CliRunner
from learning import tiny_model
from safetensors.torch import load_file, save_file

from gatar_edge.commands.selftest import command
from gatar_edge.errors import ConfigError, ModelError
from gatar_edge.export.golden import record
from gatar_edge.policy import MODELS
from gatar_edge.selftest import ARRAYS, TEXT, selftest


@pytest.fixture
def models(tmp_path):
    """A copy of the shipped folder."""
    folder = tmp_path / "models"
    shutil.copytree(MODELS, folder)
    return folder


def changed(folder, name, change):
    """Put the array `name` of the golden file through `change`."""
    with np.load(folder / ARRAYS) as file:
        arrays = dict(file)
    arrays[name] = change(arrays[name])
    np.savez_compressed(folder / ARRAYS, **arrays)


def failures(folder):
    return {check.name: check.detail for check in selftest(folder) if not check.ok}


def test_the_shipped_models_pass_without_torch():
    program = (
        "import sys\n"
        "for name in ('torch', 'onnx', 'onnxscript', 'numba', 'scipy', 'matplotlib', 'safetensors'):\n"
        "    sys.modules[name] = None\n"
        "sys.argv = ['gatar', 'selftest', '--json']\n"
        "from gatar_edge.cli import main\n"
        "main()\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    result = json.loads(done.stdout)
    assert result["ok"]
    names = [check["name"] for check in result["checks"]]
    assert names == ["message codec", "path lengths", "features", *sorted(path.name for path in MODELS.glob("*.onnx"))]


@pytest.mark.parametrize(
    ("array", "change", "failed"),
    [
        ("2/lengths", lambda lengths: lengths + 1, "path lengths"),
        ("2/features/maps", lambda maps: maps + np.float32(1e-3), "features"),
        ("2/gatar-greedy.onnx/scores", lambda scores: scores + 1e-3, "gatar-greedy.onnx"),
        ("1/gatar-greedy.onnx/xy", lambda xy: xy[:1], "gatar-greedy.onnx"),
    ],
)
def test_another_number_fails_the_check_that_it_belongs_to(models, array, change, failed):
    changed(models, array, change)
    assert failed in failures(models)


def test_another_decision_fails(models):
    text = json.loads((models / TEXT).read_text())
    text["scenes"][2]["decisions"]["gatar-greedy.onnx"]["choices"].reverse()
    (models / TEXT).write_text(json.dumps(text))
    assert "expected" in failures(models)["gatar-greedy.onnx"]


def test_a_message_that_was_changed_fails(models):
    text = json.loads((models / TEXT).read_text())
    data = text["scenes"][2]["messages"][0]
    text["scenes"][2]["messages"][0] = data[:-2] + f"{int(data[-2:], 16) ^ 1:02x}"
    (models / TEXT).write_text(json.dumps(text))
    assert "signed with another key" in failures(models)["message codec"]


def test_a_model_that_is_not_the_one_shipped_fails_and_the_exit_code_is_1(models):
    path = models / "gatar-greedy.onnx"
    path.write_bytes(path.read_bytes() + b"\0")
    result = CliRunner().invoke(command, ["--models", str(models)])
    assert result.exit_code == 1
    assert "FAIL gatar-greedy.onnx: ValueError: is not the file" in result.stdout


def test_a_model_without_vectors_fails(models):
    shutil.copyfile(models / "gatar-greedy.onnx", models / "other.onnx")
    assert "gatar selftest --record" in failures(models)["other.onnx"]


def test_a_folder_without_vectors_is_one_clear_line(tmp_path):
    with pytest.raises(ConfigError, match=r"no golden vectors in [^:]*: No such file or directory; run"):
        list(selftest(tmp_path))


def test_recorded_vectors_of_a_new_model_pass(tmp_path):
    folder = tmp_path / "models"
    shutil.copytree(tiny_model().parent, folder)
    result = CliRunner().invoke(command, ["--models", str(folder), "--record", "--json"])
    assert result.exit_code == 0, result.output
    assert [check["name"] for check in json.loads(result.stdout)["checks"]][-1] == "tiny.onnx"


def test_a_model_that_differs_from_its_weights_is_not_recorded(models):
    path = models / "gatar-greedy.safetensors"
    weights = load_file(path)
    weights["score.weight"] = weights["score.weight"] + 0.5
    save_file(weights, path)
    with pytest.raises(ModelError, match="differs from its weights"):
        record(models)
