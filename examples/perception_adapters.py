"""A costmap and a list of detections, as most perception stacks give them, in one observation for the daemon.

python examples/perception_adapters.py        # prints the datagram; give host:port to send it
"""

import json
import socket
import sys

import numpy as np

from gatar_edge.adapters import cells_from_costmap, cells_from_detections
from gatar_edge.bridge.geo import cell_to_wgs84
from gatar_edge.perception import decode_datagram
from gatar_edge.types import GridSpec

grid = GridSpec(width=15, height=15, cell_m=10.0, origin_lat_deg=47.397742, origin_lon_deg=8.545594)

# 8 x 8 m at 0.5 m round the robot would be more usual; here 60 x 60 m at 1 m, south-west corner at (20 m, 30 m)
costmap = np.zeros((60, 60), dtype=np.int8)
costmap[22:28, 31:39] = 100  # a wall
costmap[50:, :] = -1  # not seen
detections_deg = [cell_to_wgs84(grid, (4, 5)), cell_to_wgs84(grid, (7, 6))]

seen, obstacles = cells_from_costmap(costmap, (20.0, 30.0), 1.0, grid)
targets = cells_from_detections(detections_deg, grid)
datagram = json.dumps(
    {"v": 1, "seen": seen.tolist(), "obstacles": obstacles.tolist(), "targets": targets.tolist(), "age_ms": 80.0}
).encode()  # without "cell": the daemon takes the autopilot's position
decode_datagram(datagram)  # what the daemon will do; raises where something is wrong
if len(sys.argv) > 1:
    host, port = sys.argv[1].rsplit(":", 1)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.sendto(datagram, (host, int(port)))
else:
    print(datagram.decode())
