"""Invariant: no bytes from outside bring out anything but typed errors. A finding names the input that did.

More of it: `gatar bench fuzz --count 100000`.
"""

from __future__ import annotations

import random

import pytest
from click.testing import CliRunner

from gatar_edge.agent import Agent
from gatar_edge.bridge.codec import Codec
from gatar_edge.commands.bench_fuzz import command, config_sample
from gatar_edge.errors import ConfigError, MessageError
from gatar_edge.fuzzing import FAULTS, Target, fuzz, make_input, repaired_frame, signed_anew, targets
from gatar_edge.keys import DEMO_KEY
from gatar_edge.message import decode
from gatar_edge.sim_sitl.faults_file import parse_faults
from gatar_edge.vehicle_config import parse_config

COUNT = 3000


@pytest.fixture(scope="module")
def readers() -> list[Target]:
    return targets(config_sample())


def test_no_bytes_from_outside_bring_out_more_than_typed_errors(readers: list[Target]) -> None:
    assert len(readers) == 13
    assert [finding for target in readers for finding in fuzz(target, COUNT, seed=7)] == []


def test_mutants_are_read_and_not_only_refused_for_their_checksum(readers: list[Target]) -> None:
    rng = random.Random(1)
    by_name = {target.name: target for target in readers}
    frames = [make_input(by_name["mavlink from px4 UAV"], rng) for _ in range(500)]
    assert sum(bool(Codec(1, 191).parse(frame)) for frame in frames) > 200
    understood = 0
    for _ in range(500):
        try:
            decode(make_input(by_name["neighbour decoder"], rng), DEMO_KEY)
            understood += 1
        except MessageError:
            pass
    assert understood > 50


def test_a_repaired_frame_and_message_are_valid(readers: list[Target]) -> None:
    samples = {target.name: target.samples for target in readers}
    for frame in samples["mavlink to ardupilot UGV"][:50]:
        assert Codec(1, 1).parse(repaired_frame(frame[:-1] + b"\0"))
    message = samples["neighbour decoder"][0]
    assert decode(signed_anew(message[:-3]), DEMO_KEY).robot_id == decode(message, DEMO_KEY).robot_id


class Careless:
    def feed(self, data: bytes) -> None:
        data.decode()

    def works(self) -> bool:
        return True


class Dying(Careless):
    def feed(self, data: bytes) -> None:
        pass

    def works(self) -> bool:
        return False


def test_a_careless_reader_is_found_and_the_input_is_named() -> None:
    (finding,) = fuzz(Target("careless", Careless(), [b"abc"]), 1000, seed=1)
    assert finding.problem.startswith("UnicodeDecodeError")
    with pytest.raises(UnicodeDecodeError):
        finding.data.decode()


def test_a_reader_that_stops_working_is_found() -> None:
    (finding,) = fuzz(Target("dying", Dying(), [b"abc"]), 10, seed=1)
    assert finding.problem == "does not work any more"


def test_a_finding_fails_the_command(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(self: Agent, datagram: bytes, now_ns: int) -> None:
        raise KeyError("oops")

    good = CliRunner().invoke(command, ["--count", "50", "--only", "toml", "--json"])
    assert good.exit_code == 0, good.output
    monkeypatch.setattr(Agent, "hear", fail)
    bad = CliRunner().invoke(command, ["--count", "50", "--only", "neighbour messages"])
    assert bad.exit_code == 1
    assert "KeyError" in bad.output


@pytest.mark.parametrize("text", [b"a=" + b"[" * 100_000, b"\x00", b"a = " + b"9" * 5000])
def test_configurations_of_a_mean_kind_are_refused(text: bytes) -> None:
    for parse in (parse_config, parse_faults):
        with pytest.raises(ConfigError):
            parse(text)
    assert parse_faults(FAULTS).incidents
