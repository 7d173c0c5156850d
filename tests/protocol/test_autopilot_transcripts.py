"""The client's side of transcripts of real autopilots, replayed: the simulated ones give the same kinds of answers.

The transcripts lie in the folder `flight` of the folder that GATAR_SHARED names, or of `shared` beside the checkout.
"""

from __future__ import annotations

import gzip
import json
import os
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from gatar_edge.sim_sitl.autopilot import AutopilotConfig, SimAutopilot
from gatar_edge.sim_sitl.wire import mavlink
from gatar_edge.types import NS_PER_S

SHARED = Path(os.environ.get("GATAR_SHARED", Path(__file__).resolve().parents[3] / "shared"))
FLIGHT = SHARED / "flight"
Answer = tuple[Any, ...]
STEP_NS = 100_000_000
SET_MODE = 176

# Uploads, retasking, targets, deaths and fences; the lossy and the signed ones need their own link.
FILES = {
    "arducopter_retask": ("ardupilot", {1: "copter"}),
    "ardurover_retask": ("ardupilot", {1: "rover"}),
    "s2_ugv_retask_ap_cmd0": ("ardupilot", {1: "rover"}),
    "s2_ugv_retask_ap_cmd1": ("ardupilot", {1: "rover"}),
    "s2_ugv_retask_ap_msg": ("ardupilot", {1: "rover"}),
    "s2_uav_retask_copter": ("ardupilot", {1: "copter"}),
    "s2_death_fence_arducopter": ("ardupilot", {1: "copter"}),
    "s2_death_fence_ardurover": ("ardupilot", {1: "rover"}),
    "s2_rover_fs_enforce": ("ardupilot", {1: "rover"}),
    "s2_four_vehicles_one_socket": ("ardupilot", {1: "copter", 2: "copter", 3: "rover", 4: "rover"}),
    "px4rover_retask": ("px4", {1: "rover"}),
    "s2_ugv_retask_px_msg": ("px4", {7: "rover"}),
    "s2_px4rover_mode_race": ("px4", {9: "rover"}),
    "s2_px4rover_startup_race": ("px4", {8: "rover"}),
    "s2_uav_retask_px4quad": ("px4", {1: "copter"}),
    "s2_uav_retask_px4quad_part2": ("px4", {1: "copter"}),
    "s2_death_px4rover_hb6": ("px4", {6: "rover"}),
    "s2_death_px4rover_hb18": ("px4", {6: "rover"}),
}


def lines(name: str) -> Iterator[dict[str, Any]]:
    path = FLIGHT / f"{name}.jsonl.gz"
    if not path.exists():
        pytest.skip(f"no transcript {path}: set GATAR_SHARED to the folder that holds flight/")
    with gzip.open(path, "rt") as file:
        yield from map(json.loads, file)


# What counts as an answer, and which of its fields do not depend on where the vehicle is.
ANSWERS = {
    "COMMAND_ACK": ("command", "result"),
    "MISSION_REQUEST": ("seq",),
    "MISSION_REQUEST_INT": ("seq",),
    "MISSION_ACK": ("type",),
    "MISSION_COUNT": ("count",),
    "MISSION_ITEM_INT": ("seq", "frame", "command"),
    "AUTOPILOT_VERSION": (),
    "PARAM_VALUE": ("param_id", "param_type"),
}


def answer(name: str, fields: dict[str, Any], asked: list[str]) -> list[Answer]:
    """The message as an answer, or nothing; a parameter counts once each time it was asked for."""
    if name not in ANSWERS:
        return []
    if name == "PARAM_VALUE":
        if fields["param_id"] not in asked:
            return []
        asked.remove(fields["param_id"])
    return [(name, *(fields[key] for key in ANSWERS[name]))]


