"""What commands about runs print: in words for people, or as JSON for programs (`bench.cli_runs`)."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click
from pydantic import ValidationError

from bench.errors import UsageError
from bench.output import STOPPED, print_json


def show_intentions(lines: Sequence[str], *, as_json: bool) -> int:
    """Say what resuming a run would do."""
    if as_json:
        print_json({"schema": "starbench/intentions/1", "intentions": list(lines)})
    else:
        click.echo("\n".join(lines))
    return 0


def show_status(folder: Path, *, follow: bool, as_json: bool) -> int:
    """Say how a run stands; with ``follow`` again after every change, and with the run's own exit status."""
    from bench.status import follow as look_again
    from bench.status import read_status, status_text

    for status in look_again(folder) if follow else [read_status(folder)]:
        if as_json:
            click.echo(json.dumps(status.to_dict(), allow_nan=False, indent=None if follow else 1))
        else:
            click.echo(status_text(status) + ("\n" if follow else ""))
    return {"finished": 0, "aborted": STOPPED}.get(status.ended, 1) if follow else 0


def give_command(folder: Path, word: str, *, by: str | None, as_json: bool, **words: Any) -> int:
    """Give a command to a run under way, and say what became of it."""
    from bench.control import Command, command_text, send, who_is_there

    try:
        command = Command.model_validate({"word": word, "by": by or who_is_there(), **words})
    except ValidationError as error:
        raise UsageError(
            f"--operator: {error.errors()[0]['msg']}.",
            remedy="Give a name of at most 200 characters, in one line.",
        ) from error
    answer = send(folder, command)
    if as_json:
        print_json({"schema": "starbench/answer/1", **answer})
    else:
        click.echo(command_text(answer), err=not answer["taken"])
    return 0 if answer["taken"] else 1
