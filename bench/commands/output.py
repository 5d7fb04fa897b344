"""What commands print: results and errors in words for people, or as one JSON object for programs.

Knows how to say things, and does the little that belongs to saying them (asking for a passphrase, waiting beside a
simulated bench). Results and errors come from the modules that make them.
"""

from __future__ import annotations

import errno
import json
import sqlite3
import traceback
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from bench.base.errors import ScriptError, StorageError
from sequences.errors import DocumentFaults

STOPPED = 3


def print_json(value: Mapping[str, Any]) -> None:
    """Print one object on standard output."""
    click.echo(json.dumps(value, indent=1, allow_nan=False))


def tell_error(error: Exception, *, as_json: bool, debug: bool) -> int:
    """Tell an error in plain words; return the exit status."""
    if isinstance(error, DocumentFaults):
        error = ScriptError([str(fault) for fault in error.faults])
    kind, message, remedy = _words_of(error)
    foreseen = kind != "defect"
    if as_json:
        said: dict[str, Any] = {"kind": kind, "message": message, "remedy": remedy}
        if isinstance(error, ScriptError):
            said["faults"] = error.faults
        print_json({"error": said})
    click.echo(f"starbench: {message}", err=True)
    if debug or not foreseen:
        click.echo("".join(traceback.format_exception(error)), err=True)
    return getattr(error, "exit_status", 1)


def _words_of(error: Exception) -> tuple[str, str, str]:
    """Give kind, message and remedy of an error; kind ``defect`` for one that nobody foresaw."""
    if hasattr(error, "what") and hasattr(error, "remedy"):
        hint = _hint_of_home(error)
        return type(error).__name__, f"{error}{hint}", f"{error.remedy}{hint}"
    if isinstance(error, OSError):
        remedy = {
            errno.ENOSPC: "Make room on the disk.",
            errno.EACCES: "Check the permissions.",
            errno.EPERM: "Check the permissions.",
            errno.EROFS: "Use a folder that can be written.",
            errno.ENAMETOOLONG: "Choose a shorter name.",
        }.get(error.errno or 0, "Check the path and the disk.")
        where = f"{error.filename}: " if error.filename else ""
        return type(error).__name__, f"{where}{error.strerror or error}. {remedy}", remedy
    if isinstance(error, sqlite3.Error):
        from bench.base.home import home_folder

        remedy = "Make room, check the permissions, or name another folder in STARBENCH_HOME."
        return (
            type(error).__name__,
            f"{home_folder()}: The bench's files are not usable: {error}. {remedy}",
            remedy,
        )
    message = f"This is a defect in Starbench, not in what you did: {type(error).__name__}: {error}"
    return "defect", message, "Please report it with the lines below."


def _hint_of_home(error: Exception) -> str:
    """Tell how the bench's own folder is named, where that is what could not be written."""
    from bench.base.home import home_folder

    if not isinstance(error, StorageError) or not error.where:
        return ""
    home, where = home_folder().absolute(), Path(error.where).absolute()
    if where != home and home not in where.parents and where not in home.parents:
        return ""
    return " The bench's own folder can be another: name it in STARBENCH_HOME."
