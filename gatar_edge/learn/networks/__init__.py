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
    try:
        return network(config(**settings))
    except TypeError as error:
        raise ConfigError(f"network {name}: {error}") from None


def settings_of(network: Any) -> dict[str, Any]:
    """The config of a network as plain JSON values, such that `build` makes the same one."""
    settings: dict[str, Any] = json.loads(json.dumps(asdict(network.config)))
    return settings
