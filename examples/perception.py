"""The smallest perception: tells a daemon five times a second what its robot sees. Replace `look` by a camera.

python examples/perception.py 127.0.0.1:14700
"""

import json
import socket
import sys
import time


def look() -> dict[str, object]:
    """What is in view now: cells [x, y] of the team's grid, and how old that is."""
    return {
        "v": 1,
        "cell": [3, 4],
        "seen": [[3, 4], [3, 5], [4, 4]],
        "obstacles": [[4, 4]],
        "targets": [[3, 5]],
        "age_ms": 20,
    }


def main(address: str, seconds: float) -> None:
    host, port = address.rsplit(":", 1)
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    end_s = time.monotonic() + seconds
    with sender:
        while time.monotonic() < end_s:
            sender.sendto(json.dumps(look()).encode(), (host, int(port)))
            time.sleep(0.2)


if __name__ == "__main__":
    main(sys.argv[1], float(sys.argv[2]) if len(sys.argv) > 2 else 1e9)
