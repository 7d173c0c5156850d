"""COMMAND_LONG and COMMAND_INT with their acknowledgements: re-sent each second until answered, sans-IO.

One command of each kind is under way at most. An acknowledgement names the command alone, so a late copy may answer for
its successor: what really happened is read from the vehicle's state, never from the acknowledgement.
"""

from __future__ import annotations

from dataclasses import dataclass

from gatar_edge.bridge.dialect import CommandResult
from gatar_edge.bridge.wire import Address, CommandAck, CommandInt, CommandLong, Message
from gatar_edge.types import NS_PER_S

NEVER_NS = 1 << 62  # of what only a message or a command sets going
RETRY_NS = NS_PER_S
TRIES = 5

# These leave the command under way; all others end it.
_UNDER_WAY = frozenset({CommandResult.TEMPORARILY_REJECTED, CommandResult.IN_PROGRESS})


@dataclass(slots=True)
class _Pending:
    message: CommandLong | CommandInt
    sent_ns: int = -RETRY_NS
    sends: int = 0
    result: CommandResult | None = None


class CommandClient:
    """The commands under way to one autopilot."""

    def __init__(self, me: Address, vehicle: Address) -> None:
        self.me, self.vehicle = me, vehicle
        self._pending: dict[int, _Pending] = {}

    def send(self, message: CommandLong | CommandInt) -> None:
        """Start (over) with this command; `poll` sends it."""
        self._pending[message.command] = _Pending(message)

    def long(self, command: int, *params: float) -> None:
        """`send` a COMMAND_LONG with its first params, the others zero."""
        p = (*params, *([0.0] * (7 - len(params))))
        self.send(CommandLong(self.vehicle, command, (p[0], p[1], p[2], p[3], p[4], p[5], p[6])))

    def forget(self, command: int) -> None:
        """Stop re-sending it."""
        self._pending.pop(command, None)

    def clear(self) -> None:
        """Stop re-sending anything."""
        self._pending.clear()

    def result(self, command: int) -> CommandResult | None:
        """How it ended; None while it is under way or was never sent."""
        pending = self._pending.get(command)
        return pending.result if pending else None

    def under_way(self, command: int) -> bool:
        """Whether it was sent and has not ended."""
        pending = self._pending.get(command)
        return pending is not None and pending.result is None

    def receive(self, ack: CommandAck) -> None:
        """Take an acknowledgement; old firmware leaves its target empty."""
        pending = self._pending.get(ack.command)
        if pending is None or not pending.sends or ack.target not in (self.me, (self.me[0], 0), (0, 0)):
            return
        try:
            result = CommandResult(ack.result)
        except ValueError:  # of a newer dialect: certainly not "accepted"
            result = CommandResult.FAILED
        if result not in _UNDER_WAY:
            pending.result = result

    @property
    def due_ns(self) -> int:
        """When `poll` has something to do again, unless something arrives or is commanded first."""
        if not self._pending:
            return NEVER_NS
        return min((p.sent_ns + RETRY_NS for p in self._pending.values() if p.result is None), default=NEVER_NS)

    def poll(self, now_ns: int) -> list[Message]:
        """All commands due now."""
        due: list[Message] = []
        if not self._pending:
            return due
        for pending in self._pending.values():
            if pending.result is not None or (now_ns - pending.sent_ns < RETRY_NS and pending.sends):
                continue
            if pending.sends >= TRIES:
                pending.result = CommandResult.NO_ANSWER
                continue
            pending.sent_ns = now_ns
            pending.sends += 1
            due.append(pending.message)
        return due
