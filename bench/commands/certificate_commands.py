"""The group `certificate`: certificates from sealed runs, their authorisation and time stamps."""

from __future__ import annotations

import click

from bench.commands.authorisation_commands import AUTHORISATION_COMMANDS
from bench.commands.dcc_commands import DCC_COMMANDS
from bench.commands.issue_commands import ISSUE_COMMANDS


@click.group()
def certificate() -> None:
    """Issue, amend, list, check, authorise and time-stamp calibration certificates."""


for subcommand in (*ISSUE_COMMANDS, *AUTHORISATION_COMMANDS, *DCC_COMMANDS):
    certificate.add_command(subcommand)

CERTIFICATE_COMMANDS = (certificate,)
"""Commands of this module, for the command line."""
