"""The experiment with 8-bit integers: a model that still loads and is judged by speed and decisions."""

import json
from dataclasses import replace

import pytest
from click.testing import CliRunner

from gatar_edge.commands.quantize import command
from gatar_edge.errors import ModelError
from gatar_edge.export.quantize import Comparison, compare, quantize
from gatar_edge.policy import DEFAULT_MODEL, Policy


def test_the_quantized_model_keeps_its_contract_and_is_compared_side_by_side(tmp_path):
    out = tmp_path / "int8.onnx"
    result = CliRunner().invoke(command, [str(DEFAULT_MODEL), "--scenes", "2", "-o", str(out), "--json"])
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert found["states"] == 2 * len(found["float_us"])
    assert all(found[kind][size] > 0 for kind in ("float_us", "int8_us") for size in found["float_us"])
    assert 0 < found["agreement"] <= 1
    assert found["largest_difference"] > 0
    assert Policy(out).manifest.fields == Policy(DEFAULT_MODEL).manifest.fields


def test_the_model_itself_is_not_overwritten(tmp_path):
    model = tmp_path / "model.onnx"
    model.write_bytes(DEFAULT_MODEL.read_bytes())
    with pytest.raises(ModelError, match="choose another file"):
        quantize(model, tmp_path / "." / "model.onnx", 1)
    assert model.read_bytes() == DEFAULT_MODEL.read_bytes()


def test_a_model_compared_with_itself_decides_alike():
    found = compare(DEFAULT_MODEL, DEFAULT_MODEL, 2)
    assert (found.agreement, found.ego_agreement, found.largest_difference) == (1.0, 1.0, 0.0)


MADE = Comparison("m", 10, 5, {"1": 100.0, "12": 400.0}, {"1": 80.0, "12": 300.0}, 9, 0.9995, 1.0, 0.01)


def test_a_faster_model_that_decides_alike_is_recommended():
    assert MADE.recommended


@pytest.mark.parametrize("change", [{"agreement": 0.99}, {"int8_us": {"1": 80.0, "12": 390.0}}])
def test_a_model_that_decides_otherwise_or_is_hardly_faster_is_not_recommended(change):
    assert not replace(MADE, **change).recommended


def test_a_file_that_is_no_model_is_one_clear_line(tmp_path):
    path = tmp_path / "other.onnx"
    path.write_bytes(b"not a model")
    with pytest.raises(ModelError, match="not a readable ONNX model"):
        quantize(path, tmp_path / "int8.onnx")
