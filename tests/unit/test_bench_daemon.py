"""`gatar bench daemon` before anything is started."""

from __future__ import annotations

import pytest
from click.testing import CliRunner

from gatar_edge.commands import bench_daemon
from gatar_edge.errors import GatarError


@pytest.mark.parametrize("allocator", ["nobody", "gatar:nowhere.onnx"])
def test_an_allocator_that_cannot_be_used_is_refused_before_a_daemon_is_started(
    allocator: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bench_daemon, "measured_process", lambda *options: pytest.fail("started"))
    result = CliRunner().invoke(bench_daemon.command, ["--allocator", allocator])
    assert isinstance(result.exception, GatarError)
