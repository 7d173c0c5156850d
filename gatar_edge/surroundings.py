"""What a daemon is measured among: a vehicle, perception, neighbours that all hear each other, and an attacker."""

from __future__ import annotations

import itertools
import socket
import time
from collections.abc import Iterator, Sequence

from gatar_edge.agent import Agent, Identity
from gatar_edge.allocators.greedy import Greedy
from gatar_edge.config import AgentConfig
from gatar_edge.keys import DEMO_KEY, KEY_BYTES
from gatar_edge.message import MESSAGE_BYTES, VERSION, first_seq, numbered, sender_of, with_hops
from gatar_edge.perception import encode_observation
from gatar_edge.relaying import IN_RANGE_COPIES
from gatar_edge.sim_sitl.body import Body
from gatar_edge.sim_sitl.realtime import UdpSocket
from gatar_edge.sim_sitl.world import Team, observe, random_world
from gatar_edge.talk import TALK
from gatar_edge.types import NS_PER_S, Cell, GridSpec, RobotKind

GRID = GridSpec()
SPEED_CELLS_S = 0.5
TARGETS = 24
TURNS_PER_S = 20
FOREIGN_KEY = bytes(reversed(range(KEY_BYTES)))


class Surroundings:
    """Robot 1's vehicle and eyes, and neighbours 2, 3, ... in a cluster round the middle that all hear each other."""

    def __init__(self, neighbors: int, key: bytes = DEMO_KEY) -> None:
        self.neighbors = neighbors
        self.relays = min(IN_RANGE_COPIES, max(0, neighbors - 1))  # of each message, as `relaying` has it
        self._key = key
        self._seq = first_seq(time.time_ns())
        self._mission = 0
        self._crowd: list[bytes] = []
        self._seen: dict[Cell, bytes] = {}
        self.next_mission()
        self.body = Body(self.world, 0, GRID, "ardupilot", SPEED_CELLS_S * GRID.cell_m)

    def next_mission(self) -> None:
        """Another map and other targets; robots and vehicle stay where they are."""
        self._mission += 1
        self.world = random_world(Team.parse("1A0G"), TARGETS, GRID.width, GRID.height, seed=self._mission)
        self._crowd = [self._message_of(number) for number in range(self.neighbors)]
        self._seen.clear()

    def messages(self, relays: int) -> list[bytes]:
        """What reaches robot 1 in one tick: each neighbour's message from itself and `relays` times passed on."""
        self._seq += 1
        own = [numbered(message, self._seq, self._key) for message in self._crowd]
        return own + [with_hops(message, 1, self._key) for message in own] * relays

    def observation(self) -> bytes:
        """What robot 1 sees at this moment."""
        cell = self.body.cell
        if cell not in self._seen:
            self._seen[cell] = encode_observation(observe(self.world, 1, cell, 4.0, 0), 0)
        return self._seen[cell]

    def attacks(self) -> Iterator[bytes]:
        """Datagrams of one who knows all but the key, for ever: forged and spoofed messages, forged talk, garbage, and
        replays of what the neighbours sent just now.
        """
        return _attacks(self.messages(relays=0))

    def turns(self, vehicles: UdpSocket, peer: UdpSocket, ports: Sequence[int]) -> Turns:
        """Play on sockets in real time. `peer`: to whom robot 1 sends; `ports`: where it hears, and looks."""
        return Turns(self, vehicles, peer, ports)

    def _message_of(self, number: int) -> bytes:
        cell = (5 + number % 4, 5 + number // 4)
        identity, config = Identity(2 + number, RobotKind(number % 2), SPEED_CELLS_S), AgentConfig(grid=GRID)
        agent = Agent(identity, config, Greedy(), self._key)
        agent.observe(observe(self.world, 1, cell, config.r_sense, 0))
        return agent.beacon(0)


class Turns:
    """The surroundings on sockets, a twentieth of a second a turn."""

    def __init__(self, surroundings: Surroundings, vehicles: UdpSocket, peer: UdpSocket, ports: Sequence[int]) -> None:
        self.flood_per_s = 0
        self.ticks = 0  # of the daemon: its own messages, one a tick
        self._peer = peer
        self._surroundings = surroundings
        self._vehicles = vehicles
        self._ear, self._eye = (("127.0.0.1", port) for port in ports)
        self._attacks = surroundings.attacks()
        self._start_s = time.monotonic()
        self._turn = 0
        self._sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    def spend(self, seconds: float) -> None:
        """Play for so long."""
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            self._play()
            self._turn += 1
            time.sleep(max(0.0, self._start_s + self._turn / TURNS_PER_S - time.monotonic()))

    def close(self) -> None:
        """Close the socket."""
        self._sender.close()

    def _play(self) -> None:
        around = self._surroundings
        now_ns = self._turn * NS_PER_S // TURNS_PER_S
        self.ticks += sum(sender_of(data) == 1 for data, _ in self._peer.receive())
        for data, _ in self._vehicles.receive():
            around.body.autopilot.receive(data, now_ns)
        around.body.step(now_ns)
        self._vehicles.send(around.body.autopilot.take())
        due = list(itertools.islice(self._attacks, self.flood_per_s // TURNS_PER_S))
        if self._turn % 4 == 0:
            due += around.messages(relays=around.relays)
            self._sender.sendto(around.observation(), self._eye)
        for data in due:
            self._sender.sendto(data, self._ear)


def _attacks(recorded: list[bytes]) -> Iterator[bytes]:
    """No two alike but for the replays."""
    for number in itertools.count():
        noise = number.to_bytes(8, "big")
        yield bytes((VERSION,)) + bytes(MESSAGE_BYTES - 1 - len(noise)) + noise
        if recorded:
            spoofed = recorded[number % len(recorded)]
            yield numbered(spoofed, 0xFFFF_FFFF - number, FOREIGN_KEY)
            yield spoofed
        yield bytes((TALK,)) + bytes(60) + noise
        yield noise
