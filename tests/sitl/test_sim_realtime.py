"""`gatar sim --realtime` as a process of its own, seen by a ground station."""

from __future__ import annotations

import configparser
import signal
import socket
import subprocess
import sys
from pathlib import Path

from pymavlink import mavutil

ROOT = Path(__file__).resolve().parents[2]
LIMIT = 2000  # messages


def test_a_ground_station_sees_all_vehicles_of_a_mission_that_is_flown_by_the_wall_clock() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    options = ["--team", "1A1G", "--allocator", "greedy", "--stack", "mixed", "--speed-factor", "10"]
    command = [sys.executable, "-m", "gatar_edge", "sim", "--realtime", "--listen", f"udp:127.0.0.1:{port}", *options]
    process = subprocess.Popen(command, cwd=ROOT, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)
    link = mavutil.mavlink_connection(f"udpout:127.0.0.1:{port}", source_system=255)
    try:
        assert process.stderr is not None
        assert "2 vehicles, system ids 1 to 2" in process.stderr.readline()
        link.mav.heartbeat_send(6, 8, 0, 0, 0)
        armed: set[int] = set()
        for _ in range(LIMIT):
            message = link.recv_match(type="HEARTBEAT", blocking=True, timeout=20)
            assert message is not None, "no heartbeat"
            if message.base_mode & mavutil.mavlink.MAV_MODE_FLAG_SAFETY_ARMED:
                armed.add(message.get_srcSystem())
            if armed == {1, 2}:
                break
        assert armed == {1, 2}
    finally:
        link.close()
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=20)
    assert process.returncode == 0  # Ctrl-C is a good end


def test_the_router_example_has_the_sections_that_the_page_speaks_of() -> None:
    router = configparser.ConfigParser()
    router.read(ROOT / "examples" / "mavlink-router.conf")
    assert router["UdpEndpoint gatar"]["Port"] == "14541"
    page = (ROOT / "docs" / "ground-stations.md").read_text()
    assert "udpin:127.0.0.1:14541" in page
    for name in router.sections():
        keys = {key for key in router[name] if name != "General"}
        assert keys <= {"device", "baud", "mode", "address", "port"}
