"""Vehicles without minds: the simulator's side of a mission whose agents are daemons in processes of their own.

Each vehicle is reached over the gateway. Each daemon gets what its robot sees as the datagram of
`gatar_edge.perception`, at an address of its own, and talks to the others through the simulated radio, which knows a
sender by the address that it sends from. Of the declared faults it knows all but those of companions, which are not
here: who wants to see one die ends its process.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from gatar_edge.errors import ConfigError
from gatar_edge.perception import encode_observation
from gatar_edge.sim_sitl.body import Body
from gatar_edge.sim_sitl.faults import Faults, LinkFaults
from gatar_edge.sim_sitl.faulty_link import End, FaultyLink
from gatar_edge.sim_sitl.fleet_config import FleetConfig
from gatar_edge.sim_sitl.incident_types import ClockSkew, KillCompanion
from gatar_edge.sim_sitl.incidents import Script, happen
from gatar_edge.sim_sitl.radio import Radio
from gatar_edge.sim_sitl.realtime import UdpSocket
from gatar_edge.sim_sitl.tally import Result, Tally
from gatar_edge.sim_sitl.world import observe
from gatar_edge.types import NS_PER_S

PERCEPTION_NS = NS_PER_S // 5


Address = tuple[str, int]


@dataclass(frozen=True, slots=True)
class Sockets:
    """Where the simulator meets the rest of the world; addresses by robot id."""

    vehicles: UdpSocket  # MAVLink of all vehicles, for daemons and ground stations
    radio: UdpSocket  # where daemons send what is meant for their neighbours
    eyes: Mapping[int, Address]  # where each daemon takes observations
    ears: Mapping[int, Address]  # where each daemon hears, and sends from
    listener: Address | None = None  # told all that daemons send, without the radio's faults


class Yard:
    """The bodies of a team in their world. Call `advance` with rising times."""

    def __init__(self, config: FleetConfig, sockets: Sockets) -> None:
        """Raises ConfigError for faults of robots that do not exist, and of companions."""
        self.config = config
        self.bodies = [
            Body(config.world, index, config.agent.grid, config.stacks[index], config.speed_m_s)
            for index in range(len(config.world.team.kinds))
        ]
        self.tally = Tally(config.world, "daemons")
        self.began_ns: int | None = None  # when the first vehicle moved off
        self._sockets = sockets
        self._radio = Radio(config.agent.r_comm, config.faults.radio, config.world.seed, config.faults.between)
        faults, self._autopilots = config.faults, {body.robot_id: body.autopilot for body in self.bodies}
        faults.check(self._autopilots)
        _check_companions(faults)
        self._script = Script(faults.incidents, self._autopilots)
        # a perfect link is left out: over others each frame is a datagram of its own
        self._links = {
            robot_id: FaultyLink(*faults.link_of(robot_id), seed=config.world.seed * 64 + robot_id)
            for robot_id in self._autopilots
            if any(lane != LinkFaults() for lane in faults.link_of(robot_id))
        }
        self._by_ear = {address: robot_id for robot_id, address in sockets.ears.items()}
        self._now_ns = 0
        self._next_look_ns = 0

    @property
    def over(self) -> bool:
        """Nothing left to localize, or out of time."""
        return self.tally.left == 0 or self.step >= self.config.max_steps

    @property
    def step(self) -> float:
        """The mission's time in steps."""
        return 0.0 if self.began_ns is None else (self._now_ns - self.began_ns) / self.config.step_ns

    def advance(self, now_ns: int) -> None:
        """Let the world go on up to `now_ns`."""
        self._now_ns = now_ns
        alive = self._alive()
        received = [data for data, _ in self._sockets.vehicles.receive()]
        for body in alive:
            before_m = body.travelled_m
            self._hear(body, received)
            body.step(now_ns)
            self.tally.travel(body.kind, (body.travelled_m - before_m) / self.config.agent.grid.cell_m)
            self._tell(body)
        if self.began_ns is None and any(body.travelled_m > 1.0 for body in self.bodies):
            self._begin(now_ns)
        if self.began_ns is not None:
            for turn in self._script.due(now_ns - self.began_ns):
                happen(turn, self._autopilots[turn.incident.robot], now_ns)
        self._carry(now_ns)
        if now_ns >= self._next_look_ns:
            self._next_look_ns += PERCEPTION_NS
            self._look(now_ns)

    def result(self) -> Result:
        """The mission's figures, as far as they show from outside the minds."""
        return self.tally.result(self.step)

    def _begin(self, now_ns: int) -> None:
        self.began_ns = now_ns
        self._radio.begin(now_ns)
        for link in self._links.values():
            link.begin(now_ns)

    def _alive(self) -> list[Body]:
        """Those that the scenario has not killed, vehicle and all."""
        began_ns, faults = self.began_ns, self.config.faults
        if began_ns is None:
            return self.bodies
        return [body for body in self.bodies if not faults.killed(body.robot_id, self._now_ns - began_ns)]

    def _hear(self, body: Body, received: list[bytes]) -> None:
        """What came in reaches a vehicle, over its telemetry link."""
        link = self._links.get(body.robot_id)
        if link is None:
            for data in received:
                body.autopilot.receive(data, self._now_ns)
            return
        for data in received:
            link.send(self._now_ns, End.COMPANION, data)
        self._deliver(body, link)

    def _tell(self, body: Body) -> None:
        """What a vehicle says goes out, over its telemetry link."""
        link = self._links.get(body.robot_id)
        if link is None:
            self._sockets.vehicles.send(body.autopilot.take())
            return
        link.send(self._now_ns, End.VEHICLE, body.autopilot.take())
        self._deliver(body, link)

    def _deliver(self, body: Body, link: FaultyLink) -> None:
        arrived = link.deliver(self._now_ns)
        for end, data in arrived:
            if end is End.VEHICLE:
                body.autopilot.receive(data, self._now_ns)
        self._sockets.vehicles.send_datagrams(data for end, data in arrived if end is End.COMPANION)

    def _look(self, now_ns: int) -> None:
        for body in self._alive():
            self.tally.visit(body.cell, self.step)
            seen = observe(self.config.world, body.robot_id, body.cell, self.config.agent.r_sense, now_ns)
            self._sockets.vehicles.send_to(encode_observation(seen, now_ns), self._sockets.eyes[body.robot_id])

    def _carry(self, now_ns: int) -> None:
        """What the daemons sent on the air goes to those in range, with the radio's faults."""
        positions = {body.robot_id: body.cell for body in self._alive()}
        for datagram, sender in self._sockets.radio.receive():
            robot_id = self._by_ear.get(sender)
            if robot_id in positions:
                self.tally.sent(datagram)
                if self._sockets.listener is not None:
                    self._sockets.radio.send_to(datagram, self._sockets.listener)
                self._radio.send(now_ns, robot_id, datagram, positions)
        for receiver, datagram in self._radio.deliver(now_ns):
            if receiver in positions:
                self._sockets.radio.send_to(datagram, self._sockets.ears[receiver])


def _check_companions(faults: Faults) -> None:
    """Raise ConfigError for what would have to happen to a process of somebody else."""
    for incident in faults.incidents:
        if isinstance(incident, KillCompanion | ClockSkew):
            does = type(incident).__struct_config__.tag
            raise ConfigError(
                f"event at {incident.at_s:g} s: {does} befalls a companion, and those are processes of their own here: "
                "leave it out, and end the process instead"
            )
