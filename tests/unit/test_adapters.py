"""From a costmap or detections to cells: the right way round, and only what was really seen."""

from __future__ import annotations

import numpy as np

from gatar_edge.adapters import cells_from_costmap, cells_from_detections
from gatar_edge.bridge.geo import cell_to_wgs84
from gatar_edge.types import GridSpec

GRID = GridSpec(width=4, height=3, cell_m=2.0, heading_deg=30.0)


def test_a_costmap_lands_the_right_way_round_on_the_grid() -> None:
    costmap = np.full((6, 8), 0, np.int8)  # 1 m: two samples a cell side
    costmap[0, 7] = 100  # south-east corner
    costmap[4:, :2] = -1  # north-west cell unknown
    seen, blocked = cells_from_costmap(costmap, (0.0, 0.0), 1.0, GRID)
    assert blocked.tolist() == [[3, 0]]
    assert len(seen) == 11
    assert [0, 2] not in seen.tolist()


def test_a_costmap_that_sticks_out_counts_only_where_it_covers_half_a_cell() -> None:
    costmap = np.zeros((4, 4), np.int8)
    seen, blocked = cells_from_costmap(costmap, (-3.0, -3.0), 1.0, GRID)
    assert seen.tolist() == []
    assert cells_from_costmap(costmap, (-2.0, -2.0), 1.0, GRID)[0].tolist() == [[0, 0]]
    assert blocked.shape == (0, 2)


def test_detections_become_cells_once_each_and_strangers_are_left_out() -> None:
    here = cell_to_wgs84(GRID, (3, 1))
    assert cells_from_detections([here, here, (0.0, 0.0)], GRID).tolist() == [[3, 1]]
    assert cells_from_detections([], GRID).shape == (0, 2)
