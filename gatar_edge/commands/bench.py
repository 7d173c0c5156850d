"""`gatar bench`: measurements that documents quote; each subcommand is a file of its own, loaded when it is called."""

from __future__ import annotations

import importlib

import click

BENCHES = {
    "sim": "how much faster than real time the fleet simulator flies",
    "faults": "mission uploads through bad links: what ended how",
    "missions": "whole missions over bad links and with deaths",
    "fuzz": "random and mutated bytes into every parser",
    "daemon": "memory, load and start of one daemon",
    "policy": "features, network, decoder and the whole tick",
    "dataset": "labelled robot-samples per CPU-second",
}


class LazyBenches(click.Group):
    """Lists all benches without importing any of them."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(BENCHES)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in BENCHES:
            return None
        command: click.Command = importlib.import_module(f"gatar_edge.commands.bench_{cmd_name}").command
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl(list(BENCHES.items()))


@click.command("bench", cls=LazyBenches)
def command() -> None:
    """Measure this machine. All print a table, or JSON with --json.

    \b
    Example:
      gatar bench sim --team 6A6G
    """
