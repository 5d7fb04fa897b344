"""The commands `batch` and `rehearse`: a queue is done or rehearsed, and how it ended is printed."""

from __future__ import annotations

import sys
import time
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

import click

from bench.base.clock import BenchClock, stop_on_signals
from bench.base.errors import UsageError
from bench.base.home import home_folder
from bench.commands.options import BEGIN, QUEUE_STATUS, ExistingFile, OutputFolder, command
from bench.commands.output import JSON, NOT_KEPT, STOPPED, show, wants_json
from bench.commands.values import WholeNumber
from bench.commands.workers import PartsLine
from bench.evidence.keys import usable_key

if TYPE_CHECKING:
    from bench.record.summaries import BatchSummary

_QUEUE = click.argument("queue", metavar="QUEUE", type=ExistingFile())


@command(
    "starbench batch night.yaml --output runs/night",
    "starbench status runs/night --follow",
    "starbench tell runs/night withdraw glass",
    status=QUEUE_STATUS,
)
@_QUEUE
@click.option(
    "--output",
    "-o",
    required=True,
    type=OutputFolder(),
    help="Folder of the batch. If the batch has begun there, it continues.",
)
@JSON
def batch(queue: Path, output: Path) -> int:
    """Do the runs of a QUEUE file one after another, each under supervision.

    Called again with the same folder, it continues where it was interrupted.

    While it runs: `starbench status FOLDER`, `starbench tell FOLDER add JOB`, `starbench tell FOLDER withdraw NAME`.
    """
    if sys.platform != "linux":
        raise UsageError(
            "A batch can be done only on Linux, because its supervision of runs needs Linux.",
            where=str(queue),
            remedy="Do its runs one by one with `starbench run`. `plan` and `rehearse` accept the queue here too.",
        )
    from bench.batch.batch import Batch
    from bench.batch.batch_plan import read_queue

    clock = BenchClock()
    usable_key(home_folder(), clock.utc_now())  # one that processes without a terminal can use
    work = Batch(output, read_queue(queue), clock, lambda line: click.echo(line, err=True))
    with stop_on_signals(clock.request_stop):
        summary = work.run()
    return show_summary(output, summary)


@command(
    "starbench rehearse night.yaml --output runs/rehearsed --begin 2026-03-01T21:00", status=QUEUE_STATUS
)
@_QUEUE
@click.option("--output", "-o", required=True, type=OutputFolder(), help="New folder for the rehearsal.")
@BEGIN
@click.option(
    "--seed",
    type=WholeNumber(0, 2**62),
    metavar="N",
    default=1,
    show_default=True,
    help="Random seed of the rehearsed devices.",
)
@JSON
def rehearse(queue: Path, output: Path, begin: datetime | None, seed: int) -> int:
    """Rehearse the night of a QUEUE file on a virtual clock, without devices and without waiting.

    The journals and the summary have the same form as those of a real night.
    """
    from bench.batch.batch_plan import read_queue
    from bench.batch.batch_rehearsal import rehearse_batch
    from bench.commands.plan import begin_utc
    from bench.wording.numbers import duration

    read, started_s = read_queue(queue), time.monotonic()
    line = PartsLine("runs rehearsed", "the summary is written", quiet=wants_json())

    def say(text: str) -> None:
        line.clear()
        click.echo(text, err=True)

    try:
        summary = rehearse_batch(
            read, output, begin=begin_utc(read.value, begin), seed=seed, say=say, progress=line.reached
        )
    finally:
        line.clear()
    status = show_summary(output, summary)
    took_s = time.monotonic() - started_s
    whole = duration(3600 * summary["totals"]["hours"])
    click.echo(f"{whole} rehearsed in {took_s:.0f} s.", err=True)
    return status


def show_summary(folder: Path, summary: BatchSummary) -> int:
    """Print a batch's end; exit status 0 every run has a result, 3 stopped, 4 a limit is not kept, else 1."""
    from bench.batch.batch_summary import PAGE, summary_lines

    show(summary, [*summary_lines(summary, folder), f"Summary: {folder / PAGE}"])
    if summary["how"] == "finished" and any(item["conformity"] == "FAIL" for item in summary["items"]):
        return NOT_KEPT
    return {"finished": 0, "aborted": STOPPED}.get(summary["how"], 1)
