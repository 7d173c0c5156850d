"""The network itself: decentralized, indifferent to the order of neighbours, finite when alone; and its ablations."""

import numpy as np
import pytest
import torch
from learning import TINY_AHEAD, TINY_OF

from gatar_edge.allocators.gatar import decode
from gatar_edge.export.spec import SingleView
from gatar_edge.export.states import random_view
from gatar_edge.features import AXES, CHANNELS, LENGTH_SCALE_CELLS, arrays_of, features, features_of
from gatar_edge.learn.networks import NETWORKS, build, settings_of
from gatar_edge.learn.networks.paper_shape import PaperShaped, XyOutputs

SMALL = {"width": 16, "heads": 2}


@pytest.fixture(params=[*sorted(NETWORKS), "gatar that looks ahead"])
def network(request):
    torch.manual_seed(0)
    if request.param in NETWORKS:
        return SingleView(build(request.param, TINY_OF[request.param])).eval()
    return SingleView(build("gatar", TINY_AHEAD)).eval()


def looks_ahead(network):
    return "places" in network.inputs


def seen_by(network, view):
    """The network's input, with frontiers where it asks for them."""
    return features(view, with_frontiers=looks_ahead(network))


def outputs(network, inputs):
    with torch.inference_mode():
        return [
            o.numpy() for o in network(*(torch.from_numpy(np.ascontiguousarray(inputs[n])) for n in network.inputs))
        ]


def without_edges_to(inputs, robot):
    """The same view with one robot out of everybody's reach."""
    hops = inputs["hops"].copy()
    hops[robot, :] = hops[:, robot] = -1
    hops[robot, robot] = 0
    return {**inputs, "hops": hops}


@pytest.mark.parametrize("seed", range(5))
def test_a_robot_outside_the_graph_changes_no_bit_of_the_output(network, seed):
    rng = np.random.default_rng(seed)
    robot = 3
    inputs = without_edges_to(seen_by(network, random_view(6, 9, seed, 1000.0)), robot)
    other = {name: array.copy() for name, array in inputs.items()}
    for name in ("maps", "robots", "pairs"):
        row = other[name][robot]
        kept = row[..., 2].copy()
        row[...] = rng.normal(size=row.shape) * 10
        if name == "robots":
            row[..., 2] = kept  # its place in the order of ids is no news from it
    other["valid"][robot] = rng.integers(0, 2, size=other["valid"][robot].shape)
    before, after = outputs(network, inputs), outputs(network, other)
    rest = [row for row in range(6) if row != robot]
    assert before[0][rest].tobytes() == after[0][rest].tobytes()
    assert before[1].tobytes() == after[1].tobytes()
    assert before[2].tobytes() == after[2].tobytes()
    assert before[2][robot] == 0


def test_a_robot_two_hops_away_does_change_the_output(network):
    changed = 0
    for seed in range(5):
        inputs = seen_by(network, random_view(6, 9, seed, 6.0))
        far = np.flatnonzero(inputs["hops"][0] == 2)
        if not len(far):
            continue
        other = {name: array.copy() for name, array in inputs.items()}
        for name in ("pairs", "maps"):
            other[name][far[0]] = other[name][far[0], ::-1]
        changed += not np.array_equal(outputs(network, inputs)[0][0], outputs(network, other)[0][0])
    assert changed > 0


@pytest.mark.parametrize("seed", range(5))
def test_another_order_of_neighbours_gives_the_same_assignment(network, seed):
    view = random_view(7, 10, seed, 6.0)
    arrays = arrays_of(view, looks_ahead(network))
    order = np.array([0, *(np.random.default_rng(seed).permutation(6) + 1)])
    rows = {name: getattr(arrays, name)[order] for name in ("distances", "robots", "kinds", "speeds", "ids", "tasks")}
    shuffled = type(arrays)(
        belief=arrays.belief, ages_s=arrays.ages_s[order], present=arrays.present[order], targets=arrays.targets,
        listed=arrays.listed, dark=arrays.dark, hops=arrays.hops[np.ix_(order, order)], **rows,
    )  # fmt: skip
    plain, mixed = outputs(network, features_of(arrays)), outputs(network, features_of(shuffled))
    np.testing.assert_allclose(mixed[0], plain[0][order], atol=1e-5)

    def chosen(scores, ids, valid):
        return decode(scores, valid > 0, np.argsort(ids))

    one = chosen(plain[0], arrays.ids, features_of(arrays)["valid"])
    other = chosen(mixed[0], shuffled.ids, features_of(shuffled)["valid"])
    np.testing.assert_array_equal(other, one[order])


@pytest.mark.parametrize("candidates", [0, 1, 12])
def test_a_robot_alone_gets_finite_numbers(network, candidates):
    for output in outputs(network, seen_by(network, random_view(1, candidates, 2, 6.0))):
        assert np.isfinite(output).all()


def test_what_is_not_valid_is_never_scored(network):
    inputs = seen_by(network, random_view(5, 8, 1, 6.0))
    inputs["valid"][:, 3] = 0
    assert (outputs(network, inputs)[0][:, 3] == 0).all()


@pytest.mark.parametrize("part", ["maps", "attention", "competition", "summary", "order", "shortcuts", "shared"])
def test_each_part_can_be_taken_away(part):
    network = SingleView(build("gatar", {**SMALL, part: False})).eval()
    scores, xy, attention = outputs(network, features(random_view(4, 6, 0, 6.0)))
    assert scores.shape == (4, 7)
    assert xy.shape == (2,)
    assert attention.shape == (4,)
    assert np.isfinite(scores).all()


