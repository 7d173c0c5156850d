"""Data made by a Dask cluster: the same shards, written here, and clear words where there is no cluster."""

import json
import shutil

import pytest
from click.testing import CliRunner
from distributed import LocalCluster
from learning import OPTIONS, tiny_data

from gatar_edge.commands.dataset import command
from gatar_edge.errors import ConfigError, LinkError
from gatar_edge.learn import cluster, dataset
from gatar_edge.learn.dataset import MANIFEST, generate


@pytest.fixture(scope="module")
def scheduler():
    """The address of a scheduler with two workers, all in this process, speaking TCP."""
    with LocalCluster(
        n_workers=2, threads_per_worker=1, processes=False, protocol="tcp://", dashboard_address=None
    ) as local:
        yield local.scheduler_address


def test_a_cluster_makes_the_same_shards(tmp_path, scheduler):
    line = ["--team", "1A1G", "--team", "2A2G", "--r-comm", "6", "--r-comm", "3", "--samples", str(6 * 1024)]
    result = CliRunner().invoke(command, [*line, "--seed", "5", "--scheduler", scheduler, "--out", str(tmp_path)])
    assert result.exit_code == 0, result.output
    assert json.loads((tmp_path / MANIFEST).read_text()) == json.loads((tiny_data() / MANIFEST).read_text())


def test_only_the_shards_that_are_missing_are_made(tmp_path, scheduler, monkeypatch):
    folder = tmp_path / "data"
    shutil.copytree(tiny_data(), folder)
    shutil.rmtree(folder / "shard-00001")
    made = []
    store = dataset.store
    monkeypatch.setattr(
        cluster, "store", lambda options, number, *rest: made.append(number) or store(options, number, *rest)
    )
    generate(OPTIONS, folder, 1, scheduler=scheduler)
    assert made == [1]


def test_a_worker_of_another_version_is_named(tmp_path, scheduler, monkeypatch):
    monkeypatch.setattr(cluster, "__version__", "0.0.other")
    monkeypatch.setattr(cluster, "version_here", lambda: "0.0.theirs")
    with pytest.raises(ConfigError, match=r"has gatar-edge 0\.0\.theirs, this is 0\.0\.other"):
        generate(OPTIONS, tmp_path, 1, scheduler=scheduler)


def test_a_scheduler_that_does_not_answer_is_one_clear_line(tmp_path, monkeypatch):
    monkeypatch.setattr(cluster, "CONNECT_TIMEOUT_S", 0.2)
    with pytest.raises(LinkError, match=r"no Dask scheduler answers at tcp://127\.0\.0\.1:9"):
        generate(OPTIONS, tmp_path, 1, scheduler="tcp://127.0.0.1:9")
