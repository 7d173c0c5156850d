"""What all commands have in common: an example in the help, one line for what cannot be, and no number that is none."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import click
import pytest

from gatar_edge.cli import gatar
from gatar_edge.commands._options import FiniteRange

CHECKED_BY_WHAT_THEY_MAKE = {"gatar init", "gatar dataset"}  # settings that refuse what is no number


def commands(command: click.Command = gatar, path: str = "gatar") -> Iterator[tuple[str, click.Command]]:
    yield path, command
    if isinstance(command, click.Group):
        context = click.Context(command)
        for name in command.list_commands(context):
            found = command.get_command(context, name)
            assert found is not None
            yield from commands(found, f"{path} {name}")


def run(*arguments: str, stdout: int | None = subprocess.PIPE) -> subprocess.CompletedProcess[str]:
    program = [sys.executable, "-m", "gatar_edge", *arguments]
    return subprocess.run(
        program, stdin=subprocess.DEVNULL, stdout=stdout, stderr=subprocess.PIPE, text=True, check=False
    )


@pytest.mark.parametrize(("path", "command"), list(commands()), ids=[path for path, _ in commands()])
def test_every_command_has_an_example_and_takes_no_number_that_is_none(path: str, command: click.Command) -> None:
    assert "Example" in (command.help or "")
    if path not in CHECKED_BY_WHAT_THEY_MAKE:
        numbers = [p for p in command.params if p.type.name in ("float", "float range")]
        assert [p.name for p in numbers if not isinstance(p.type, FiniteRange)] == []


@pytest.mark.parametrize("number", ["nan", "inf", "-inf", "1e999"])
def test_a_finite_range_refuses_what_is_no_number(number: str) -> None:
    with pytest.raises(click.BadParameter):
        FiniteRange().convert(number, None, None)


def test_a_question_that_nobody_answers_is_wrong_usage(tmp_path: Path) -> None:
    done = run("init", "--config", str(tmp_path / "vehicle.toml"), "--kind", "UAV")
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].startswith("gatar: an answer is missing")


def test_what_the_system_refuses_is_one_line() -> None:
    full = Path("/dev/full")
    if not full.exists():
        pytest.skip("this system has no /dev/full")
    with full.open("w") as stream:
        done = run("init", "--help", stdout=stream.fileno())
    assert done.returncode == 2
    assert done.stderr.splitlines() == ["gatar: [Errno 28] No space left on device"]