def test_a_network_without_maps_does_not_ask_for_them():
    assert set(build("gatar", SMALL).inputs) - set(build("gatar", {**SMALL, "maps": False}).inputs) == {"maps", "cells"}


@pytest.mark.parametrize("part", ["ahead", "tour"])
def test_what_lies_behind_a_frontier_and_what_lies_near_a_candidate_count(part):
    """A network with `ahead` alone sees what a place may hide, one with `tour` alone that two candidates are near."""
    torch.manual_seed(0)
    network = SingleView(build("gatar", {**SMALL, part: True})).eval()
    inputs = features(random_view(3, 6, 0, 6.0), with_frontiers=True)
    name, row = ("places", -1) if part == "ahead" else ("offsets", 0)
    other = {**inputs, name: inputs[name].copy()}
    other[name][row] += 3
    before, after = (outputs(network, given)[0] for given in (inputs, other))
    assert not np.array_equal(before, after)
    plain = SingleView(build("gatar", SMALL)).eval()
    np.testing.assert_array_equal(outputs(plain, inputs)[0], outputs(plain, other)[0])


def test_each_channel_can_be_taken_away():
    torch.manual_seed(0)
    inputs = features(random_view(4, 6, 0, 6.0))
    network = SingleView(build("gatar", {**SMALL, "channels": [True, False, True, True]})).eval()
    other = {**inputs, "maps": inputs["maps"].copy()}
    other["maps"][:, 1] = 7.0
    np.testing.assert_array_equal(outputs(network, inputs)[0], outputs(network, other)[0])


PAPER_SHAPED = sorted(name for name in NETWORKS if issubclass(NETWORKS[name][0], PaperShaped))


@pytest.mark.parametrize("name", PAPER_SHAPED)
@pytest.mark.parametrize("channel", CHANNELS)
def test_each_channel_of_the_paper_can_be_taken_away(name, channel):
    """The bare target cells stay where the Gaussian round them goes."""
    torch.manual_seed(0)
    inputs = features(random_view(4, 6, 0, 6.0))
    other = {**inputs, "maps": inputs["maps"].copy()}
    changed = other["maps"][:, CHANNELS.index(channel)]
    changed[changed < 1] = 0.5
    for kept in (True, False):
        seen = [kept or one != channel for one in CHANNELS]
        network = SingleView(build(name, {**TINY_OF[name], "channels": seen})).eval()
        same = np.array_equal(outputs(network, inputs)[1], outputs(network, other)[1])
        assert same is not kept


def test_without_the_v_cycle_the_papers_network_is_plain_graph_attention():
    flat, plain = build("gatar-paper", {**TINY_OF["gatar-paper"], "vcycle": False}), build("gat", TINY_OF["gat"])
    assert {k: v.shape for k, v in flat.state_dict().items()} == {k: v.shape for k, v in plain.state_dict().items()}


@pytest.mark.parametrize("name", PAPER_SHAPED)
def test_networks_of_the_comparison_have_about_the_same_parameters(name):
    count, most = (sum(p.numel() for p in build(n).parameters()) for n in (name, "magat"))
    assert 0.7 < count / most <= 1


@pytest.mark.parametrize("name", PAPER_SHAPED)
def test_an_x_y_network_scores_candidates_by_their_distance_from_its_answer(name):
    torch.manual_seed(0)
    view = random_view(4, 6, 0, 6.0)
    inputs = features(view)
    network = SingleView(build(name, TINY_OF[name])).eval()
    scores, xy, _ = outputs(network, inputs)
    gaps = np.hypot(*(inputs["offsets"] / LENGTH_SCALE_CELLS - xy).T)
    reachable = np.flatnonzero(inputs["valid"][0] > 0)
    assert np.array_equal(np.argsort(gaps[reachable]), np.argsort(-scores[0, reachable]))
    assert scores[0, -1] == 0


def test_the_squared_error_counts_robots_with_a_target_alone():
    ways = torch.tensor([[[[1.0, 0.0], [0.0, 2.0]]] * 3])
    places = torch.tensor([[[1.0, 0.0], [0.0, 0.0], [5.0, 5.0]]])
    empty = torch.zeros(0)
    xy = XyOutputs(empty, empty, empty, (), places, ways)
    labels = torch.tensor([[0, 1, 2]])  # the third robot is to take none
    one, none, half = (torch.tensor([shares]) for shares in ([1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.5, 0.5, 0.0]))
    assert float(xy.squared_error(labels, torch.ones(1, 3), one)) == pytest.approx((0 + 4) / 2)
    assert float(xy.squared_error(labels, torch.ones(1, 3), none)) == pytest.approx(4)
    assert float(xy.squared_error(labels, torch.ones(1, 3), half)) == pytest.approx((0.5**2 + 1 + 4) / 2)
    assert float(xy.squared_error(torch.full((1, 3), -100), torch.zeros(1, 3), none)) == 0


def test_settings_make_the_same_network_again(network):
    name = next(n for n, (cls, _) in NETWORKS.items() if isinstance(network.network, cls))
    again = build(name, settings_of(network.network))
    assert {k: v.shape for k, v in again.state_dict().items()} == {
        k: v.shape for k, v in network.network.state_dict().items()
    }


def test_every_network_reads_only_inputs_that_exist(network):
    assert set(network.inputs) <= set(AXES)
