"""Networks of the paper's comparison as ONNX files that are proved equal to them."""

import pytest
from learning import tiny_run

from gatar_edge.export.convert import export
from gatar_edge.export.verify import verify

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("network", ["gatar-paper", "gnn-vcycle", "magat"])
def test_networks_of_the_papers_comparison_are_exported_and_proved(network, tmp_path):
    out = tmp_path / "tiny.onnx"
    export(tiny_run(network), out)
    proof = verify(out, states_of=lambda: [(n, m, r) for n in (1, 2, 12, 64) for m in (0, 1, 30) for r in (0.0, 6.0)])
    assert proof.ok, proof.error
