"""Allocators by name, as `--allocator` takes them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from gatar_edge.allocators.base import Allocator
from gatar_edge.allocators.cbba import Cbba
from gatar_edge.allocators.greedy import Greedy
from gatar_edge.allocators.hungarian import Hungarian
from gatar_edge.allocators.nearest import Nearest
from gatar_edge.allocators.random import Random
from gatar_edge.allocators.routing import Planner, Routing, RoutingWithMemory
from gatar_edge.errors import ConfigError

Make = Callable[[], Allocator]  # one for each robot: an allocator may remember

NAMES = ("gatar", "nearest", "random", "greedy", "routing", "routing+memory", "hungarian", "cbba")
CENTRAL = "central-"  # the same rule where every robot hears all others: a bound, not a rival
BOUNDS = tuple(CENTRAL + rule for rule in ("greedy", "hungarian", "routing"))


def make(name: str, planner: Planner | None = None) -> Make:
    """How to make the allocator `name` of `NAMES` or `BOUNDS`, or `gatar:MODEL.onnx`.

    `planner` serves the routing rule. Raises ConfigError for other names, ModelError for a model that cannot be used.
    """
    rule = name.removeprefix(CENTRAL) if name in BOUNDS else name
    simple: dict[str, Make] = {
        "nearest": Nearest,
        "random": Random,
        "greedy": Greedy,
        "hungarian": Hungarian,
        "cbba": Cbba,
        "routing": lambda: Routing(planner),
        "routing+memory": lambda: RoutingWithMemory(planner),
    }
    if rule in simple:
        return simple[rule]
    network, _, path = rule.partition(":")
    if network == "gatar":
        return _gatar(path)
    raise ConfigError(f"allocator {name!r} is unknown: one of {', '.join(NAMES + BOUNDS)}, or gatar:MODEL.onnx")


def hears_all(name: str) -> bool:
    """Whether the allocator is a bound that stands on unlimited communication."""
    return name in BOUNDS


def _gatar(path: str) -> Make:
    from gatar_edge.allocators.gatar import Gatar  # onnxruntime: 50 ms that no other rule needs
    from gatar_edge.policy import DEFAULT_MODEL

    # it remembers nothing from decision to decision: one serves all robots
    network = Gatar(Path(path) if path else DEFAULT_MODEL)
    return lambda: network
