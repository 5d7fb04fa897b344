"""The command line as data: every command, its examples, and whether a call uses words that there are."""

import shlex

import click

from bench.commands.cli import SECTIONS, cli

NOBODY = click.Context(cli)
CORE = [name for section in SECTIONS.values() for name in section]


def commands(names, group=cli, path=()):
    """The commands of these names, those of a family too, by their words."""
    for name in names:
        command = group.get_command(NOBODY, name)
        yield " ".join((*path, name)), command
        if isinstance(command, click.Group):
            yield from commands(command.list_commands(NOBODY), command, (*path, name))


def examples(known):
    """The examples in the help of commands."""
    lines = (line for command in known.values() for line in command.epilog.splitlines())
    return [line.strip() for line in lines if line.startswith("  starbench")]


def check_help(words, command, text):
    """Fail where the help of a command has no purpose, no example or no statuses."""
    assert "Example" in text
    assert f"starbench {words}" in text
    assert "Exit status: 0" in text
    for option in command.params:
        assert not isinstance(option, click.Option) or option.hidden or option.help, option.name


def check_words(line):
    """Fail where a call uses words that there are not; return those that must be and are not."""
    words = shlex.split(line.partition(" > ")[0])[1:]
    command = cli
    while isinstance(command, click.Group):
        name = words.pop(0)
        command = command.get_command(NOBODY, name)
        assert command is not None, f"there is no command {name!r}"
    values, rest, _ = command.make_parser(click.Context(command)).parse_args(words)
    assert rest == []
    unset = (None, getattr(click.core, "UNSET", None))
    given = {name for name, value in values.items() if not any(value is none for none in unset)}
    return [p.name for p in command.params if p.required and p.name not in given]
