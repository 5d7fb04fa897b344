"""How commands print: text for people, with ``--json`` one object for programs, errors in plain words."""

from __future__ import annotations

import errno
import sys
import traceback
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from bench.base.bounded_json import canonical_json
from bench.base.encoding import counted, printable_line
from bench.base.errors import EvidenceError, ScriptError, StorageError, UsageError
from bench.base.failure import FORESEEN, INVALID_FILES, Failure
from bench.base.home import home_folder
from sequences.errors import DocumentFaults
from sequences.kinds import STATION, kind_of_file

STOPPED = 3
"""Exit status of a command that was stopped on request."""
NOT_KEPT = 4
"""Exit status of a run that finished, and does not keep the limits of its station or sequence."""
DEFECT = "defect"
"""Kind of an unexpected error."""
_DISK_REMEDIES = {
    errno.ENOSPC: "Make room on the disk.",
    errno.EACCES: "Check the permissions.",
    errno.EPERM: "Check the permissions.",
    errno.EROFS: "Use a folder that can be written.",
    errno.ENAMETOOLONG: "Choose a shorter name.",
}


_WANTED = "bench.json"
_MOST_SHOWN = 40
"""Most notes or faults that are printed as text: a screen."""


def _remember(context: click.Context, _option: click.Parameter, wanted: bool) -> None:
    context.meta[_WANTED] = wanted


JSON = click.option(
    "--json",
    is_flag=True,
    expose_value=False,
    callback=_remember,
    help="Print one JSON object to standard output.",
)


def wants_json() -> bool:
    """Return whether the command that runs now was called with ``--json``."""
    context = click.get_current_context(silent=True)
    return context is not None and bool(context.meta.get(_WANTED))


def show(
    data: Mapping[str, Any] | Callable[[], Mapping[str, Any]], text: str | Iterable[str], *, err: bool = False
) -> None:
    """Print ``data`` as JSON if wanted, else ``text`` or its lines; a function works only if it is printed.

    A name within a line writes no line of its own.
    """
    if wants_json():
        print_json(data() if callable(data) else data)
        return
    lines = (text,) if isinstance(text, str) else map(printable_line, text)
    # Each call of echo is a call of the system
    click.echo("".join(f"{line}\n" for line in lines), nl=False, err=err)


def print_line(text: str, *, err: bool = False) -> None:
    """Print one line, whatever names stand in it."""
    click.echo(printable_line(text), err=err)


def print_findings(faults: Sequence[str], notes: Sequence[str] = ()) -> int:
    """Print notes and faults on standard error, of very many the first ones; return the exit status, 1 with a fault."""
    for word, sentences in () if wants_json() else (("Note", notes), ("FAULT", faults)):
        for sentence in sentences[:_MOST_SHOWN]:
            print_line(f"{word}: {sentence}", err=True)
        if len(sentences) > _MOST_SHOWN:
            click.echo(f"{word}: and {len(sentences) - _MOST_SHOWN} more; --json lists all.", err=True)
    return 1 if faults else 0


def left_out_lines(reasons: Sequence[str]) -> list[str]:
    """Return a line on each of the first files that were left out, and one on the number of the others."""
    lines = [f"Left out: {reason}" for reason in reasons[:_MOST_SHOWN]]
    more = len(reasons) - _MOST_SHOWN
    return [*lines, f"Left out: {counted(more, 'more file')}"] if more > 0 else lines


def print_json(value: Mapping[str, Any]) -> None:
    """Print one object on standard output. Raises ValueError when a number is not finite."""
    click.echo(canonical_json(value), nl=False)


def ask_passphrase(key: Path) -> bytes:
    """Ask for the passphrase of a key at the terminal, UTF-8. Raises EvidenceError if there is none."""
    if not sys.stdin.isatty():
        raise EvidenceError(
            "The signing key has a passphrase, and there is no terminal to ask for it.",
            where=str(key),
            remedy="Run at a terminal, or use a key without a passphrase for unattended runs.",
        )
    answer: str = click.prompt(f"Passphrase of {key}", hide_input=True, err=True)
    return answer.encode()


