"""The command `status`: a run or a batch, once or followed; one block that stays on a terminal, lines elsewhere."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from bench.commands.options import RunFolder, epilog, status_text
from bench.commands.output import JSON, STOPPED, show, wants_json
from bench.terminal.closed_output import output_is_lost

if TYPE_CHECKING:
    from bench.batch.batch_status import BatchStatus
    from bench.run.status import Status

_INTERRUPTED = 130
_NOT_READ = 128 + 13
"""Exit status of `status --follow` whose output nobody reads any more: that of SIGPIPE."""
_ENDED = {"finished": 0, "aborted": STOPPED}


@click.command(
    epilog=epilog(
        "starbench status runs/cam7 --follow",
        "starbench status runs/night",
        status=status_text(
            "0 status shown{invalid}{ctrl_c} With --follow that of the run: 0 done, 1 failed, 3 stopped."
        ),
    )
)
@click.argument("run_folder", metavar="RUN", type=RunFolder(batch=True))
@click.option("--follow", is_flag=True, help="Follow the run until it ends, and return its exit status.")
@click.option("--summary", is_flag=True, help="Of a batch: write its summary page now, and show it.")
@JSON
def status(run_folder: Path, follow: bool, summary: bool) -> int:
    """Show the status of a RUN or a batch. Can be used at any time, also during the run, and changes nothing in it."""
    from bench.records.run_index import is_batch

    of_batch = is_batch(run_folder)
    if summary:
        return _summarise(run_folder)
    if not follow:
        return _show_batch(run_folder) if of_batch else _show_run(run_folder)
    try:
        ended = (_follow_batch if of_batch else _follow_run)(run_folder)
    except KeyboardInterrupt:
        noun = "batch" if of_batch else "run"
        click.echo(f"\nNo longer following. The {noun} is not affected.", err=True)
        return _INTERRUPTED
    return _NOT_READ if output_is_lost() else _ENDED.get(ended, 1)


def _summarise(folder: Path) -> int:
    """Write and print the current summary of a batch."""
    from bench.batch.batch_summary import read_batch, write_summary
    from bench.commands.batch import show_summary

    return show_summary(folder, write_summary(folder, read_batch(folder)))


def _show_run(folder: Path) -> int:
    from bench.run.status import read_status
    from bench.run.status_text import status_text as text_of

    found = read_status(folder)
    show(found.to_dict, text_of(found))
    return 0


def _show_batch(folder: Path) -> int:
    from bench.batch.batch_status import batch_status_text, read_batch_status

    found = read_batch_status(folder)
    show(found.to_dict, batch_status_text(found))
    return 0


def _follow_run(folder: Path) -> str:
    """Follow a run; return how it ended, empty if it was interrupted."""
    from bench.run.follow_status import follow, follow_lines
    from bench.run.status_text import head_lines
    from bench.terminal.block import Block

    now: Status
    if wants_json():
        for now in follow(folder):
            click.echo(json.dumps(now.to_dict(), allow_nan=False))
            if output_is_lost():
                break
        return now.ended
    block = Block()
    if block.can_redraw:
        for now in follow(folder, ticks=True):
            block.draw(head_lines(now), [f"  {line}" for line in now.last], [now.advice])
        return now.ended
    advice = ""
    for now, lines in follow_lines(folder):
        shown = [f"  {line}" for line in lines]
        if not advice or not now.running:
            shown = head_lines(now) + shown
        if now.advice != advice:
            shown.append(now.advice)
        advice = now.advice
        if shown:
            click.echo("\n".join(shown))
        if output_is_lost():
            break
    return now.ended


def _follow_batch(folder: Path) -> str:
    """Follow a batch; return how it ended, empty if it was interrupted."""
    from bench.batch.batch_status import batch_status_text, follow_batch
    from bench.terminal.block import Block

    block, before, as_json = Block(), "", wants_json()
    now: BatchStatus
    for now in follow_batch(folder, ticks=block.can_redraw and not as_json):
        text = batch_status_text(now)
        if as_json:
            click.echo(json.dumps(now.to_dict(), allow_nan=False))
        elif block.can_redraw:
            head, *rest = text.splitlines()
            block.draw([head], [], rest)
        elif text != before:
            known = set(before.splitlines())
            click.echo("\n".join(line for line in text.splitlines() if line not in known))
        before = text
        if output_is_lost():
            break
    return now.ended
