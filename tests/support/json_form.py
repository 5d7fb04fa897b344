"""Calls a function as a command that was called with ``--json``."""

import click

from bench.commands.output import JSON


def with_json(function, *arguments):
    """Return what the function returns; it prints one JSON object."""
    command = JSON(click.Command("test", callback=lambda: function(*arguments)))
    return command.main(["--json"], standalone_mode=False)
