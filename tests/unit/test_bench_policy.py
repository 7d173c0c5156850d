"""The measurement of one decision: on real scenes, without the fallback, with all parts."""

import json

import numpy as np
import onnx
import pytest
from click.testing import CliRunner

from gatar_edge.allocators.gatar import Gatar
from gatar_edge.allocators.greedy import Greedy
from gatar_edge.commands.bench_policy import command
from gatar_edge.errors import ModelError
from gatar_edge.manifest import KEY
from gatar_edge.perception import Perception
from gatar_edge.policy import DEFAULT_MODEL
from gatar_edge.policy_speed import PARTS, measure, measure_process
from gatar_edge.scenes import EGO, make_scene, tick


@pytest.mark.parametrize("robots", [1, 12, 64])
def test_a_scene_is_one_graph_of_so_many_robots_and_targets(robots):
    scene = make_scene(robots, 25, seed=3)
    agent = scene.agent(Greedy())
    decision = tick(agent, Perception(EGO, scene.kind, scene.config.grid), scene.datagrams(1), 2 * 10**9).decision
    assert len(decision.robots) == robots
    assert min(decision.hops) >= 0
    assert len(decision.candidates) == 25
    assert not decision.fallback


def test_the_same_seed_gives_the_same_bytes():
    assert make_scene(4, 25, seed=1).datagrams(7) == make_scene(4, 25, seed=1).datagrams(7)
    assert make_scene(4, 25, seed=1).datagrams(7) != make_scene(4, 25, seed=2).datagrams(7)


def test_the_bench_prints_every_part_and_a_process_that_the_network_decided_in():
    result = CliRunner().invoke(
        command, ["--robots", "1", "--robots", "4", "--repeats", "1", "--seconds", "0.4", "--json"]
    )
    assert result.exit_code == 0, result.output
    figures = json.loads(result.stdout)
    assert [row["robots"] for row in figures["sizes"]] == [1, 4]
    for row in figures["sizes"]:
        assert all(0 < row[part]["p50_us"] <= row[part]["p99_us"] for part in PARTS)
        assert row["tick"]["cpu_us"] > 0.5 * row["policy"]["cpu_us"]  # it holds the policy; other programs disturb both
    assert figures["process"]["decided_by"] == "gatar"
    assert figures["process"]["robots"] == 12
    assert figures["process"]["rss_mb"] > 10


def test_a_model_that_fails_is_not_measured_as_its_fallback():
    allocator = Gatar()
    run = allocator.policy.run
    allocator.policy.run = lambda inputs: run({**inputs, "maps": np.full_like(inputs["maps"], np.nan)})
    with pytest.raises(ModelError, match="failed on a scene"):
        measure(allocator, 1, 5, 1, None)


def test_a_file_that_is_no_model_is_found_out_before_anything_is_measured(tmp_path):
    (tmp_path / "notes.onnx").write_text("not a model")
    result = CliRunner().invoke(command, ["--model", str(tmp_path / "notes.onnx")])
    assert isinstance(result.exception, ModelError)
    assert "not a readable ONNX model" in str(result.exception)


def test_a_model_of_other_ranges_is_one_clear_line(tmp_path):
    model = onnx.load(DEFAULT_MODEL)
    fields = {entry.key: json.loads(entry.value) for entry in model.metadata_props}
    onnx.helper.set_model_props(model, {KEY: json.dumps({**fields[KEY], "r_comm": [1, 2]})})
    onnx.save(model, tmp_path / "narrow.onnx")
    with pytest.raises(ModelError, match="field r_comm is 1 to 2 cells, the robot is configured to 6"):
        measure_process(tmp_path / "narrow.onnx", 2, 3, 0.2, 5.0)
