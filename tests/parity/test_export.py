"""From a run to an ONNX file that is proved equal to it, and a proof that fails where it is not."""

import json

import numpy as np
import onnx
import pytest
from click.testing import CliRunner
from learning import tiny_model, tiny_run
from safetensors.torch import load_file, save_file

from gatar_edge.commands.verify import command as verify_command
from gatar_edge.errors import ConfigError, ModelError
from gatar_edge.export.convert import export
from gatar_edge.export.spec import DYNAMIC
from gatar_edge.export.verify import verify
from gatar_edge.manifest import KEY
from gatar_edge.policy import DEFAULT_MODEL, Policy

pytestmark = pytest.mark.slow


def few_states():
    """Every number of robots, and every number of candidates."""
    for robots in range(1, 65):
        yield robots, 3, 6.0
        yield robots, 0, 1000.0
    for candidates in range(65):
        yield 3, candidates, 0.0


@pytest.fixture(scope="module")
def exported():
    return tiny_model()


def test_the_file_is_proved_equal_for_every_team_size(exported):
    proof = verify(exported, states_of=few_states)
    assert proof.ok, proof.error
    assert proof.states == 64 * 2 + 65
    assert proof.max_difference <= 1e-5


def test_states_of_missions_are_compared_too(exported):
    proof = verify(exported, states_of=lambda: [(2, 3, 6.0)], flown=40)
    assert proof.ok, proof.error
    assert proof.states == 41
    assert proof.decisions > 2 + 40  # most robots have somebody to talk to


def test_other_weights_are_found_out(exported, tmp_path):
    path = tmp_path / exported.name
    path.write_bytes(exported.read_bytes())
    weights = load_file(exported.with_suffix(".safetensors"))
    weights["score.weight"] = weights["score.weight"] + 0.05
    save_file(weights, path.with_suffix(".safetensors"))
    result = CliRunner().invoke(verify_command, [str(path), "--json"])
    assert result.exit_code == 1
    assert json.loads(result.stdout)["error"].startswith("ValueMismatchError: scores with 1 robots")


def test_missing_weights_are_one_clear_line(exported, tmp_path):
    path = tmp_path / exported.name
    path.write_bytes(exported.read_bytes())
    with pytest.raises(ModelError, match="cannot read the weights"):
        verify(path)


def test_a_model_can_lie_in_the_folder_of_its_run(tmp_path):
    for name in ("model.json", "model.safetensors"):
        (tmp_path / name).write_bytes((tiny_run() / name).read_bytes())
    export(tmp_path, tmp_path / "model.onnx")
    assert verify(tmp_path / "model.onnx", states_of=lambda: [(2, 3, 6.0)]).ok
    assert (tmp_path / "model.safetensors").read_bytes() == (tiny_run() / "model.safetensors").read_bytes()


def test_a_name_that_could_be_that_of_the_weights_is_refused(tmp_path):
    with pytest.raises(ConfigError, match=r"ends in \.onnx"):
        export(tiny_run(), tmp_path / "model.safetensors")
    assert not [*tmp_path.iterdir()]


@pytest.mark.parametrize("left", [b"", b"half of the we"])
def test_damaged_weights_are_one_clear_line(exported, tmp_path, left):
    path = tmp_path / exported.name
    path.write_bytes(exported.read_bytes())
    path.with_suffix(".safetensors").write_bytes(left)
    with pytest.raises(ModelError, match="cannot read the weights"):
        verify(path, states_of=few_states)


@pytest.mark.parametrize("shipped", [False, True])
def test_the_file_stands_alone_and_tells_nothing_of_the_machine(exported, shipped):
    path = DEFAULT_MODEL if shipped else exported
    data = path.read_bytes()
    model = onnx.load_from_string(data)
    assert model.ir_version <= 10
    assert all(17 <= entry.version <= 20 for entry in model.opset_import if entry.domain in {"", "ai.onnx"})
    assert not any(tensor.external_data for tensor in model.graph.initializer)
    assert b".py" not in data
    assert b"/tmp" not in data
    assert b"site-packages" not in data
    assert [entry.key for entry in model.metadata_props] == [KEY]
    assert len(data) < 1 << 20


def test_the_free_axes_are_free(exported):
    for value in onnx.load(exported).graph.input:
        free = {dim.dim_param for dim in value.type.tensor_type.shape.dim if dim.dim_param}
        assert free <= set(DYNAMIC)
        assert free


def test_the_contract_says_where_the_model_comes_from(exported):
    fields = Policy(exported).manifest.fields
    assert fields["network"] == "gatar"
    assert len(fields["training"]["data_sha256"]) == 64
    assert fields["r_comm"] == [3.0, 6.0]
    assert fields["training"]["steps"] == 12
    assert np.isfinite(fields["sigma"])
