"""The paper's tables and figures, in the smallest form that makes all of them."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from learning import TINY, TINY_OF, tiny_data

from gatar_edge.commands.eval_paper import command
from gatar_edge.errors import ConfigError
from gatar_edge.learn.evaluate import Conditions, worlds
from gatar_edge.learn.network_rule import network_rule
from gatar_edge.learn.networks import build
from gatar_edge.learn.views import batch_of
from gatar_edge.paper.city import cover
from gatar_edge.paper.plan import QUICK, TABLE_2, TABLE_3, Scale, channels_of, runs
from gatar_edge.paper.reproduce import PAGE, Places, reproduce
from gatar_edge.paper.table import Table

pytestmark = pytest.mark.slow

SMALLEST = Scale(
    steps=2, batch=4, sizes={**TINY_OF, "gatar": {**TINY, "levels": [2]}}, samples=12, curve_samples=6, ranges=(0, 6),
    teams=("1A1G", "2A2G"),
    missions=2, mission_teams=("1A1G",), curve_missions=1, curve_team="1A1G", losses=(0.0, 0.5), delays=(0, 1),
    kills=(0, 1), city_missions=1, size=8,
)  # fmt: skip


@pytest.fixture(scope="module")
def city_maps(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with one street grid of 64 x 64 cells."""
    folder = tmp_path_factory.mktemp("maps")
    rows = ["".join("@" if x % 8 > 2 and y % 8 > 2 else "." for x in range(64)) for y in range(64)]
    (folder / "blocks.map").write_text("\n".join(["type octile", "height 64", "width 64", "map", *rows]) + "\n")
    return folder


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory, city_maps: Path) -> Places:
    """Everything, made once."""
    folder = tmp_path_factory.mktemp("paper")
    places = Places(folder / "out", folder / "runs", tiny_data(), city_maps)
    reproduce(places, SMALLEST, 1, lambda share, text: None, "gatar eval paper")
    return places


def rows_of(places: Places, name: str) -> list[dict[str, str]]:
    with (places.out / f"{name}.csv").open() as file:
        return list(csv.DictReader(file))


def test_every_network_and_rule_has_its_row_beside_the_papers_numbers(made: Places) -> None:
    table = {row["name"]: row for row in rows_of(made, "table2")}
    assert set(table) == {*TABLE_2, "gatar-greedy", "greedy", "nearest", "random"}
    assert float(table["magat"]["paper p90"]) == 5.4553
    assert all(float(row["target mean"]) >= 0 for row in table.values())
    assert all(int(table[name]["views trained on"]) == 8 for name in TABLE_2)
    assert {row["run"] for row in rows_of(made, "table3")} == {row.run for row in TABLE_3}


def test_curves_have_every_rule_at_every_point(made: Places) -> None:
    points = {(row["r_comm"], row["rule"]) for row in rows_of(made, "range")}
    assert points == {
        (r_comm, rule)
        for r_comm in ("0", "6")
        for rule in ("gatar", "gatar-paper", "greedy", "nearest", "random", "gatar-greedy")
    }
    assert {row["robots"] for row in rows_of(made, "team")} == {"2", "4"}
    assert {row["kills"] for row in rows_of(made, "kills")} == {"0", "1"}
    assert {row["allocator"] for row in rows_of(made, "missions")} >= {"gatar-paper", "gatar-greedy", "cbba", "routing"}


def test_the_page_shows_every_picture_that_was_drawn_and_no_other(made: Places) -> None:
    text = (made.out / PAGE).read_text()
    pictures = {path.name for path in made.out.iterdir() if path.suffix in {".svg", ".png"}}
    assert pictures == {name.split(")")[0] for name in text.split("](")[1:] if "://" not in name.split(")")[0]}
    assert "Plain greedy on the shared view" in text or "Better than greedy" in text
    assert "fewer steps than gatar-" in text
    assert str(made.runs) not in text


def test_what_was_made_is_not_made_again_and_comes_out_the_same(made: Places, tmp_path: Path) -> None:
    weights = {path: path.stat().st_mtime_ns for path in made.runs.rglob("model.safetensors")}
    assert len(weights) == len(runs())
    again = Places(tmp_path, made.runs, made.data)
    reproduce(again, SMALLEST, 1, lambda share, text: None, "gatar eval paper")
    assert {path: path.stat().st_mtime_ns for path in weights} == weights
    for name in ("table2.csv", "missions.csv", "team.csv", "range.svg"):
        assert (tmp_path / name).read_bytes() == (made.out / name).read_bytes()
    assert "no maps were given" in (tmp_path / PAGE).read_text()
    assert not (tmp_path / "city.png").exists()


def test_ablated_channels_are_those_of_the_row() -> None:
    assert [channels_of(row) for row in TABLE_3] == [  # reward, Gaussian, obstacle, product
        [False, False, True, False],
        [False, True, True, True],
        [True, True, True, False],
        [True, True, True, True],
        [True, True, True, True],
    ]


def test_a_city_mission_credits_each_target_to_the_first_robot_there(city_maps: Path) -> None:
    flown = cover(city_maps / "blocks.map", "greedy", 9000)
    assert flown.found_by
    for cell, robot_id in flown.found_by.items():
        arrival = {one: track.index(cell) for one, track in flown.tracks.items() if cell in track[1:]}
        assert flown.tracks[robot_id].index(cell) == min(arrival.values())
    assert len(flown.tracks[1]) <= 41


def test_a_network_is_decoded_for_batches_as_for_single_views() -> None:
    group = worlds(Conditions("2A2G", 40))
    rule = network_rule(build("gnn", TINY_OF["gnn"]).eval())
    together = rule(batch_of(group, np.arange(8)))
    for index, one in enumerate(together):
        alone = rule(batch_of(group, np.arange(index, index + 1)))[0]
        assert np.array_equal(one.choices, alone.choices)
        np.testing.assert_allclose(one.xy, alone.xy, atol=1e-4)


def test_a_table_is_exact_for_machines_and_short_for_people(tmp_path: Path) -> None:
    table = Table("t", ("name", "share"), (("a", 0.123456789), ("b", None)))
    table.write(tmp_path)
    assert (tmp_path / "t.csv").read_text() == "name,share\na,0.12346\nb,\n"
    assert table.markdown("share").splitlines() == ["| share |", "| --- |", "| 0.12 |", "| - |"]


def test_the_quick_form_is_a_smaller_plan_of_the_same_parts() -> None:
    assert QUICK.steps * len(runs()) < 500
    assert set(QUICK.sizes) == set(TABLE_2)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--minutes-per-network", "1", "--steps", "5"], "either --minutes-per-network or --steps"),
        (["--maps", "."], r"holds no \*.map file"),
    ],
)
def test_options_that_make_no_sense_are_refused_before_anything_is_trained(
    options: list[str], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(command, ["--quick", *options])
    assert isinstance(result.exception, ConfigError)
    with pytest.raises(ConfigError, match=message):
        raise result.exception
    assert not (tmp_path / "runs").exists()
