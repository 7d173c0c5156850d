"""Eyes for a simulated vehicle that has none, such as ArduPilot SITL: shows a daemon a made-up map round its vehicle.

The map comes from a seed, the vehicle's cell from the daemon's own /healthz (`gatar init --http 127.0.0.1:9101`).

python examples/sitl_eyes.py uav1.toml 1
"""

import contextlib
import http.client
import json
import socket
import sys
import time
from pathlib import Path

from gatar_edge.sim_sitl.world import Team, observe, random_world
from gatar_edge.vehicle_config import VehicleConfig, read_config

NOWHERE = (-1, -1)
TEAM = Team.parse("1A1G")  # whose first robot sees over obstacles, and the second one does not
TARGETS = 8


def cell_of(address: str) -> tuple[int, int]:
    """Where the daemon believes its robot to be, NOWHERE before it knows or while it does not answer."""
    with (
        contextlib.suppress(OSError, TypeError, ValueError),
        contextlib.closing(http.client.HTTPConnection(address, timeout=1)) as daemon,
    ):
        daemon.request("GET", "/healthz")
        x, y = json.load(daemon.getresponse())["state"]["cell"]
        return x, y
    return NOWHERE


def look(config: VehicleConfig, cell: tuple[int, int], seed: int) -> bytes:
    """The datagram of what is to be seen from `cell` on the map of that seed.

    It leaves out the cell itself, and NOWHERE all else: the daemon takes it from the autopilot.
    """
    if cell == NOWHERE:
        return json.dumps({"v": 1, "seen": []}).encode()
    world = random_world(TEAM, TARGETS, config.grid.width, config.grid.height, seed)
    seen = observe(world, 1 + config.kind, cell, config.team.r_sense, t_ns=0)
    sets = {"seen": seen.seen, "obstacles": seen.obstacles, "targets": seen.targets}
    return json.dumps({"v": 1, **{name: cells.tolist() for name, cells in sets.items()}}).encode()


def main(path: str, seed: int, seconds: float) -> None:
    config = read_config(Path(path))
    host, port = config.perception.listen.rsplit(":", 1)
    end_s = time.monotonic() + seconds
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        while time.monotonic() < end_s:
            sender.sendto(look(config, cell_of(config.watch.http), seed), (host, int(port)))
            time.sleep(0.2)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), float(sys.argv[3]) if len(sys.argv) > 3 else 1e9)
