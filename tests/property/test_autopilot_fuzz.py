"""Invariant: whatever bytes a client sends, a simulated autopilot neither raises nor stops its heartbeat.

A failing example is printed by hypothesis and reproduced with `@example(...)`.
"""

from __future__ import annotations

import random
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gatar_edge.sim_sitl.autopilot import AutopilotConfig
from gatar_edge.sim_sitl.testing import COPTER, ROVER, Client, of, px4_copter, px4_rover
from gatar_edge.sim_sitl.wire import mavlink

CONFIGS = [COPTER, ROVER, px4_copter(), px4_rover()]
NAMES = [
    "COMMAND_LONG", "COMMAND_INT", "SET_MODE", "SET_POSITION_TARGET_GLOBAL_INT", "PARAM_SET", "PARAM_REQUEST_READ",
    "PARAM_REQUEST_LIST", "MISSION_COUNT", "MISSION_ITEM_INT", "MISSION_ITEM", "MISSION_REQUEST", "MISSION_REQUEST_INT",
    "MISSION_REQUEST_LIST", "MISSION_ACK", "MISSION_CLEAR_ALL", "MISSION_SET_CURRENT", "HEARTBEAT", "TIMESYNC", "PING",
    "REQUEST_DATA_STREAM", "SET_GPS_GLOBAL_ORIGIN", "MISSION_WRITE_PARTIAL_LIST",
]  # fmt: skip
COMMANDS = [16, 17, 20, 21, 22, 93, 176, 177, 178, 179, 192, 224, 246, 300, 400, 410, 420, 510, 511, 512, 520]
BOUNDS = {"uint8_t": (0, 255), "uint16_t": (0, 65535), "uint32_t": (0, 2**32 - 1), "uint64_t": (0, 2**64 - 1),
          "int8_t": (-128, 127), "int16_t": (-32768, 32767), "int32_t": (-(2**31), 2**31 - 1),
          "int64_t": (-(2**63), 2**63 - 1)}  # fmt: skip
FLOATS = st.one_of(st.floats(width=32), st.sampled_from([0.0, 1.0, 2.0, 4.0, 10.0, 15.0, 33.0, 148.0, 0.5]))


def alive(client: Client) -> None:
    assert of(client.run(1.2), "HEARTBEAT")
    truth = client.vehicle.truth
    assert truth.east_m == truth.east_m  # no NaN got into the motion
    assert truth.alt_rel_m == truth.alt_rel_m


@pytest.mark.parametrize("config", CONFIGS, ids=lambda c: f"{c.stack}-{c.vehicle}")
@settings(max_examples=60, deadline=None)
@given(data=st.lists(st.binary(max_size=300), max_size=20))
def test_random_bytes_never_raise(config: AutopilotConfig, data: list[bytes]) -> None:
    client = Client(config)
    for chunk in data:
        client.vehicle.receive(chunk, client.now_ns)
    alive(client)


@st.composite
def messages(draw: st.DrawFn) -> bytes:
    message_class = getattr(mavlink, f"MAVLink_{draw(st.sampled_from(NAMES)).lower()}_message")
    fields: dict[str, Any] = {}
    for name, kind in zip(message_class.fieldnames, message_class.fieldtypes, strict=True):
        if name in ("target_system", "target_component"):
            fields[name] = 0
        elif name == "command":
            fields[name] = draw(st.sampled_from(COMMANDS))
        elif name in ("seq", "count"):
            fields[name] = draw(st.integers(0, 4))
        elif name == "mission_type":
            fields[name] = draw(st.sampled_from([0, 0, 0, 1, 255]))
        elif kind == "char":
            fields[name] = draw(
                st.sampled_from([b"WP_SPEED", b"FENCE_RADIUS", b"FENCE_ENABLE", b"\xff\xfe", b"COM_DL_LOSS_T"])
            )
        elif kind in ("float", "double"):
            fields[name] = draw(FLOATS)
        else:
            fields[name] = draw(st.integers(*BOUNDS[kind]))
    return bytes(message_class(**fields).pack(mavlink.MAVLink(None, draw(st.sampled_from([255, 9])), 190)))


@pytest.mark.parametrize("config", CONFIGS, ids=lambda c: f"{c.stack}-{c.vehicle}")
@settings(max_examples=80, deadline=None)
@given(frames=st.lists(messages(), max_size=25), armed=st.booleans())
def test_well_formed_messages_with_any_values_never_raise(
    config: AutopilotConfig, frames: list[bytes], armed: bool
) -> None:
    client = Client(config)
    if armed:
        client.command(400, 1)
    for frame in frames:
        client.vehicle.receive(frame, client.now_ns)
        client.run(0.2)
    alive(client)


@pytest.mark.parametrize("config", CONFIGS, ids=lambda c: f"{c.stack}-{c.vehicle}")
def test_mutated_conversations_never_raise_and_broken_frames_are_counted(config: AutopilotConfig) -> None:
    rng = random.Random(config.sysid)
    client = Client(config)
    beat = bytes(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(mavlink.MAVLink(None, 255, 190)))
    for _ in range(2000):
        frame = bytearray(beat)
        for _ in range(rng.randint(0, 3)):
            frame[rng.randrange(len(frame))] = rng.randrange(256)
        client.vehicle.receive(bytes(frame[: rng.randint(1, len(frame))]), client.now_ns)
    client.vehicle.receive(bytes(300), client.now_ns)
    assert client.vehicle.rejected_frames > 100
    alive(client)
