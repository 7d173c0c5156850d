"""Reading parameters of a vehicle by name, sans-IO. Nothing here can set one.

ArduPilot sends an integer as a float, PX4 the integer's own bits where the float would stand; both tell its type. A
parameter that a vehicle does not have is answered by silence (or by a text), so it is given up after TRIES.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable
from dataclasses import dataclass

from gatar_edge.bridge.wire import Address, Message, ParamRead, ParamValue
from gatar_edge.types import NS_PER_S

RETRY_NS = NS_PER_S // 2
TRIES = 8  # of 30 % lost each way, one name in 200 is given up wrongly
UNDER_WAY = 16  # ArduPilot queues 20

# MAV_PARAM_TYPE -> how its bits are read
_INTEGERS = {1: "<B", 2: "<b", 3: "<H", 4: "<h", 5: "<I", 6: "<i"}


@dataclass(slots=True)
class _Asked:
    sent_ns: int = -RETRY_NS
    tries: int = 0


def value_of(message: ParamValue, bytewise: bool) -> float | None:
    """The value of a PARAM_VALUE, None where it is no finite number."""
    form = _INTEGERS.get(message.type, "<f") if bytewise else "<f"
    value = float(struct.unpack(form, message.raw[: struct.calcsize(form)])[0])
    return value if math.isfinite(value) else None


class ParameterReader:
    """Asks one vehicle for some parameters until each is known or given up."""

    def __init__(self, vehicle: Address, names: Iterable[str], bytewise: bool) -> None:
        self.values: dict[str, float] = {}
        self._vehicle, self._bytewise = vehicle, bytewise
        self._asked = {name: _Asked() for name in names}

    @property
    def done(self) -> bool:
        """Whether nothing is open any more."""
        return not self._asked

    def receive(self, message: ParamValue) -> None:
        """Take a PARAM_VALUE; what was not asked for is ignored."""
        value = value_of(message, self._bytewise)
        if message.name in self._asked and value is not None:
            del self._asked[message.name]
            self.values[message.name] = value

    def poll(self, now_ns: int) -> list[Message]:
        """All requests due now."""
        for name in [name for name, asked in self._asked.items() if self._given_up(asked, now_ns)]:
            del self._asked[name]
        due: list[Message] = []
        for name, asked in list(self._asked.items())[:UNDER_WAY]:
            if now_ns - asked.sent_ns >= RETRY_NS:
                asked.sent_ns = now_ns
                asked.tries += 1
                due.append(ParamRead(self._vehicle, name))
        return due

    def _given_up(self, asked: _Asked, now_ns: int) -> bool:
        return asked.tries >= TRIES and now_ns - asked.sent_ns >= RETRY_NS
