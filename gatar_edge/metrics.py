"""The daemon's figures for Prometheus, where prometheus-client (the extra `metrics`) is installed."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Iterator
from typing import Any

from gatar_edge.health import Snapshot


def exporter(latest: Callable[[], Snapshot | None]) -> Callable[[], bytes | None]:
    """A function that gives the Prometheus text of the latest snapshot, or None where the extra is not installed."""
    if importlib.util.find_spec("prometheus_client") is None:
        return lambda: None
    from prometheus_client import CollectorRegistry, generate_latest
    from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

    class SnapshotCollector:
        def collect(self) -> Iterator[Any]:
            snapshot = latest()
            if snapshot is None:
                return
            for name, value in gauges(snapshot).items():
                yield GaugeMetricFamily(f"gatar_{name}", name.replace("_", " "), value=value)
            for name, count in snapshot.counters.items():
                yield CounterMetricFamily(f"gatar_{name}", name.replace("_", " "), value=count)

    registry = CollectorRegistry()
    registry.register(SnapshotCollector())

    def export() -> bytes:
        text: bytes = generate_latest(registry)
        return text

    return export


def gauges(snapshot: Snapshot) -> dict[str, float]:
    """The figures of a snapshot that go up and down."""
    age = snapshot.perception_age_s
    return {
        "up": 1.0,
        "uptime_seconds": snapshot.uptime_s,
        "problems": float(len(snapshot.problems)),
        "neighbors": float(len(snapshot.neighbors)),
        "oldest_neighbor_seconds": max((n.age_s for n in snapshot.neighbors), default=0.0),
        "vehicle_connected": float(snapshot.vehicle_connected),
        "vehicle_ready": float(snapshot.vehicle_ready),
        "battery_percent": float(snapshot.battery_percent),
        "perception_age_seconds": float("inf") if age is None else age,
        "perception_rate_hertz": snapshot.perception_rate_hz,
        "decision_seconds": snapshot.decision_ms / 1000,
        "fallbacks_in_a_row": float(snapshot.fallbacks_in_a_row),
    }
