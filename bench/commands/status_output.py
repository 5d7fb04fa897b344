"""Output of `status`: a run or a batch, once or followed; one block that stays on a terminal, lines elsewhere."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from bench.commands.output import STOPPED
from bench.terminal.closed_output import output_is_lost

if TYPE_CHECKING:
    from bench.batch.batch_status import BatchStatus
    from bench.run.status import Status

_INTERRUPTED = 130
_NOT_READ = 128 + 13
"""Exit status of `status --follow` whose output nobody reads any more: that of SIGPIPE."""
_ENDED = {"finished": 0, "aborted": STOPPED}


def show_status(folder: Path, *, follow: bool, as_json: bool) -> int:
    """Print the status of a run or a batch.

    follow: Whether to follow it until it ends.
    as_json: Whether to print JSON; with ``follow`` one line for each change.
    Returns: Exit status; with ``follow`` that of the run or batch, 130 after Ctrl-C, or 141 if the reader of
      the output has gone.
    """
    from bench.records.run_index import is_batch

    of_batch = is_batch(folder)
    if not follow:
        return _show_batch(folder, as_json=as_json) if of_batch else _show_run(folder, as_json=as_json)
    try:
        ended = (_follow_batch if of_batch else _follow_run)(folder, as_json=as_json)
    except KeyboardInterrupt:
        noun = "batch" if of_batch else "run"
        click.echo(f"\nNo longer following. The {noun} is not affected.", err=True)
        return _INTERRUPTED
    return _NOT_READ if output_is_lost() else _ENDED.get(ended, 1)


def _show_run(folder: Path, *, as_json: bool) -> int:
    from bench.run.status import read_status
    from bench.run.status_text import status_text

    status = read_status(folder)
    click.echo(json.dumps(status.to_dict(), allow_nan=False, indent=1) if as_json else status_text(status))
    return 0


def _show_batch(folder: Path, *, as_json: bool) -> int:
    from bench.batch.batch_status import batch_status_text, read_batch_status

    status = read_batch_status(folder)
    click.echo(
        json.dumps(status.to_dict(), allow_nan=False, indent=1) if as_json else batch_status_text(status)
    )
    return 0


def _follow_run(folder: Path, *, as_json: bool) -> str:
    """Follow a run; return how it ended, empty if it was interrupted."""
    from bench.run.follow_status import follow, follow_lines
    from bench.run.status_text import head_lines
    from bench.terminal.block import Block

    status: Status
    if as_json:
        for status in follow(folder):
            click.echo(json.dumps(status.to_dict(), allow_nan=False))
            if output_is_lost():
                break
        return status.ended
    block = Block()
    if block.can_redraw:
        for status in follow(folder, ticks=True):
            block.draw(head_lines(status), [f"  {line}" for line in status.last], [status.advice])
        return status.ended
    advice = ""
    for status, lines in follow_lines(folder):
        shown = [f"  {line}" for line in lines]
        if not advice or not status.running:
            shown = head_lines(status) + shown
        if status.advice != advice:
            shown.append(status.advice)
        advice = status.advice
        if shown:
            click.echo("\n".join(shown))
        if output_is_lost():
            break
    return status.ended


def _follow_batch(folder: Path, *, as_json: bool) -> str:
    """Follow a batch; return how it ended, empty if it was interrupted."""
    from bench.batch.batch_status import batch_status_text, follow_batch
    from bench.terminal.block import Block

    block, before = Block(), ""
    status: BatchStatus
    for status in follow_batch(folder, ticks=block.can_redraw and not as_json):
        text = batch_status_text(status)
        if as_json:
            click.echo(json.dumps(status.to_dict(), allow_nan=False))
        elif block.can_redraw:
            head, *rest = text.splitlines()
            block.draw([head], [], rest)
        elif text != before:
            known = set(before.splitlines())
            click.echo("\n".join(line for line in text.splitlines() if line not in known))
        before = text
        if output_is_lost():
            break
    return status.ended
