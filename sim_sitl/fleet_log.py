"""What a simulated fleet writes into its log, beside what its radio says."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import msgspec

from gatar_edge.foxglove import Level
from gatar_edge.record import Recorder
from gatar_edge.sim_sitl.fleet_config import FleetConfig
from gatar_edge.types import VehicleCommand

if TYPE_CHECKING:
    from gatar_edge.sim_sitl.fleet import Robot, Thought


def write_beginning(log: Recorder, config: FleetConfig, now_ns: int) -> None:
    """The truth, and what is wrong with the links all along."""
    log.truth_map(config.world.obstacles, config.world.targets, now_ns)
    for link in ("radio", "to_vehicle", "to_companion"):
        faults = getattr(config.faults, link)
        if not faults.none:
            log.fault(link, 0, msgspec.to_builtins(faults), now_ns)


def write_fault(log: Recorder, robot_id: int, text: str, details: dict[str, Any], now_ns: int) -> None:
    """Something happens to a robot that nobody asked for."""
    log.fault(str(details["do"]), robot_id, details, now_ns)
    log.text(Level.WARNING, robot_id, text, now_ns)


def write_wire(log: Recorder, robot: Robot) -> None:
    """What driver and autopilot told each other, and what the driver made of it."""
    for frame in robot.driver.frames():
        log.mavlink(robot.robot_id, "tx" if frame.outgoing else "rx", frame.raw, frame.t_ns)
    for event in robot.driver.events():
        log.text(Level.INFO, robot.robot_id, event.text, event.t_ns)


def write_thought(log: Recorder, thought: Thought, sent: VehicleCommand, now_ns: int) -> None:
    """What a robot saw and decided, what its vehicle was told and is, and what the robot knows."""
    robot, seen, out, latency_ns = thought
    decision = msgspec.structs.replace(out.decision, latency_ns=latency_ns)
    log.observation(seen)
    log.decision(decision, out.command, sent, now_ns)
    log.vehicle(robot.robot_id, robot.driver.state(now_ns), now_ns)
    log.belief(robot.robot_id, robot.agent.belief, robot.agent.config.grid, now_ns)
