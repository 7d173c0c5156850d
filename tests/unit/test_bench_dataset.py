"""The measurement of data generation."""

import json

import pytest
from click.testing import CliRunner

from gatar_edge.commands.bench_dataset import command

pytestmark = pytest.mark.usefixtures("compiled")


def test_the_rate_of_labelled_samples_is_below_that_of_all_and_above_nothing():
    result = CliRunner().invoke(command, ["--team", "1A1G", "--shards", "1", "--json"])
    assert result.exit_code == 0, result.output
    speed = json.loads(result.stdout)
    assert 0 < speed["labelled_per_cpu_s"] <= speed["samples_per_cpu_s"]
    assert speed["bytes_per_sample"] <= 150
