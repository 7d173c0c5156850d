"""The curves of a run: means of what was learned, no step twice after a kill, and a picture."""

import json
import shutil

import pytest
from click.testing import CliRunner
from learning import tiny_run

from gatar_edge.commands.train import command
from gatar_edge.errors import ConfigError
from gatar_edge.learn.curves import EVERY, LOG, Curves, plot, read


def progress(step):
    return {"step": step, "loss": float(step), "exact": 0.5, "done": 0.1, "seconds": 1.0 * step, "rate": 1e-3}


def written(folder, first, last):
    with Curves(folder, first - 1) as curves:
        for step in range(first, last + 1):
            curves.add(progress(step))


def test_a_line_is_the_mean_of_its_steps(tmp_path):
    written(tmp_path, 1, 2 * EVERY)
    lines = read(tmp_path)
    assert [line["step"] for line in lines] == [EVERY, 2 * EVERY]
    assert lines[0]["loss"] == pytest.approx((EVERY + 1) / 2)


def test_the_last_steps_of_a_run_are_a_line_too(tmp_path):
    written(tmp_path, 1, EVERY + 3)
    assert [line["step"] for line in read(tmp_path)] == [EVERY, EVERY + 3]


def test_a_run_that_goes_on_writes_no_step_twice(tmp_path):
    written(tmp_path, 1, 5 * EVERY)
    with (tmp_path / LOG).open("a") as log:
        log.write('{"step": 999, "lo')  # the line at which it was killed
    written(tmp_path, 2 * EVERY + 1, 6 * EVERY)
    assert [line["step"] for line in read(tmp_path)] == [n * EVERY for n in range(1, 7)]


@pytest.mark.parametrize("name", ["curves.svg", "curves.png"])
def test_the_curves_are_drawn(tmp_path, name):
    written(tmp_path, 1, 5 * EVERY)
    plot(tmp_path, tmp_path / name)
    data = (tmp_path / name).read_bytes()
    assert len(data) > 5000
    assert b"<svg" in data or data.startswith(b"\x89PNG")


def test_the_command_draws_the_curves_of_a_run_into_its_folder(tmp_path):
    run = tmp_path / "run"
    shutil.copytree(tiny_run(), run)
    result = CliRunner().invoke(command, ["--plot", str(run)])
    assert result.exit_code == 0, result.output
    assert "<svg" in (run / "curves.svg").read_text()


@pytest.mark.parametrize("content", [None, ""])
def test_a_folder_without_curves_is_named(tmp_path, content):
    if content is not None:
        (tmp_path / LOG).write_text(content)
    with pytest.raises(ConfigError, match=str(tmp_path)):
        plot(tmp_path, tmp_path / "curves.svg")


def test_a_picture_of_an_unknown_kind_is_one_clear_line(tmp_path):
    written(tmp_path, 1, EVERY)
    with pytest.raises(ConfigError, match="cannot draw"):
        plot(tmp_path, tmp_path / "curves.unknown")


def test_lines_are_json(tmp_path):
    written(tmp_path, 1, EVERY)
    assert json.loads((tmp_path / LOG).read_text())["rate"] == 1e-3
