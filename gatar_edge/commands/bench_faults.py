"""`gatar bench faults`: mission uploads through bad links, each dialect's server against our client, in lock-step."""

from __future__ import annotations

import json
import random
import statistics
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import click

from gatar_edge.commands._options import FiniteRange

if TYPE_CHECKING:
    from gatar_edge.bridge.mission_items import Items
    from gatar_edge.bridge.mission_states import Result
    from gatar_edge.sim_sitl.faults import LinkFaults

STACKS = ("ardupilot", "px4")
ITEMS = 12
STEP_NS = 20_000_000
HANG_NS = 70_000_000_000  # the client promises an end after 60 s
SETTLE_NS = 12_000_000_000  # what is under way arrives, and what it re-opens ends
SYSID = 1


@dataclass(frozen=True, slots=True)
class Trial:
    """One upload. `result` None: it did not end. `different`: accepted, and something else was on board."""

    result: Result | None
    simulated_s: float
    different: bool


class Upload:
    """One client and one autopilot with a bad link between them; every byte goes over it."""

    def __init__(self, stack: str, seed: int, faults: LinkFaults) -> None:
        from gatar_edge.bridge.codec import Codec
        from gatar_edge.bridge.mission_transfer import MissionClient
        from gatar_edge.bridge.profiles import PROFILES
        from gatar_edge.sim_sitl.autopilot import AutopilotConfig, SimAutopilot
        from gatar_edge.sim_sitl.faulty_link import FaultyLink

        self.profile = next(profile for profile in PROFILES if profile.name == f"{stack}-rover")
        config = AutopilotConfig(
            sysid=SYSID, vehicle="rover", stack="px4" if stack == "px4" else "ardupilot", seed=seed
        )
        self._vehicle = SimAutopilot(config, 0)
        self._codec = Codec(SYSID, 191)
        self.client = MissionClient(self.profile, self._codec.address, (SYSID, 1), random.Random(seed))
        self._link = FaultyLink(faults, faults, seed, stack)
        self.now_ns = 0

    def run(self, items: Items, settle_ns: int = 0) -> Trial:
        """Upload, wait for the end, and then for `settle_ns` for what is still under way and what it re-opens."""
        began_ns = self.now_ns
        self.client.upload(items, began_ns)
        while self.client.result is None and self.now_ns < began_ns + HANG_NS:
            self._step()
        result, ended_ns = self.client.result, self.now_ns
        different = self._lied(items)
        while result is not None and (self.now_ns < ended_ns + settle_ns or self.client.result is None):
            self._step()
            if self.now_ns > ended_ns + settle_ns + HANG_NS:
                result = None
        return Trial(result, (ended_ns - began_ns) / 1e9, different or self._lied(items))

    def _lied(self, items: Items) -> bool:
        """Whether the client says that the mission is on board, and it is not."""
        first = self.profile.first_item_seq
        sent = [(item.command, item.lat_e7, item.lon_e7, item.alt_m) for item in items[first:]]
        there = [(item.command, item.x, item.y, item.z) for item in self._vehicle.mission[first:]]
        return self.client.result is not None and self.client.result.ok and sent != there

    def _step(self) -> None:
        from gatar_edge.sim_sitl.faulty_link import End

        self.now_ns += STEP_NS
        now_ns, link = self.now_ns, self._link
        self._vehicle.step(now_ns)
        for message in self.client.poll(now_ns):
            link.send(now_ns, End.COMPANION, self._codec.encode(message))
        link.send(now_ns, End.VEHICLE, self._vehicle.take())
        for end, frame in link.deliver(now_ns):
            if end is End.VEHICLE:
                self._vehicle.receive(frame, now_ns)
                continue
            for received in self._codec.parse(frame):
                if received.message is not None:
                    self.client.receive(received.source, received.message, now_ns)


def trials(stack: str, seeds: int, faults: LinkFaults) -> Iterator[Trial]:
    """Two uploads a seed, the second at once after the first, while packets of that are still under way."""
    for seed in range(1, seeds + 1):
        upload = Upload(stack, seed, faults)
        yield upload.run(waypoints(upload, seed))
        yield upload.run(waypoints(upload, seed + 1), SETTLE_NS)


def waypoints(upload: Upload, number: int) -> Items:
    """A mission like no other of its neighbours in number."""
    from gatar_edge.bridge.mission_items import build

    points = tuple((-35.36 + (number % 97 + n) * 1e-4, 149.16 + n * 2e-4) for n in range(ITEMS))
    return build(upload.profile, points, 0.0)


def summary(done: list[Trial]) -> dict[str, Any]:
    """The figures of one dialect."""
    times_s = sorted(trial.simulated_s for trial in done if trial.result is not None and trial.result.ok)
    results = Counter(trial.result.name for trial in done if trial.result is not None)
    return {
        "uploads": len(done),
        "results": dict(results.most_common()),
        "hangs": sum(trial.result is None for trial in done),
        "accepted_but_different": sum(trial.different for trial in done),
        "median_s": round(statistics.median(times_s), 2) if times_s else None,
        "p95_s": round(times_s[int(0.95 * (len(times_s) - 1))], 2) if times_s else None,
        "max_s": round(times_s[-1], 2) if times_s else None,
    }


@click.command("faults")
@click.option("--seeds", type=click.IntRange(1, 100_000), default=200, show_default=True, help="Two uploads each.")
@click.option("--loss", type=FiniteRange(0, 0.9), default=0.3, show_default=True)
@click.option("--duplicates", type=FiniteRange(0, 1), default=0.1, show_default=True)
@click.option("--reorder", type=FiniteRange(0, 1), default=1.0, show_default=True, help="Share that may overtake.")
@click.option("--delay-ms", type=click.IntRange(0, 10_000), default=400, show_default=True, help="From 0 up to this.")
@click.option("--json", "as_json", is_flag=True, help="Print for machines.")
def command(seeds: int, loss: float, duplicates: float, reorder: float, delay_ms: int, as_json: bool) -> None:
    """Upload missions of 12 items through a bad link to each simulated dialect, and count how they end.

    A second mission follows each at once, while packets of the first are still under way.

    No upload may hang, and none may be called accepted while something else is on board: exit code 1 if one is.

    \b
    Example:
      gatar bench faults --seeds 1000 --json
    """
    from gatar_edge.sim_sitl.faults import LinkFaults

    faults = LinkFaults(loss=loss, duplicate=duplicates, reorder=reorder, delay_max_ns=delay_ms * 1_000_000)
    figures = {stack: summary(list(trials(stack, seeds, faults))) for stack in STACKS}
    if as_json:
        link = {"loss": loss, "duplicates": duplicates, "reorder": reorder, "delay_ms": delay_ms}
        click.echo(json.dumps({"items": ITEMS, "link": link, "dialects": figures}))
    else:
        _print_table(figures)
    if any(row["hangs"] or row["accepted_but_different"] for row in figures.values()):
        raise SystemExit(1)


def _print_table(figures: dict[str, Any]) -> None:
    click.echo(f"{'dialect':10} {'uploads':>8} {'hangs':>6} {'wrong':>6} {'median':>8} {'p95':>8} {'max':>8}  results")
    for stack, row in figures.items():
        times = " ".join(f"{row[key]:>6} s" if row[key] is not None else f"{'-':>8}" for key in _TIMES)
        results = ", ".join(f"{name} {count}" for name, count in row["results"].items())
        wrong = row["accepted_but_different"]
        click.echo(f"{stack:10} {row['uploads']:>8} {row['hangs']:>6} {wrong:>6} {times}  {results}")


_TIMES = ("median_s", "p95_s", "max_s")
