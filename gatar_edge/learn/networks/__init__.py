"""The networks, one file each, and the registry by which they are named on the command line."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Any

from torch import nn

from gatar_edge.errors import ConfigError
from gatar_edge.learn.networks.gat import Gat, GatConfig
from gatar_edge.learn.networks.gatar import Gatar
from gatar_edge.learn.networks.gatar_paper import GatarPaper, GatarPaperConfig
from gatar_edge.learn.networks.gatar_round import GatarConfig
from gatar_edge.learn.networks.gnn import Gnn
from gatar_edge.learn.networks.gnn_vcycle import GnnVcycle, GnnVcycleConfig
from gatar_edge.learn.networks.magat import Magat
from gatar_edge.learn.networks.paper_shape import PaperConfig

NETWORKS: dict[str, tuple[type[nn.Module], type[Any]]] = {
    "gatar": (Gatar, GatarConfig),
    "gatar-paper": (GatarPaper, GatarPaperConfig),
    "gat": (Gat, GatConfig),
    "gnn": (Gnn, PaperConfig),
    "gnn-vcycle": (GnnVcycle, GnnVcycleConfig),
    "magat": (Magat, GatConfig),
}


def build(name: str, settings: dict[str, Any] | None = None) -> nn.Module:
    """A fresh network by name, with some fields of its config set. Raises ConfigError."""
    if name not in NETWORKS:
        raise ConfigError(f"network {name!r} is not one of {', '.join(NETWORKS)}")
    network, config = NETWORKS[name]
    settings = {key: tuple(value) if isinstance(value, list) else value for key, value in (settings or {}).items()}
    _check(name, {**asdict(config()), **settings}, asdict(config()))
    return network(config(**settings))


def _check(name: str, settings: dict[str, Any], usual: dict[str, Any]) -> None:
    """Raises ConfigError where a network could not be built, or would fail at its first batch."""
    for field, value in settings.items():
        if field not in usual:
            raise ConfigError(f"network {name} has no setting {field!r}: {', '.join(usual)}")
        if not _is_like(value, usual[field]):
            example = json.dumps(usual[field])
            raise ConfigError(
                f"network {name}: {field} is {json.dumps(value)}, must be like {example}; numbers are at least 1"
            )
    if len(settings["channels"]) != len(usual["channels"]):
        raise ConfigError(f"network {name}: channels are {len(usual['channels'])}, got {len(settings['channels'])}")
    heads = settings.get("heads", 1)
    for field in ("width", "bottom"):
        if settings.get(field, heads) % heads:
            raise ConfigError(f"network {name}: {field} is {settings[field]}, must be a multiple of heads, {heads}")


def _is_like(value: Any, usual: Any) -> bool:
    """Whether a setting is of the same kind as the usual one, and no number is below 1."""
    if isinstance(usual, tuple):
        return isinstance(value, tuple) and len(value) > 0 and all(_is_like(each, usual[0]) for each in value)
    return type(value) is type(usual) and (isinstance(value, bool) or value >= 1)


def settings_of(network: Any) -> dict[str, Any]:
    """The config of a network as plain JSON values, such that `build` makes the same one."""
    settings: dict[str, Any] = json.loads(json.dumps(asdict(network.config)))
    return settings
