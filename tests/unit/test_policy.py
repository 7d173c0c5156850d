"""Loading and running a model file, and the refusal of files and inputs that do not fit."""

import json
import os
import subprocess
import sys

import numpy as np
import onnx
import pytest

from gatar_edge import manifest
from gatar_edge.allocators.base import NO_TARGET
from gatar_edge.allocators.gatar import Gatar, decode
from gatar_edge.config import AgentConfig
from gatar_edge.errors import ModelError
from gatar_edge.export.states import random_view
from gatar_edge.features import features
from gatar_edge.policy import DEFAULT_MODEL, Policy


@pytest.fixture(scope="module")
def policy():
    return Policy()


def with_contract(path, **changes):
    """A copy of the shipped model with another contract."""
    model = onnx.load(DEFAULT_MODEL)
    fields = json.loads(next(entry.value for entry in model.metadata_props if entry.key == manifest.KEY))
    fields.update(changes)
    onnx.helper.set_model_props(model, {manifest.KEY: json.dumps(fields)})
    onnx.save_model(model, path)
    return path


def test_onnxruntime_keeps_no_identifier_of_the_robot_and_starts_no_upload(tmp_path):
    """Its newer releases tell their maker of the machine and its models, unless told not to."""
    environment = {name: value for name, value in os.environ.items() if name != "ORT_DISABLE_TELEMETRY"}
    environment |= {"HOME": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path)}
    subprocess.run([sys.executable, "-c", "import gatar_edge.policy"], env=environment, check=True)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("field", "value"),
    [("sigma", 2.0), ("epsilon", 0.1), ("channels", ["reward"]), ("features_version", 0), ("golden_input", "other")],
)
def test_a_model_of_another_contract_is_refused_with_the_field_and_both_values(tmp_path, field, value):
    path = with_contract(tmp_path / "other.onnx", **{field: value})
    with pytest.raises(ModelError) as caught:
        Policy(path)
    ours = manifest.fixed_fields()[field]
    assert f"field {field} is {value!r}" in str(caught.value)
    assert repr(ours) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_robot_configured_beyond_what_the_model_was_trained_for_is_refused():
    with pytest.raises(ModelError, match=r"field r_comm is .* the robot is configured to 900"):
        Gatar(config=AgentConfig(r_comm=900.0))
    with pytest.raises(ModelError, match=r"field levels is 2, this version needs 3"):
        Gatar(config=AgentConfig(hop_limit=3))


@pytest.mark.parametrize("field", ["r_sense", "r_comm"])
@pytest.mark.parametrize(
    "value",
    [
        None,
        4.0,
        "34",
        "3\n",
        {},
        [],
        [3],
        [3, 4, 5],
        [3, "5"],
        [None, 5],
        [True, 5],
        [0, np.nan],
        [0, np.inf],
        [0, 10**400],
    ],
    ids=lambda value: repr(value)[:12],
)
def test_a_range_that_is_no_pair_of_finite_numbers_is_refused_in_one_line(tmp_path, field, value):
    with pytest.raises(ModelError, match=rf"^other.onnx: field {field} is .*, expected \[lowest, highest\]$") as bad:
        Policy(with_contract(tmp_path / "other.onnx", **{field: value}))
    assert "\n" not in str(bad.value)


def test_the_default_configuration_fits_the_shipped_model():
    assert Gatar(config=AgentConfig()).policy.manifest.name == DEFAULT_MODEL.stem


@pytest.mark.parametrize("content", [b"", b"not a model", b"\x08\x07" * 100])
def test_an_unreadable_file_is_one_clear_line(tmp_path, content):
    path = tmp_path / "broken.onnx"
    path.write_bytes(content)
    with pytest.raises(ModelError) as caught:
        Policy(path)
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ModelError, match=r"cannot read the model .*nowhere\.onnx"):
        Policy(tmp_path / "nowhere.onnx")


def test_a_model_that_is_not_ours_is_refused(tmp_path):
    model = onnx.load(DEFAULT_MODEL)
    del model.metadata_props[:]
    onnx.save_model(model, tmp_path / "foreign.onnx")
    with pytest.raises(ModelError, match="no gatar contract"):
        Policy(tmp_path / "foreign.onnx")


@pytest.mark.parametrize("name", ["places", "robots", "pairs", "valid", "offsets"])
def test_an_input_that_is_not_finite_is_refused(policy, name):
    inputs = features(random_view(3, 4, 0, 6.0))
    inputs[name] = inputs[name].copy()
    inputs[name].flat[0] = np.nan
    with pytest.raises(ModelError, match=f"input {name} holds a number that is not finite"):
        policy.run(inputs)


def test_a_shape_that_onnxruntime_would_broadcast_is_refused(policy):
    inputs = features(random_view(3, 4, 0, 6.0))
    inputs["hops"] = inputs["hops"][:1, :1]
    with pytest.raises(ModelError, match=r"axis N has size \d, expected \d"):
        policy.run(inputs)


def test_a_wrong_type_is_refused(policy):
    inputs = features(random_view(3, 4, 0, 6.0))
    inputs["pairs"] = inputs["pairs"].astype(np.float64)
    with pytest.raises(ModelError, match="input pairs: float64"):
        policy.run(inputs)


def test_a_missing_input_is_named(policy):
    inputs = features(random_view(3, 4, 0, 6.0))
    del inputs["places"]
    with pytest.raises(ModelError, match="input places is missing"):
        policy.run(inputs)


def test_more_robots_than_the_model_takes_are_refused(policy):
    with pytest.raises(ModelError, match="65 robots"):
        policy.run(features(random_view(65, 4, 0, 6.0)))


def test_scores_are_probabilities_over_candidates_and_no_target(policy):
    output = policy.run(features(random_view(6, 9, 0, 6.0)))
    np.testing.assert_allclose(output.scores.sum(axis=1), 1, atol=1e-5)
    assert output.attention.sum() == pytest.approx(1, abs=1e-5)


def decoded(scores, possible=None):
    scores = np.array(scores, dtype=np.float32)
    shape = (scores.shape[0], scores.shape[1] - 1)
    mask = np.ones(shape, dtype=np.bool_) if possible is None else np.array(possible)
    return decode(scores, mask, np.arange(shape[0])).tolist()


def test_two_robots_never_get_one_target():
    assert decoded([[0.6, 0.35, 0.05], [0.9, 0.05, 0.05]]) == [1, 0]


def test_of_more_robots_than_targets_the_likeliest_gets_it():
    assert decoded([[0.1, 0.9], [0.8, 0.2]]) == [NO_TARGET, 0]


def test_a_robot_takes_a_free_target_however_unlikely():
    assert decoded([[0.01, 0.99]]) == [0]


def test_an_unreachable_target_is_never_given():
    assert decoded([[0.99, 0.01]], possible=[[False]]) == [NO_TARGET]


def test_without_candidates_everybody_gets_nothing():
    assert decoded([[1.0], [1.0]]) == [NO_TARGET, NO_TARGET]


@pytest.mark.parametrize("robots", [1, 2, 12])
@pytest.mark.parametrize("candidates", [0, 1, 20])
def test_the_allocator_answers_for_every_robot_and_candidate(robots, candidates):
    view = random_view(robots, candidates, 4, 6.0)
    allocation = Gatar().allocate(view)
    assert allocation.choices.shape == (robots,)
    assert allocation.scores.shape == (robots, candidates)
    assert allocation.xy is not None
    assert np.isfinite(allocation.xy).all()
    taken = allocation.choices[allocation.choices != NO_TARGET]
    assert len(set(taken.tolist())) == len(taken)
