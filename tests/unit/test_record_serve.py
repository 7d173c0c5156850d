"""Runs in the browser, and what would have happened otherwise."""

from __future__ import annotations

import json
import threading
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest
from missions import record_mission

from gatar_edge.allocators.greedy import Greedy
from gatar_edge.allocators.nearest import Nearest
from gatar_edge.errors import ConfigError, LinkError, LogError
from gatar_edge.record import Recorder
from gatar_edge.review.reader import LogReader
from gatar_edge.review.serve import Server, open_server
from gatar_edge.review.whatif import Change, what_if
from gatar_edge.types import NS_PER_S


@pytest.fixture
def server(tmp_path: Path) -> Iterator[Server]:
    (tmp_path / "north").mkdir()
    record_mission(tmp_path / "north" / "done & dusted.mcap")
    record_mission(tmp_path / "flying.mcap", steps=5, close=False)
    (tmp_path / "broken.mcap").write_text("nothing of the kind")
    (tmp_path / "secret.txt").write_text("not to be served")
    opened = open_server(tmp_path, "127.0.0.1", 0)
    thread = threading.Thread(target=opened.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    yield opened
    opened.shutdown()
    opened.server_close()
    thread.join()


def get(server: Server, path: str) -> tuple[int, str]:
    try:
        with urllib.request.urlopen(f"http://127.0.0.1:{server.server_port}{path}", timeout=20) as answer:
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as error:
        with error:
            return error.code, error.read().decode()


def test_the_list_names_every_run_and_what_it_is(server: Server) -> None:
    status, page = get(server, "/")
    assert status == 200
    assert "/run/north/done%20%26%20dusted.mcap" in page
    assert page.count("2A2G") == 2
    assert ">complete<" in page
    assert ">open<" in page
    assert "no MCAP file" in page


def test_a_complete_run_is_shown_and_does_not_ask_for_news(server: Server) -> None:
    status, page = get(server, "/run/north/done%20%26%20dusted.mcap")
    assert status == 200
    assert 'data-live=""' in page


def test_a_run_that_is_being_recorded_asks_for_news_and_gets_them(server: Server) -> None:
    _, page = get(server, "/run/flying.mcap")
    assert 'data-live="/data/flying.mcap"' in page
    _, data = get(server, "/data/flying.mcap")
    story = json.loads(data)
    assert not story["finished"]
    assert story["events"]


@pytest.mark.parametrize(
    "path", ["/secret.txt", "/run/secret.txt", "/run/../secret.txt", "/run//etc/passwd", "/data/x", "/run/", "/x"]
)
def test_nothing_else_is_served(server: Server, path: str) -> None:
    assert get(server, path)[0] == 404


def test_a_broken_log_is_answered_with_one_line(server: Server) -> None:
    status, text = get(server, "/run/broken.mcap")
    assert status == 422
    assert "no MCAP file" in text


def test_a_missing_folder_and_a_taken_port_are_refused(server: Server, tmp_path: Path) -> None:
    with pytest.raises(LogError, match="no folder"):
        open_server(tmp_path / "none", "127.0.0.1", 0)
    with pytest.raises(LinkError, match="--port"):
        open_server(tmp_path, "127.0.0.1", server.server_port)


def test_going_on_unchanged_gives_the_same_twice(tmp_path: Path) -> None:
    record_mission(tmp_path / "a.mcap")
    result = what_if(LogReader(tmp_path / "a.mcap"), lambda _: Greedy(), Change(from_s=4.0))
    assert result["as_it_was"] == result["changed"]
    assert result["as_it_was"]["localized"] == result["as_it_was"]["reachable"] > 0


def test_going_on_from_the_start_ends_as_the_recorded_mission_did(tmp_path: Path) -> None:
    flown = record_mission(tmp_path / "a.mcap")
    assert not flown.open_targets
    result = what_if(LogReader(tmp_path / "a.mcap"), lambda _: Greedy(), Change(from_s=5.0))
    visited_before = sum(step <= 5 for step in flown.visited_at)
    assert result["as_it_was"]["localized"] == len(flown.visited_at) - visited_before
    assert result["as_it_was"]["steps_100"] == flown.steps - 5


def test_fewer_robots_another_radio_and_another_rule_change_the_end(tmp_path: Path) -> None:
    record_mission(tmp_path / "a.mcap")
    change = Change(from_s=3.0, drop_robots=(1, 2), r_comm=1.0, allocator=Nearest)
    result = what_if(LogReader(tmp_path / "a.mcap"), lambda _: Greedy(), change)
    assert result["changed"]["robots"] == [3, 4]
    assert result["changed"]["distance_cells"]["UAV"] == 0
    assert result["changed"]["steps_100"] > result["as_it_was"]["steps_100"]


@pytest.mark.parametrize("drop", [(9,), (1, 2, 3, 4)])
def test_only_robots_that_fly_can_be_left_out_and_not_all(tmp_path: Path, drop: tuple[int, ...]) -> None:
    record_mission(tmp_path / "a.mcap")
    with pytest.raises(ConfigError, match="1, 2, 3, 4"):
        what_if(LogReader(tmp_path / "a.mcap"), lambda _: Greedy(), Change(drop_robots=drop))


def test_a_log_without_truth_cannot_be_gone_on_from(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "a.mcap", {"robots": [], "config": {}, "allocator": "greedy"}, 0)
    recorder.poll(NS_PER_S)
    recorder.close()
    with pytest.raises(LogError, match="no truth"):
        what_if(LogReader(tmp_path / "a.mcap"), lambda _: Greedy(), Change())
