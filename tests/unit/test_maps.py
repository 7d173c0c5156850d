"""City maps: read right, bounded, and refused with the line that is wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gatar_edge.errors import WorldError
from gatar_edge.sim_sitl.maps import read_map, window_world
from gatar_edge.sim_sitl.world import Team

HEADER = "type octile\nheight {}\nwidth {}\nmap\n"
ROWS = ["@.....", "......", "..T...", "......", ".....W"]


def write(folder: Path, text: str) -> Path:
    path = folder / "town.map"
    path.write_text(text)
    return path


def test_first_row_of_a_map_is_its_north(tmp_path: Path) -> None:
    obstacles = read_map(write(tmp_path, HEADER.format(5, 6) + "\n".join(ROWS) + "\n"))
    assert obstacles.shape == (6, 5)
    assert np.argwhere(obstacles).tolist() == [[0, 4], [2, 2], [5, 0]]


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "does not begin"),
        ("type octile\nwidth 6\nheight x\nmap\n", "must be numbers"),
        (HEADER.format(5, 9999), "must be numbers of 5 to"),
        (HEADER.format(5, 6) + "\n".join(ROWS[:3]), "ends after 3 of 5 rows"),
        (HEADER.format(5, 6) + "\n".join([*ROWS[:4], "..."]), "line 9: 3 signs"),
        (HEADER.format(5, 6) + "\n".join([*ROWS[:4], "..x..."]), "line 9: sign 'x'"),
    ],
)
def test_bad_map_is_refused_with_what_is_wrong(tmp_path: Path, text: str, complaint: str) -> None:
    with pytest.raises(WorldError, match=complaint):
        read_map(write(tmp_path, text))


def test_missing_and_endless_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(WorldError, match="cannot be read"):
        read_map(tmp_path / "none.map")
    with pytest.raises(WorldError, match="larger than"):
        read_map(Path("/dev/zero"))


def test_same_seed_cuts_the_same_window() -> None:
    city = np.random.default_rng(0).random((60, 40)) < 0.3
    one, other = (window_world(city, 20, Team.parse("2A2G"), 10, 7) for _ in range(2))
    assert one.obstacles.shape == (20, 20)
    assert np.array_equal(one.obstacles, other.obstacles)
    assert np.array_equal(one.targets, other.targets)
    assert one.starts == other.starts
    assert not one.obstacles[tuple(one.targets.T)].any()


def test_windows_that_are_nearly_all_buildings_are_drawn_again() -> None:
    city = np.ones((100, 20), dtype=np.bool_)
    city[60:80] = False
    assert (~window_world(city, 20, Team.parse("1A1G"), 5, 0).obstacles).mean() >= 0.3


def test_window_larger_than_the_map_or_without_free_cells_is_refused() -> None:
    with pytest.raises(WorldError, match="window of 50"):
        window_world(np.zeros((60, 40), dtype=np.bool_), 50, Team.parse("1A1G"), 5, 0)
    with pytest.raises(WorldError, match="no window"):
        window_world(np.ones((60, 40), dtype=np.bool_), 20, Team.parse("1A1G"), 5, 0)


def test_real_city_maps_are_read(shared_folder: Path) -> None:
    for path in sorted((shared_folder / "maps").glob("*.map")):
        obstacles = read_map(path)
        assert obstacles.shape == (256, 256)
        assert 0.1 < obstacles.mean() < 0.6
