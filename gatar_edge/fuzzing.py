"""Random and mutated bytes for everything that reads bytes from outside: only typed errors may come of them.

Invariant: a parser either understands, or raises its one error; a state machine never raises, and works on afterwards.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

from gatar_edge.agent import Agent, Identity
from gatar_edge.allocators.greedy import Greedy
from gatar_edge.bridge.driver import VehicleDriver
from gatar_edge.bridge.settings import DriverConfig
from gatar_edge.config import AgentConfig
from gatar_edge.errors import ConfigError, GatarError, MessageError
from gatar_edge.keys import DEMO_KEY
from gatar_edge.message import MESSAGE_BYTES, VERSION, decode, with_hops
from gatar_edge.perception import Perception, encode_observation
from gatar_edge.sim_sitl.autopilot import SimAutopilot
from gatar_edge.sim_sitl.body import StackName
from gatar_edge.sim_sitl.faults_file import parse_faults
from gatar_edge.sim_sitl.faulty_link import End, split_frames
from gatar_edge.sim_sitl.fleet import Fleet
from gatar_edge.sim_sitl.fleet_config import FleetConfig
from gatar_edge.sim_sitl.wire import mavlink
from gatar_edge.sim_sitl.world import Team, observe, random_world
from gatar_edge.types import NS_PER_S, GridSpec, RobotKind
from gatar_edge.vehicle_config import parse_config

_SAMPLES_MAX = 4000
_V2, _HEADER, _CRC = 0xFD, 10, 2
_CONVERSATION_S = 40
_EACH_NS = NS_PER_S // 100  # simulated time between two inputs
FAULTS = b"""
[radio]
loss = 0.1
burst = {enter = 0.1, leave = 0.5}
[to_vehicle]
blackouts_s = [[1, 2.5]]
[[between]]
sender = 1
receiver = 2
[[telemetry]]
robot = 1
direction = "to_companion"
[[event]]
do = "gps_jump"
robot = 1
at_s = 3
east_m = 4
[[event]]
do = "pilot_mode"
robot = 1
at_s = 3
mode = "LOITER"
"""


class Reader(Protocol):
    """Something that reads bytes from outside."""

    def feed(self, data: bytes) -> None:
        """Read; may raise only what `Target.error` names."""

    def works(self) -> bool:
        """Whether it still does what it is for."""


@dataclass(frozen=True, slots=True)
class Target:
    """What is fuzzed: a reader, valid samples to mutate, and the one error that it may raise (None: none)."""

    name: str
    reader: Reader
    samples: Sequence[bytes]
    error: type[GatarError] | None = None
    repair: Callable[[bytes], bytes] = bytes  # makes checksums right again, so that contents are reached


@dataclass(frozen=True, slots=True)
class Finding:
    """An input that did what it must not."""

    target: str
    number: int
    problem: str
    data: bytes


def fuzz(target: Target, count: int, seed: int) -> Iterator[Finding]:
    """Feed `count` inputs; yields at most one finding, since what comes after it says little."""
    rng = random.Random(f"{target.name}/{seed}")
    data = b""
    for number in range(count):
        data = make_input(target, rng)
        try:
            target.reader.feed(data)
        except Exception as error:  # whatever it is, it is what we look for
            if target.error is None or not isinstance(error, target.error):
                yield Finding(target.name, number, f"{type(error).__name__}: {error}", data)
                return
    if not target.reader.works():
        yield Finding(target.name, count - 1, "does not work any more", data)


def make_input(target: Target, rng: random.Random) -> bytes:
    """Random bytes, or a sample mutated in one of five ways, mostly with its checksum made right again."""
    if not target.samples or rng.random() < 0.15:
        return rng.randbytes(rng.randint(0, 300))
    data = bytearray(rng.choice(target.samples))
    for _ in range(rng.randint(0, 4)):
        _mutate(data, rng, target.samples)
    return target.repair(bytes(data)) if rng.random() < 0.8 else bytes(data)


def _mutate(data: bytearray, rng: random.Random, samples: Sequence[bytes]) -> None:
    where = rng.randrange(len(data) + 1)
    match rng.randrange(5):
        case 0 if data:
            data[where % len(data)] = rng.choice((0, 1, 127, 128, 254, 255, rng.randrange(256)))
        case 1 if data:
            data[where % len(data)] ^= 1 << rng.randrange(8)
        case 2:
            del data[where : where + rng.randint(1, 8)]
        case 3:
            data[where:where] = rng.randbytes(rng.randint(1, 8))
        case _:
            other = rng.choice(samples)
            start = rng.randrange(len(other) + 1)
            data[where : where + 8] = other[start : start + 8]


def repaired_frame(data: bytes) -> bytes:
    """A MAVLink 2 frame with the length and checksum that its contents ask for; anything else as it is."""
    if len(data) < _HEADER + _CRC or data[0] != _V2:
        return data
    known = mavlink.mavlink_map.get(int.from_bytes(data[7:10], "little"))
    if known is None:
        return data
    payload = data[_HEADER:-_CRC][:255]
    body = bytes([len(payload), 0]) + data[3:_HEADER] + payload
    crc: int = mavlink.x25crc(body + bytes([known.crc_extra])).crc
    return bytes([_V2]) + body + crc.to_bytes(2, "little")


def signed_anew(data: bytes) -> bytes:
    """A neighbour's message of any contents with the right version, length and signature."""
    if len(data) < 2:
        return data
    padded = data[:MESSAGE_BYTES].ljust(MESSAGE_BYTES, b"\0")
    return with_hops(bytes((VERSION,)) + padded[1:], data[1] % 4, DEMO_KEY)


