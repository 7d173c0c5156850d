"""Uploads through a bad link, client against server: all end, and what is called accepted is on board."""

from __future__ import annotations

import json

import pytest
from click.testing import CliRunner

from gatar_edge.bridge.mission_items import build
from gatar_edge.commands import bench_faults
from gatar_edge.commands.bench_faults import STACKS, Upload, command, trials
from gatar_edge.sim_sitl.faults import LinkFaults

BAD = LinkFaults(loss=0.3, duplicate=0.1, reorder=1.0, delay_max_ns=400_000_000)


@pytest.mark.parametrize("stack", STACKS)
def test_uploads_through_a_bad_link_end_and_are_what_they_are_said_to_be(stack: str) -> None:
    done = list(trials(stack, 15, BAD))
    assert [trial.result is None or trial.different for trial in done] == [False] * 30
    assert sum(trial.result.ok for trial in done if trial.result is not None) >= 28


@pytest.mark.parametrize("stack", STACKS)
def test_a_perfect_link_takes_less_than_a_second(stack: str) -> None:
    first, second = trials(stack, 1, LinkFaults())
    assert first.simulated_s < 1.0
    assert second.simulated_s < 2.0  # it is downloaded and compared


def test_a_mission_that_is_not_what_was_sent_would_be_noticed() -> None:
    upload = Upload("px4", 1, LinkFaults())
    items = build(upload.profile, ((1.0, 2.0), (1.0, 2.1)), 0.0)
    assert not upload.run(items).different
    assert upload._lied(items[:1])


def test_the_counts_are_printed_for_machines_and_a_hang_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    good = CliRunner().invoke(command, ["--seeds", "2", "--json"])
    assert good.exit_code == 0, good.output
    row = json.loads(good.output)["dialects"]["px4"]
    assert (row["uploads"], row["hangs"], row["accepted_but_different"]) == (4, 0, 0)
    monkeypatch.setattr(bench_faults, "HANG_NS", 1)
    bad = CliRunner().invoke(command, ["--seeds", "1"])
    assert bad.exit_code == 1
    assert "ardupilot" in bad.output