class Replay:
    """One transcript with the simulated vehicles in place of the real ones."""

    def __init__(self, stack: str, vehicles: dict[int, str]) -> None:
        self.now_ns = 0
        self.vehicles = {
            sysid: SimAutopilot(
                AutopilotConfig(sysid, kind, stack, home_lat_deg=42.0, home_lon_deg=-71.0, home_alt_m=20.1), 0
            )
            for sysid, kind in vehicles.items()
        }  # fmt: skip
        self.expected: dict[int, list[Answer]] = {sysid: [] for sysid in vehicles}
        self.got: dict[int, list[Answer]] = {sysid: [] for sysid in vehicles}
        self._asked: dict[int, tuple[list[str], list[str]]] = {sysid: ([], []) for sysid in vehicles}
        self._inputs = {sysid: mavlink.MAVLink(None) for sysid in vehicles}
        self._companion_lives = True
        self._beaten_ns = 0

    def line(self, line: dict[str, Any]) -> None:
        """Replay one line: time, what the client sent, what the real vehicle answered."""
        if "mark" in line:
            self._companion_lives = not line["mark"].startswith("DEATH")
            return
        if line["sim"] is not None:
            self._pass_time(int(line["sim"] * NS_PER_S))
        if line["dir"] == "rx":
            if line["sys"] in self.vehicles:
                self.expected[line["sys"]] += answer(line["msg"], line["f"], self._asked[line["sys"]][0])
            self._companion_lives |= "Cleared" in str(line["f"].get("text")) or "regained" in str(line["f"].get("text"))
        else:
            self._companion_lives |= not line["msg"].startswith("SET_POSITION")
            self._send(line)

    def _pass_time(self, until_ns: int) -> None:
        while self.now_ns < until_ns:
            self.now_ns = min(until_ns, self.now_ns + STEP_NS)
            if self._companion_lives and self.now_ns - self._beaten_ns >= NS_PER_S:
                # The client's heartbeats were not recorded: type 6 of system 255, each second while it lived.
                self._beaten_ns = self.now_ns
                beat = mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
                for vehicle in self.vehicles.values():
                    vehicle.receive(bytes(beat.pack(mavlink.MAVLink(None, 255, 190))), self.now_ns)
            for vehicle in self.vehicles.values():
                vehicle.step(self.now_ns)
        self._collect()

    def _send(self, line: dict[str, Any]) -> None:
        message_class = getattr(mavlink, f"MAVLink_{line['msg'].lower()}_message")
        fields = {k: v.encode() if isinstance(v, str) else v for k, v in line["f"].items()}
        message = message_class(**{k: v for k, v in fields.items() if k in message_class.fieldnames})
        data = bytes(message.pack(mavlink.MAVLink(None, line["sys"], line["comp"])))
        for sysid, vehicle in self.vehicles.items():
            if line["f"].get("target_system", 0) in (0, sysid):
                if "param_id" in line["f"]:
                    for asked in self._asked[sysid]:
                        asked.append(line["f"]["param_id"])
                vehicle.receive(data, self.now_ns)
        self._collect()

    def _collect(self) -> None:
        for sysid, vehicle in self.vehicles.items():
            for message in self._inputs[sysid].parse_buffer(vehicle.take()) or []:
                self.got[sysid] += answer(message.get_type(), message.to_dict(), self._asked[sysid][1])


def ordered(answers: list[Answer], stack: str, first: bool) -> list[Answer]:
    """Answers in order, less what was chance on the wire: PX4's second answer to a mode comes when it likes."""
    if stack == "px4":
        answers = [a for a in answers if a[:2] != ("COMMAND_ACK", SET_MODE)]
    if not first:  # the request for the version went to the first vehicle's address only
        answers = [a for a in answers if a[:2] != ("COMMAND_ACK", 512) and a[0] != "AUTOPILOT_VERSION"]
    return answers


@cache
def replayed(name: str) -> tuple[Replay, int]:
    """The whole transcript, and how many mode commands the client sent in it."""
    replay = Replay(*FILES[name])
    asked = 0
    for line in lines(name):
        replay.line(line)
        asked += line.get("dir") == "tx" and line["f"].get("command") == SET_MODE
    return replay, asked


@pytest.mark.parametrize("name", FILES)
def test_the_client_side_of_a_transcript_gets_the_same_kinds_of_answers_in_the_same_order(name: str) -> None:
    stack, vehicles = FILES[name]
    replay, _ = replayed(name)
    for number, sysid in enumerate(vehicles):
        expected = ordered(replay.expected[sysid], stack, number == 0)
        assert len(expected) > 10
        assert ordered(replay.got[sysid], stack, number == 0) == expected


@pytest.mark.parametrize("name", [name for name, (stack, _) in FILES.items() if stack == "px4"])
def test_px4_answers_each_mode_command_twice_as_in_the_transcripts(name: str) -> None:
    replay, asked = replayed(name)
    (sysid,) = replay.vehicles
    for answers in (replay.expected[sysid], replay.got[sysid]):
        assert sum(a[:2] == ("COMMAND_ACK", SET_MODE) for a in answers) in (2 * asked, 2 * asked + 1)
