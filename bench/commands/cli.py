"""The command line, `starbench`: the list of commands, and how every command ends. A module has one command or some.

Only the called command's module is imported. With ``--json`` one object goes to standard output, all else to standard
error. Exit status: 0 done, 1 failed, 2 invalid argument or file, 3 stopped on request, 130 ended by Ctrl-C.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from importlib import import_module
from importlib.metadata import EntryPoint
from typing import Any

import click

from bench import __version__
from bench.base.entry_points import COMMANDS, entry_points, load_entry, stale_remark
from bench.commands.options import RUN_STATUS

SECTIONS = {
    "Before a run": {
        "plan": "Check a sequence or a queue; show time, disk space and expected uncertainty.",
    },
    "A run": {
        "run": "Run a sequence on a station and write a sealed report.",
        "resume": "Continue a run that was stopped, failed or was interrupted.",
        "verify": "Check a sealed run, certificate or recalculated results.",
    },
    "While it runs, from another terminal": {
        "status": "Show the status of a run or a batch.",
        "tell": "Hold, release or abort a run, skip a pose, answer a question; change a batch.",
    },
    "Many runs": {
        "batch": "Do all runs of a queue file; a second process supervises each run.",
        "rehearse": "Try a queue without devices: a night takes about a minute.",
        "runs": "List runs.",
        "ledger": "Check the ledger of this bench; explain a break in it.",
        "messages": "List or send the messages of this bench.",
    },
    "Without devices": {
        "calibrate": "Calibrate from runs, recordings, images or point files: together, or each run alone.",
        "passport": "Calibrate a collimator once; a camera then needs 1 to 3 views.",
    },
    "The bench": {
        "devices": "List connected devices.",
        "station": "Create a station file.",
        "target": "Show which camera and collimator the target suits; draw it.",
        "simulate": "Keep a simulated bench running.",
        "keys": "Show, create, trust, replace and revoke signing keys.",
        "schema": "Print the JSON Schema of a kind of file, for an editor.",
    },
}
"""The core's commands by their purpose, each with its line in ``starbench --help``; packages bring more."""
_MODULES = {
    "resume": "run",
    "rehearse": "batch",
    **dict.fromkeys(("tell", "messages"), "status"),
    **dict.fromkeys(("devices", "schema", "target", "simulate"), "station"),
}
"""Modules of the commands that share one; all others have the name of their command."""
_GONE = {
    **dict.fromkeys(
        ("certificate --xades-key", "certificate --xades-certificate"),
        "Certificates have no XML signature of their own: leave the option out. The seal of the bench covers dcc.xml; "
        "another program can sign a copy of it.",
    ),
    "calibrate --compare": "The comparison left: `make table1` in the source folder compares methods, and "
    "`calibrate --model planar` is Zhang's method on your views.",
    "history capability": "The gauge study left: write `starbench history table -o runs.csv`, and study that with a "
    "statistics program.",
    "panel --line": "The page of a line left: `starbench run ... --expect-serial -` reads a scanner and says PASS or "
    "FAIL.",
}
"""Commands and options that left, and where their work is done (docs/decisions/0058)."""


class LazyCommands(click.Group):
    """Lists its commands by purpose, each on one whole line at any terminal width; imports one when it is called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """See `click.Group.list_commands`."""
        del ctx
        return [name for commands in _sections().values() for name in commands]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """See `click.Group.get_command`."""
        del ctx
        command: click.Command
        if any(cmd_name in commands for commands in SECTIONS.values()):
            command = getattr(import_module(f"bench.commands.{_MODULES.get(cmd_name, cmd_name)}"), cmd_name)
            return command
        for entry in entry_points(COMMANDS).values():
            if _stated(entry)[0] == cmd_name:
                command = load_entry(entry)
                return command
        return None

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """See `click.Group.resolve_command`. What left is refused with where its work is done."""
        options = [f"{args[0]} {word.partition('=')[0]}" for word in args[1:] if word.startswith("--")]
        for words in (" ".join(args[:2]), *options, args[0]):
            if words in _GONE:
                raise click.UsageError(_GONE[words], ctx)
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """See `click.Group.format_commands`."""
        del ctx
        for title, commands in _sections().items():
            with formatter.section(title):
                formatter.write_dl(list(commands.items()), col_max=13)


def _sections() -> dict[str, dict[str, str]]:
    """Return the core's commands and those that packages bring, by section."""
    sections = {title: dict(commands) for title, commands in SECTIONS.items()}
    known = {name for commands in SECTIONS.values() for name in commands}
    for entry in entry_points(COMMANDS).values():
        name, title, line = _stated(entry)
        if name not in known:
            sections.setdefault(title, {})[name] = line
            known.add(name)
    return sections


def _stated(entry: EntryPoint) -> tuple[str, str, str]:
    """Return name, section and line in ``--help`` of a command, from its entry point's ``name | section | line``."""
    name, section, line, *_ = (*map(str.strip, entry.name.split("|")), "", "")
    return name, section or "Of other packages", line


@click.group(
    cls=LazyCommands,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog=f"Exit status: {RUN_STATUS}",
)
@click.version_option(__version__, "-V", "--version", prog_name="starbench")
@click.option("--debug", is_flag=True, expose_value=False, help="On an error, print the traceback too.")
def cli() -> None:
    """Calibrate event cameras on a collimator bench without an operator, and write a report that anyone can verify.

    To begin: starbench run three_pose --station simulated

    Each command has its own help with an example: starbench run --help
    """


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit. Every expected error is printed as one message, without a traceback."""
    # Our matrices are small: several threads take three times as long as one. Must be set before numpy is imported.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from bench.base.encoding import replace_unencodable
    from bench.base.kernel_cache import remove_stale_kernels, set_kernel_cache
    from bench.base.lost_output import protect_output
    from bench.base.supervised import end_with_supervisor

    protect_output()  # first: what is opened before may take the place of a closed stream
    end_with_supervisor()
    set_kernel_cache(os.environ)
    remove_stale_kernels()
    replace_unencodable(sys.stdout, sys.stderr)
    args = sys.argv[1:] if arguments is None else arguments
    if args[:1] == ["help"]:  # `starbench help run` is `starbench run --help`
        args = [*args[1:], "--help"]
    sys.exit(_exit_status(lambda: _called(args), args))


def _called(arguments: list[str]) -> Any:
    """Call a command. Results state the names of files, so a name that is not UTF-8 is refused before any work."""
    for word in arguments if {"run", "batch", "calibrate"} & set(arguments[:1]) else ():
        if word.encode(errors="replace").decode() != word:
            raise click.UsageError(f"{word!r} is not UTF-8. Rename it, or set the terminal to UTF-8.")
    return cli.main(args=arguments, prog_name="starbench", standalone_mode=False)


def _exit_status(command: Callable[[], Any], arguments: list[str]) -> int:
    """Run a command, which SIGTERM ends as Ctrl-C does; print its error, if any, and return the exit status."""
    from bench.base.clock import reliable_interrupts

    try:
        with reliable_interrupts():
            status = command()
    except (click.exceptions.Abort, KeyboardInterrupt):
        click.echo("Stopped.", err=True)
        return 128 + 2
    except Exception as error:  # noqa: BLE001 - the last place that can print any error in plain words
        from bench.commands.output import print_error, print_usage_error

        if remark := stale_remark():
            click.echo(remark, err=True)
        if isinstance(error, click.ClickException):
            return print_usage_error(error, arguments)
        return print_error(error, arguments)
    return int(status or 0)