def confirm(question: str) -> bool:
    """Ask a question at the terminal, or read its answer from a pipe. Raises UsageError if there is neither."""
    try:
        return click.confirm(question, err=True)
    except click.Abort:
        if sys.stdin.isatty():
            raise
        raise UsageError("There is no terminal to ask for confirmation.", remedy="Add --yes.") from None


def print_usage_error(error: click.ClickException, arguments: Sequence[str]) -> int:
    """Print what is wrong with the words of a call; ``arguments`` are these words."""
    remedy = _hint(error, arguments)
    if "--json" in arguments:
        print_json({"error": {"kind": "UsageError", "message": error.format_message(), "remedy": remedy}})
    error.show()
    if remedy:
        click.echo(remedy, err=True)
    return error.exit_code


def _hint(error: click.ClickException, arguments: Sequence[str]) -> str:
    """Return what to do if a station file stands where the command has no place for one; else nothing."""
    context = error.ctx if isinstance(error, click.UsageError) else None
    options = {name for param in context.command.params for name in param.opts} if context else set()
    if "--station" not in options or {"--station", "-s"} & set(arguments):
        return ""
    named = next((word for word in arguments[1:] if kind_of_file(Path(word)) is STATION), None)
    return f"{named} is a station file. Name it with --station." if named else ""


def print_error(error: Exception, arguments: Sequence[str]) -> int:
    """Print an error in plain words, with ``--json`` as an object; a traceback with ``--debug``, or of a defect."""
    if isinstance(error, DocumentFaults):
        error = ScriptError([str(fault) for fault in error.faults])
    failure = failure_of(error)
    if "--json" in arguments:
        faults = {"faults": error.faults} if isinstance(error, ScriptError) else {}
        print_json({"error": {**error_object(failure), **faults}})
    click.echo(f"starbench: {failure.message}", err=True)
    if "--debug" in arguments or failure.kind == DEFECT:
        click.echo("".join(traceback.format_exception(error)), err=True)
    return 2 if isinstance(error, INVALID_FILES) else getattr(error, "exit_status", 1)


def error_object(failure: Failure) -> dict[str, object]:
    """Return an error as JSON: ``kind``, ``message`` (all in one sentence or more), ``what``, ``where``, ``remedy``."""
    return {"kind": failure.kind, "message": failure.message, **failure.to_dict()}


def failure_of(error: Exception) -> Failure:
    """Return what is told of an error, with its remedy."""
    if isinstance(error, FORESEEN):
        failure = Failure.of(error)
        return replace(failure, remedy=f"{failure.remedy}{_home_hint(error)}")
    if isinstance(error, OSError):
        remedy = _DISK_REMEDIES.get(error.errno or 0, "Check the path and the disk.")
        where = str(error.filename) if error.filename else ""
        return Failure(type(error).__name__, f"{_quoted(error.strerror or error)}.", where, remedy)
    import sqlite3  # most commands need none

    if isinstance(error, sqlite3.Error):
        remedy = "Make room, check the permissions, or name another folder in STARBENCH_HOME."
        what = f"The bench's own files cannot be used: {_quoted(error)}."
        return Failure(type(error).__name__, what, str(home_folder()), remedy)
    what = f"This is a defect in Starbench, not an error of yours: {type(error).__name__}: {_quoted(error)}."
    return Failure(DEFECT, what, "", "Please report it with the lines below.")


def _quoted(error: object) -> str:
    """Return a message of another program without its full stop."""
    return str(error).rstrip(".")


def _home_hint(error: BaseException) -> str:
    """Return how to choose another folder for the bench's own files, if these cannot be written."""
    if not isinstance(error, StorageError) or not error.where:
        return ""
    home, where = home_folder().absolute(), Path(error.where).absolute()
    if where != home and home not in where.parents and where not in home.parents:
        return ""
    return " To use another folder for the bench's own files, name it in STARBENCH_HOME."
