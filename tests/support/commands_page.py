"""The page of all commands, made from the commands themselves.

    python tests/support/commands_page.py > docs/commands.md

`tests/unit/documents/test_commands_page.py` checks that the page is the one that this program prints.
"""

from __future__ import annotations

import click

from bench.commands.cli import SECTIONS, cli

HEAD = """# All commands

<!-- This page is made by a program. Do not edit it: python tests/support/commands_page.py > docs/commands.md -->

`starbench COMMAND --help` shows options, examples and exit statuses. [README](../README.md#commands) has the ten commands of
an operator."""


def lines_of(name: str, command: click.Command) -> list[str]:
    """Return the line of a command; of a group, a line for each of its commands."""
    if isinstance(command, click.Group):
        return [line for inner, one in command.commands.items() for line in lines_of(f"{name} {inner}", one)]
    purpose = (command.help or "").partition("\n\n")[0].replace("\n", " ")
    return [f"* `starbench {name}`: {purpose}"]


def page() -> str:
    """Return the page, with the sections of `starbench --help` in their order."""
    lines, nobody = [HEAD], click.Context(cli)
    for title, names in SECTIONS.items():
        lines += ["", f"## {title}", ""]
        for name in names:
            command = cli.get_command(nobody, name)
            assert command is not None
            lines += lines_of(name, command)
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(page(), end="")
