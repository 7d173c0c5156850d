"""What is trained, judged and flown, how much of it, and what the paper reports (LEARNING tables and figures)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from gatar_edge.features import CHANNELS
from gatar_edge.policy import MODELS

# Table 2, 6A6G: 90th percentile, median and mean distance in cells, on the authors' data after 20 epochs
PAPER_TABLE_2 = {
    "gatar-paper": (4.3928, 0.8156, 1.6308),
    "gnn": (4.5618, 0.8755, 1.7180),
    "gnn-vcycle": (4.6152, 0.8452, 1.6996),
    "magat": (5.4553, 0.8588, 1.8746),
}
TABLE_2 = ("gatar", "gatar-paper", "gat", "gnn", "gnn-vcycle", "magat")

LABELS = {
    "gatar": "gatar (ours)",
    "gatar-paper": "GATAR in the paper's shape",
    "gat": "GAT",
    "gnn": "GNN",
    "gnn-vcycle": "GNN + V-cycle",
    "magat": "MAGAT",
    "gatar-greedy": "gatar-greedy (shipped)",
    "gatar-field": "gatar-field (shipped)",
    "greedy": "greedy on the shared view",
    "nearest": "nearest, no communication",
    "random": "random known target",
}


def shipped_models() -> dict[str, str]:
    """Allocators of the models that fly, by name; the last is the best. The paper's shape is judged by its own run."""
    files = (MODELS / f"{name}.onnx" for name in ("gatar-greedy", "gatar-field"))
    return {path.stem: f"gatar:{path}" for path in files if path.is_file()}


@dataclass(frozen=True, slots=True)
class Run:
    """One network to train."""

    name: str
    network: str
    settings: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Ablation:
    """A row of Table 3: which parts are there, the run that shows it, and the paper's median and mean."""

    gaussian: bool
    product: bool
    reward: bool
    vcycle: bool
    run: str
    paper: tuple[float, float]


TABLE_3 = (
    Ablation(False, False, False, True, "without-maps", (1.47, 2.02)),
    Ablation(True, True, False, True, "without-reward", (1.41, 2.00)),
    Ablation(True, False, True, True, "without-product", (1.19, 1.86)),
    Ablation(True, True, True, False, "gat", (1.59, 2.13)),
    Ablation(True, True, True, True, "gatar-paper", (0.81, 1.63)),
)


def runs() -> tuple[Run, ...]:
    """Everything that is trained: Table 2's networks, and Table 3's that are not among them."""
    ablated = [row for row in TABLE_3 if row.run not in TABLE_2]
    return (
        *(Run(name, name) for name in TABLE_2),
        *(Run(row.run, "gatar-paper", {"channels": channels_of(row)}) for row in ablated),
    )


def channels_of(row: Ablation) -> list[bool]:
    """Which of `features.CHANNELS` the row sees."""
    seen = {"gaussian_target": row.gaussian, "product": row.product, "reward": row.reward, "obstacle": True}
    return [seen[name] for name in CHANNELS]


@dataclass(frozen=True, slots=True)
class Scale:
    """How much of everything."""

    data_samples: int = 1_500_000
    minutes: float = 0.0  # of training a network; 0: by steps
    steps: int = 2500  # of every network, on the same batches: equal data, as the paper's equal epochs
    batch: int = 64
    sizes: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)  # settings by network, on top of the run's
    samples: int = 3000  # labelled robots in the tables
    curve_samples: int = 1000  # and at each point of a curve
    ranges: tuple[float, ...] = (0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10)
    teams: tuple[str, ...] = ("1A1G", "2A2G", "3A3G", "4A4G", "5A5G", "6A6G")
    missions: int = 100  # of each allocator in the comparison
    mission_teams: tuple[str, ...] = ("1A1G", "3A3G", "6A6G")
    curve_missions: int = 50
    curve_team: str = "6A6G"
    losses: tuple[float, ...] = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5)
    delays: tuple[int, ...] = (0, 1, 2, 3)
    kills: tuple[int, ...] = (0, 1, 2, 3, 4, 5)
    city_missions: int = 5  # windows of each map
    size: int = 15  # cells a side of the missions' worlds


SMALL_SHAPE = {"width": 32, "conv_channels": 4, "hidden": 16}
QUICK = Scale(
    data_samples=2 * 12 * 1024, steps=40, batch=16,
    sizes={
        "gatar": {"width": 16, "heads": 2, "levels": [1, 2, 2, 1], "conv_channels": 2},
        **dict.fromkeys(TABLE_2[1:], SMALL_SHAPE),
    },
    samples=150, curve_samples=60, ranges=(0, 6, 10), teams=("1A1G", "6A6G"),
    missions=2, mission_teams=("3A3G",), curve_missions=1, losses=(0.0, 0.5), delays=(0, 3), kills=(0, 2),
    city_missions=1,
)  # fmt: skip
