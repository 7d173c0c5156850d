"""Comparisons of allocators over many missions."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import msgspec
import numpy as np
import pytest
from click.testing import CliRunner
from processes import children_of, parents

from gatar_edge.campaign import KILLED_BY, Campaign, Flight, deaths_of, fly_all, fly_one, load_results
from gatar_edge.commands.eval_missions import command, table
from gatar_edge.errors import ConfigError
from gatar_edge.learn.statistics import mean_interval, ratio_interval
from gatar_edge.policy import DEFAULT_MODEL, GREEDY_MODEL

SMALL = Campaign(team="1A1G", size=8, targets=5, missions=2, seed=40)
SMALL_OPTIONS = ["--team", "1A1G", "--missions", "2", "--size", "8", "--targets", "5"]
FLIGHTS = [Flight(SMALL, name, seed) for seed in SMALL.seeds for name in ("nearest", "greedy")]


def test_figures_are_the_same_for_any_number_of_workers() -> None:
    assert fly_all(FLIGHTS, workers=2) == fly_all(FLIGHTS)


def test_campaign_that_was_cut_off_goes_on_where_it_was(tmp_path: Path) -> None:
    file = tmp_path / "results.jsonl"
    fly_all(FLIGHTS[:3], results=file)
    file.write_bytes(file.read_bytes()[:-10])  # the last line was being written
    told: list[int] = []
    figures = fly_all(FLIGHTS, results=file, progress=told.append)
    assert told == [2, 3, 4]
    assert figures == fly_all(FLIGHTS)
    assert set(load_results(file)) == {flight.key for flight in FLIGHTS}


def test_foreign_file_of_results_is_refused(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("not a result\n")
    with pytest.raises(ConfigError, match="cannot be used as a file of results"):
        fly_all(FLIGHTS, results=tmp_path / "notes.txt")


@pytest.mark.parametrize("theirs", ['{"steps": 3}', "notes", "{}"])
def test_foreign_file_without_a_line_end_is_refused_and_kept(tmp_path: Path, theirs: str) -> None:
    file = tmp_path / "summary.json"
    file.write_text(theirs)
    kept = file.read_bytes()
    with pytest.raises(ConfigError, match="cannot be used as a file of results"):
        fly_all(FLIGHTS, results=file)
    assert file.read_bytes() == kept


def test_killed_campaign_leaves_no_process(tmp_path: Path) -> None:
    line = ["eval", "missions", "--allocators", "greedy", "--missions", "1000", "--workers", "2"]
    line += ["--results", str(tmp_path / "results"), "--json"]
    process = subprocess.Popen([sys.executable, "-m", "gatar_edge", *line], stdout=subprocess.DEVNULL)
    while process.poll() is None and not ((tmp_path / "results").exists() and (tmp_path / "results").stat().st_size):
        time.sleep(0.01)
    started = children_of(process.pid)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    assert started
    while started & parents().keys():  # the test's own limit ends this
        time.sleep(0.05)


def test_file_of_results_that_cannot_be_written_is_refused_before_flying(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="No such file"):
        fly_all(FLIGHTS, results=tmp_path / "nowhere" / "results.jsonl")


def test_flights_under_other_conditions_have_other_keys() -> None:
    lossy = Campaign(team="1A1G", size=8, targets=5, missions=2, seed=40, loss=0.1)
    longer = Campaign(team="1A1G", size=8, targets=5, missions=9, seed=39)
    assert Flight(lossy, "greedy", 40).key != FLIGHTS[1].key
    assert Flight(longer, "greedy", 40).key == FLIGHTS[1].key


def test_flights_of_another_model_have_other_keys_whatever_it_is_called(tmp_path: Path) -> None:
    for name, model in (("one", DEFAULT_MODEL), ("two", DEFAULT_MODEL), ("three", GREEDY_MODEL)):
        (tmp_path / name).write_bytes(model.read_bytes())
    default, one, two, three = (
        Flight(SMALL, name, 40).key
        for name in ("gatar", *(f"gatar:{tmp_path / name}" for name in ("one", "two", "three")))
    )
    assert default == one == two != three


def test_central_rule_hears_everybody_however_far_and_lossy() -> None:
    deaf = Campaign(team="2A0G", size=15, targets=10, r_comm=0.0, loss=1.0)
    hearing = Campaign(team="2A0G", size=15, targets=10)
    assert fly_one(Flight(deaf, "central-greedy", 3)) == fly_one(Flight(hearing, "central-greedy", 3))


def test_ratio_is_paired_by_mission() -> None:
    steps = np.array([10.0, 20.0, 40.0, 80.0])
    ratio = ratio_interval(steps * 0.5, steps)
    assert (ratio.mean, ratio.lo, ratio.hi) == pytest.approx((0.5, 0.5, 0.5))


def test_interval_of_a_mean_is_about_two_standard_errors_to_each_side() -> None:
    values = np.random.default_rng(5).normal(10, 2, 400)
    interval = mean_interval(values)
    assert interval.mean == values.mean()
    assert 0.16 < interval.hi - interval.mean < 0.23
    assert 0.16 < interval.mean - interval.lo < 0.23


def test_command_prints_figures_for_machines() -> None:
    arguments = ["--allocators", "nearest,greedy", *SMALL_OPTIONS, "--json"]
    result = CliRunner().invoke(command, arguments, catch_exceptions=False)
    summary = json.loads(result.stdout)
    assert list(summary) == ["nearest", "greedy"]
    assert summary["greedy"]["ratio_to_greedy"] == {"mean": 1.0, "lo": 1.0, "hi": 1.0}
    assert summary["nearest"]["steps_100"]["lo"] <= summary["nearest"]["steps_100"]["mean"]
    assert summary["nearest"]["localized"] == 1.0


def test_command_prints_a_table_for_people() -> None:
    arguments = ["--allocators", "nearest", *SMALL_OPTIONS]
    text = CliRunner().invoke(command, arguments, catch_exceptions=False).stdout
    assert "100.0%" in text
    assert text.splitlines()[-1].endswith("-")  # nothing to compare with


def test_table_keeps_its_columns_apart_for_long_missions_and_names() -> None:
    span = {"mean": 312.0, "lo": 301.25, "hi": 498.5}
    row = {"steps_100": span, "steps_90": span, "mean_time": span, "localized": 1.0, "ratio_to_greedy": None}
    name = "gatar:models/gatar-greedy.onnx"
    told = table(SMALL, {name: row}).splitlines()[-1]
    assert told.split() == [name, *["312.00", "[301.25,", "498.50]"] * 3, "100.0%", "-"]


def test_command_refuses_unknown_allocators_before_flying() -> None:
    with pytest.raises(ConfigError, match="'best' is unknown"):
        CliRunner().invoke(command, ["--allocators", "greedy,best"], catch_exceptions=False)


def test_kills_are_the_same_for_every_allocator_and_grow_one_by_one() -> None:
    few, more = (deaths_of(msgspec.structs.replace(SMALL, team="3A3G", kills=kills), 7) for kills in (2, 3))
    assert len(few) == 2
    assert few.items() <= more.items()
    assert all(1 <= step <= KILLED_BY for step in more.values())


def test_team_cannot_lose_everybody() -> None:
    result = CliRunner().invoke(command, [*SMALL_OPTIONS, "--kills", "2"])
    assert isinstance(result.exception, ConfigError)
    assert "1A1G can lose 0 to 1" in str(result.exception)
