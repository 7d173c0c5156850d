"""The comparison with the expert."""

import pytest

from gatar_edge.allocators.greedy import Greedy
from gatar_edge.allocators.nearest import Nearest
from gatar_edge.errors import ConfigError
from gatar_edge.learn.evaluate import TEST_SEEDS, Conditions, evaluate, worlds
from gatar_edge.sim_sitl.world import TRAINING_SEEDS

pytestmark = pytest.mark.usefixtures("compiled")


def test_greedy_with_unlimited_radio_is_the_expert():
    scores = evaluate({"greedy_shared": Greedy()}, Conditions("3A3G", 200, r_comm=100.0))
    assert scores["greedy_shared"].every.exact == 1.0
    assert scores["greedy_shared"].every.mean == 0.0
    assert scores["greedy_shared"].knowable.samples == 200


def test_without_communication_rules_fall_behind_and_some_labels_cannot_be_known():
    scores = evaluate({"greedy_shared": Greedy(), "nearest": Nearest()}, Conditions("3A3G", 300, r_comm=0.0))
    assert scores["greedy_shared"].every.exact < 1.0
    assert scores["greedy_shared"].every.mean == scores["nearest"].every.mean  # alone, greedy takes the nearest
    assert scores["nearest"].knowable.samples < scores["nearest"].every.samples == 300


def test_the_same_seed_gives_the_same_scores_and_another_seed_others():
    one, again, other = (evaluate({"nearest": Nearest()}, Conditions("2A2G", 100, seed=s)) for s in (3, 3, 4))
    assert one == again
    assert one != other


def test_worlds_stay_in_the_test_range_even_at_its_end():
    assert TEST_SEEDS < TRAINING_SEEDS
    assert worlds(Conditions("1A1G", 10, seed=TEST_SEEDS - 1)).views > 0


@pytest.mark.timeout(60)
def test_robots_that_see_nothing_are_refused_instead_of_waited_for():
    with pytest.raises(ConfigError, match="no robot ever knows of a target"):
        worlds(Conditions("1A1G", 10, r_sense=0.0))
