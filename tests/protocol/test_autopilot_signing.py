"""MAVLink 2 signing of ArduPilot, row by row of the measured section "Signing"."""

from __future__ import annotations

from dataclasses import replace

from gatar_edge.sim_sitl.autopilot import SimAutopilot
from gatar_edge.sim_sitl.testing import ROVER
from gatar_edge.sim_sitl.wire import mavlink

KEY, OTHER_KEY = bytes(range(1, 33)), bytes(range(2, 34))
START = 37_538_060_778_996  # ticks of 10 us since 2015
SECOND = 100_000
S = 1_000_000_000


class Signer:
    """A client with a key and a clock of its own on the given link of a rover."""

    def __init__(self, vehicle: SimAutopilot, timestamp: int, key: bytes | None = KEY, sysid: int = 255) -> None:
        self.vehicle = vehicle
        self.codec = mavlink.MAVLink(None, sysid, 190)
        self.codec.signing.secret_key = key
        self.codec.signing.timestamp = timestamp
        self.codec.signing.sign_outgoing = key is not None

    def ask(self, now_ns: int = 0) -> bool:
        """Whether a command is answered."""
        message = mavlink.MAVLink_command_long_message(ROVER.sysid, 1, 511, 0, 33, 200_000, 0, 0, 0, 0, 0)
        return b"\x4d\x00\x00" in self.send(message, now_ns)  # COMMAND_ACK's id in its frame

    def send(self, message: mavlink.MAVLink_message, now_ns: int = 0) -> bytes:
        self.vehicle.take()
        self.vehicle.receive(bytes(message.pack(self.codec)), now_ns)
        return self.vehicle.take()


def signed_vehicle(accepts_unsigned: bool = False) -> SimAutopilot:
    vehicle = SimAutopilot(replace(ROVER, accepts_unsigned=accepts_unsigned), 0)
    setup = mavlink.MAVLink_setup_signing_message(ROVER.sysid, 1, list(KEY), START)
    assert Signer(vehicle, 0, key=None).send(setup) == b""  # without an acknowledgement
    return vehicle


def test_unsigned_and_wrong_keys_are_dropped_in_silence_and_the_right_key_is_obeyed() -> None:
    vehicle = signed_vehicle()
    assert not Signer(vehicle, 0, key=None).ask()
    assert not Signer(vehicle, START + 61 * SECOND, key=OTHER_KEY).ask()
    assert Signer(vehicle, START + 61 * SECOND).ask()


def test_what_it_sends_is_signed() -> None:
    vehicle = signed_vehicle()
    vehicle.step(S)
    frame = vehicle.take()
    assert frame[0] == 0xFD
    assert frame[2] & 1


def test_the_first_serial_link_accepts_unsigned() -> None:
    assert Signer(signed_vehicle(accepts_unsigned=True), 0, key=None).ask()


def test_its_clock_runs_a_minute_ahead_so_that_a_client_30_s_slow_is_refused() -> None:
    vehicle = signed_vehicle()
    assert not Signer(vehicle, START - 30 * SECOND, sysid=9).ask()
    assert Signer(vehicle, START + SECOND, sysid=9).ask()


def test_a_replayed_frame_is_dropped() -> None:
    vehicle = signed_vehicle()
    client = Signer(vehicle, START + 61 * SECOND)
    message = mavlink.MAVLink_command_long_message(ROVER.sysid, 1, 511, 0, 33, 200_000, 0, 0, 0, 0, 0)
    frame = bytes(message.pack(client.codec))
    vehicle.take()
    vehicle.receive(frame, 0)
    assert vehicle.take()
    vehicle.receive(frame, 0)
    assert vehicle.take() == b""


def test_a_client_an_hour_ahead_locks_others_out() -> None:
    vehicle = signed_vehicle()
    assert Signer(vehicle, START + 3600 * SECOND, sysid=8).ask()
    assert not Signer(vehicle, START + 61 * SECOND, sysid=9).ask()


def test_after_a_restart_the_key_holds_and_a_correct_clock_may_be_refused() -> None:
    vehicle = signed_vehicle()
    client = Signer(vehicle, START + 61 * SECOND)
    assert client.ask()
    vehicle.reboot(S)
    assert not Signer(vehicle, 0, key=None).ask(S)
    assert not Signer(vehicle, START + SECOND, sysid=9).ask(S)
    vehicle.step(2 * S)
    heard = int.from_bytes(vehicle.take()[-12:-6], "little")
    client.codec.signing.timestamp = heard + 1  # goes on from the last timestamp that it received
    assert client.ask(S)


def test_signing_is_not_set_up_while_armed() -> None:
    vehicle = SimAutopilot(replace(ROVER, accepts_unsigned=False), 0)
    client = Signer(vehicle, 0, key=None)
    client.send(mavlink.MAVLink_command_long_message(ROVER.sysid, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0))
    answer = client.send(mavlink.MAVLink_setup_signing_message(ROVER.sysid, 1, list(KEY), START))
    assert b"Won't setup signing when armed" in answer
    assert client.ask()
