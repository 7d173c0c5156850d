"""Commands: re-sent until answered, and never believed on another's answer."""

from __future__ import annotations

import pytest

from gatar_edge.bridge.commands import CommandClient
from gatar_edge.bridge.dialect import Command, CommandResult
from gatar_edge.bridge.wire import CommandAck

S = 1_000_000_000
ME, VEHICLE = (7, 191), (7, 1)


def client() -> CommandClient:
    commands = CommandClient(ME, VEHICLE)
    commands.long(Command.COMPONENT_ARM_DISARM, 1.0)
    return commands


def test_a_command_is_sent_each_second_five_times_and_then_has_no_answer() -> None:
    commands = client()
    sent = [len(commands.poll(i * S // 10)) for i in range(200)]
    assert [i for i, n in enumerate(sent) if n] == [0, 10, 20, 30, 40]
    assert commands.result(Command.COMPONENT_ARM_DISARM) is CommandResult.NO_ANSWER


@pytest.mark.parametrize("answer", [CommandResult.ACCEPTED, CommandResult.DENIED, CommandResult.FAILED])
def test_an_answer_ends_the_command(answer: CommandResult) -> None:
    commands = client()
    commands.poll(0)
    assert commands.under_way(Command.COMPONENT_ARM_DISARM)
    commands.receive(CommandAck(Command.COMPONENT_ARM_DISARM, answer, ME))
    assert commands.result(Command.COMPONENT_ARM_DISARM) is answer
    assert not commands.under_way(Command.COMPONENT_ARM_DISARM)
    assert commands.poll(9 * S) == []


@pytest.mark.parametrize("answer", [CommandResult.TEMPORARILY_REJECTED, CommandResult.IN_PROGRESS])
def test_a_command_that_is_put_off_is_sent_again(answer: CommandResult) -> None:
    commands = client()
    commands.poll(0)
    commands.receive(CommandAck(Command.COMPONENT_ARM_DISARM, answer, ME))
    assert commands.result(Command.COMPONENT_ARM_DISARM) is None
    assert len(commands.poll(S)) == 1


def test_a_result_of_a_newer_dialect_is_a_failure() -> None:
    commands = client()
    commands.poll(0)
    commands.receive(CommandAck(Command.COMPONENT_ARM_DISARM, 77, ME))
    assert commands.result(Command.COMPONENT_ARM_DISARM) is CommandResult.FAILED


@pytest.mark.parametrize("target", [ME, (7, 0), (0, 0)])
def test_an_answer_for_us_or_for_all_counts(target: tuple[int, int]) -> None:
    commands = client()
    commands.poll(0)
    commands.receive(CommandAck(Command.COMPONENT_ARM_DISARM, 0, target))
    assert commands.result(Command.COMPONENT_ARM_DISARM) is CommandResult.ACCEPTED


@pytest.mark.parametrize(
    ("command", "target"), [(Command.COMPONENT_ARM_DISARM, (255, 190)), (Command.NAV_TAKEOFF, ME), (99, ME)]
)
def test_an_answer_for_another_sender_or_command_does_not_count(command: int, target: tuple[int, int]) -> None:
    commands = client()
    commands.poll(0)
    commands.receive(CommandAck(command, 0, target))
    assert commands.result(Command.COMPONENT_ARM_DISARM) is None


def test_an_answer_before_the_command_was_sent_does_not_count() -> None:
    commands = client()
    commands.receive(CommandAck(Command.COMPONENT_ARM_DISARM, 0, ME))
    assert commands.result(Command.COMPONENT_ARM_DISARM) is None
