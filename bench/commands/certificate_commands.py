"""The group `certificate`: certificates from sealed runs, their authorisation and time stamps."""

from __future__ import annotations

import click

from bench.commands.authorisation_commands import AUTHORISATION_COMMANDS


@click.group()
def certificate() -> None:
    """Authorise a sealed folder with a person's key, and add time stamps."""


for subcommand in AUTHORISATION_COMMANDS:
    certificate.add_command(subcommand)

CERTIFICATE_COMMANDS = (certificate,)
"""Commands of this module, for the command line."""