def _decode(data: bytes) -> object:
    return decode(data, DEMO_KEY)


class Parser:
    """A function that understands or raises."""

    def __init__(self, parse: Callable[[bytes], object], good: bytes) -> None:
        self._parse, self._good = parse, good

    def feed(self, data: bytes) -> None:
        """See Reader."""
        self._parse(data)

    def works(self) -> bool:
        """See Reader."""
        self._parse(self._good)
        return True


class Companion:
    """A driver that hears its vehicle."""

    def __init__(self, config: DriverConfig) -> None:
        self._driver, self._now_ns = VehicleDriver(config, 0), 0

    def feed(self, data: bytes) -> None:
        """See Reader."""
        self._now_ns += _EACH_NS
        self._driver.receive(data, self._now_ns)
        self._driver.poll(self._now_ns)
        self._driver.state(self._now_ns)

    def works(self) -> bool:
        """See Reader."""
        return bool(self._driver.poll(self._now_ns + 2 * NS_PER_S))


class Autopilot:
    """A simulated autopilot that hears anybody."""

    def __init__(self, vehicle: SimAutopilot) -> None:
        self._vehicle, self._now_ns = vehicle, 0

    def feed(self, data: bytes) -> None:
        """See Reader."""
        self._now_ns += _EACH_NS
        self._vehicle.receive(data, self._now_ns)
        self._vehicle.step(self._now_ns)
        self._vehicle.take()

    def works(self) -> bool:
        """See Reader."""
        self._vehicle.step(self._now_ns + 2 * NS_PER_S)
        truth = self._vehicle.truth
        return bool(self._vehicle.take()) and truth.east_m == truth.east_m  # no NaN in its motion


class Mind:
    """An agent that hears the radio."""

    def __init__(self, agent: Agent) -> None:
        self._agent, self._now_ns = agent, 0

    def feed(self, data: bytes) -> None:
        """See Reader."""
        self._now_ns += _EACH_NS
        self._agent.hear(data, self._now_ns)

    def works(self) -> bool:
        """See Reader."""
        return bool(self._agent.beacon(self._now_ns))


class Eyes:
    """What takes observations from a user's perception."""

    def __init__(self, perception: Perception) -> None:
        self._perception, self._now_ns = perception, NS_PER_S

    def feed(self, data: bytes) -> None:
        """See Reader."""
        self._now_ns += _EACH_NS
        self._perception.take(data, self._now_ns, (3, 3))

    def works(self) -> bool:
        """See Reader."""
        return self._perception.rate_hz(self._now_ns) >= 0.0


def targets(config_sample: bytes) -> list[Target]:
    """Everything that reads bytes from outside, with samples of real conversations."""
    grid = GridSpec()
    world = random_world(Team.parse("1A1G"), 8, grid.width, grid.height, seed=1)
    agent_config = AgentConfig(grid=grid)
    found: list[Target] = []
    messages: list[bytes] = []
    stacks: tuple[StackName, ...] = ("ardupilot", "px4")
    for stack in stacks:
        heard, fleet = conversation(FleetConfig(world, agent_config, (stack, stack)))
        messages += heard[None]
        for robot in fleet.robots:
            name = f"{stack} {robot.kind.name}"
            to_vehicle, to_companion = heard[robot.robot_id, End.COMPANION], heard[robot.robot_id, End.VEHICLE]
            vehicle, driver = Autopilot(SimAutopilot(robot.body.autopilot.config, 0)), Companion(robot.driver.config)
            found.append(Target(f"mavlink to {name}", vehicle, to_vehicle, repair=repaired_frame))
            found.append(Target(f"mavlink from {name}", driver, to_companion, repair=repaired_frame))
    seen = observe(world, 1, world.starts[0], 4.0, NS_PER_S)
    observation = encode_observation(seen, NS_PER_S)
    agent = Agent(Identity(9, RobotKind.UAV, 0.5), agent_config, Greedy(), DEMO_KEY)
    return [
        *found,
        Target("neighbour messages", Mind(agent), messages, repair=signed_anew),
        Target("neighbour decoder", Parser(_decode, messages[0]), messages, MessageError, repair=signed_anew),
        Target("observations", Eyes(Perception(1, RobotKind.UAV, grid)), [observation]),
        Target("vehicle.toml", Parser(parse_config, config_sample), [config_sample], ConfigError),
        Target("faults.toml", Parser(parse_faults, FAULTS), [FAULTS], ConfigError),
    ]


def conversation(config: FleetConfig) -> tuple[dict[object, list[bytes]], Fleet]:
    """What is said in a short mission: frames by (robot, sending end), radio messages under None."""
    fleet = Fleet(config, Greedy)
    heard: dict[object, list[bytes]] = {None: []}
    for robot in fleet.robots:
        for end in End:
            heard[robot.robot_id, end] = []

        def tap(end: End, data: bytes, robot_id: int = robot.robot_id) -> None:
            kept = heard[robot_id, end]
            kept.extend(split_frames(data)[: _SAMPLES_MAX - len(kept)])

        robot.wire.tap = tap
    for tick in range(_CONVERSATION_S * 10):
        fleet.advance(tick * NS_PER_S // 10)
    heard[None] = [robot.agent.beacon(fleet.now_ns) for robot in fleet.robots]
    return heard, fleet
