"""The `gatar` command: loads a subcommand only when it is called; our errors become one line and exit code 2."""

from __future__ import annotations

import importlib
import sys

import click

from gatar_edge import __version__
from gatar_edge.errors import GatarError

COMMANDS = {
    "sim": "fly a seeded mission with simulated autopilots",
    "init": "write the configuration of one vehicle",
    "vehicle": "run the inference daemon of one vehicle",
    "doctor": "check that a vehicle is set up right",
    "selftest": "prove that this installation decides as it should, without torch",
    "bridge": "look after what is on board of a vehicle",
    "fleet": "show the team live, by listening only",
    "dataset": "make training data with a teacher",
    "train": "train a network",
    "tune": "fine-tune a network on how long missions take",
    "eval": "compare allocators with the paper and with each other",
    "export": "turn a trained network into one ONNX file",
    "verify": "prove that an ONNX file equals its network",
    "quantize": "try 8-bit integers: latency, size and decisions side by side",
    "log": "review a mission log",
    "bench": "measure this machine",
}


class LazyGroup(click.Group):
    """Lists all commands without importing any of them."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        module = importlib.import_module(f"gatar_edge.commands.{cmd_name}")
        command: click.Command = module.command
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(__version__, prog_name="gatar")
def gatar() -> None:
    """Decentralized task allocation for teams of UAVs and UGVs.

    \b
    Example:
      gatar sim --team 3A3G --targets 24 --size 15 --seed 1 --log mission.mcap
      gatar log report mission.mcap
    """


def main() -> None:
    """Run `gatar`; errors of ours and wrong usage end as one line and exit code 2."""
    try:
        result = gatar(prog_name="gatar", standalone_mode=False)
    except GatarError as error:
        click.echo(f"gatar: {error}", err=True)
        sys.exit(2)
    except click.exceptions.NoArgsIsHelpError as error:
        error.show()
        sys.exit(2)
    except click.ClickException as error:
        click.echo(f"gatar: {_one_line(error)}", err=True)
        sys.exit(error.exit_code)
    except click.Abort as abort:
        if isinstance(abort.__context__, EOFError):
            click.echo("gatar: an answer is missing: give it as an option - see --help", err=True)
            sys.exit(2)
        click.echo("gatar: interrupted", err=True)
        sys.exit(130)
    except OSError as error:  # that no command has foreseen: a full disk, a folder that may not be entered
        click.echo(f"gatar: {error}", err=True)
        sys.exit(2)
    sys.exit(result if isinstance(result, int) else 0)


def _one_line(error: click.ClickException) -> str:
    context = error.ctx if isinstance(error, click.UsageError) else None
    text = " ".join(error.format_message().split())
    return f"{text.rstrip('.')} - see `{context.command_path} --help`" if context is not None else text
