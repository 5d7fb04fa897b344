"""The command `recalibrate`: arguments, options and exit statuses; `bench.cluster` does the work."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bench.commands.engine_commands import engine_options
from bench.commands.options import JSON, OutputFolder
from bench.commands.worker_options import open_workers, worker_options

if TYPE_CHECKING:
    from bench.cluster.tasks import Task
    from bench.cluster.work import Workers


@click.command()
@click.argument("folders", nargs=-1, required=True, metavar="FOLDER...")
@engine_options
@worker_options
@click.option(
    "--output",
    "-o",
    type=OutputFolder(),
    help="Output folder: one folder of results for each run, and one table of all runs (recalculated.jsonl). After an"
    " interruption, repeat the command with the same folder: it continues.",
)
@click.option(
    "--table-only",
    is_flag=True,
    help="Write only the table, without results, report and exports of each run. This is much faster.",
)
@click.option("--no-seal", is_flag=True, help="Do not seal the results; they stay DRAFTS.")
@click.option(
    "--find-again",
    is_flag=True,
    help="Find the stars (of a board: its points) in every recording again; use none that an earlier command has kept.",
)
@JSON
def recalibrate(
    folders: tuple[str, ...],
    scheduler: str | None,
    workers: int | None,
    memory: int,
    output: Path | None,
    table_only: bool,
    no_seal: bool,
    find_again: bool,
    as_json: bool,
    **options: Any,
) -> int:
    """Calibrate many runs again, on all processors of this computer or on the workers of a Dask scheduler.

    A FOLDER is a run, a folder of runs, a folder of recordings, or a URL of runs, such as s3://bucket/runs. Each run is
    calibrated as `starbench calibrate` does it, with the same results. If a run fails, the others continue.
    """
    from bench.base.errors import UsageError
    from bench.base.home import home_folder
    from bench.cluster.tasks import Task
    from bench.results.forms import forms
    from bench.results.offline_options import OfflineOptions
    from bench.views.kept_views import FOLDER

    if table_only and output is None:
        raise UsageError("There is no folder for the table.", where="--table-only", remedy="Give one: -o.")
    here = str((home_folder() / FOLDER).absolute())
    kept = "" if find_again else None if scheduler else here
    task = Task(OfflineOptions.from_command_line(**options), forms()["program"], kept)
    who = open_workers(scheduler, workers, memory)
    return _recalibrate(folders, task, who, output, table_only, no_seal, as_json=as_json)


def _recalibrate(
    folders: tuple[str, ...],
    task: Task,
    workers: Workers,
    output: Path | None,
    table_only: bool,
    no_seal: bool,
    *,
    as_json: bool,
) -> int:
    """Do the work, print it, and return the exit status: 0 all done, 1 a run failed."""
    from bench.cluster.places import find_places
    from bench.cluster.recalculation import Recalculation
    from bench.cluster.results_folders import TABLE, ResultsFolders
    from bench.commands.keys_output import key_or_draft
    from bench.commands.output import print_json
    from bench.commands.recalibrate_output import CountedProgress, run_text, sum_text
    from bench.terminal.signals import reliable_interrupts

    progress = CountedProgress(quiet=as_json)

    def say(text: str, *, err: bool = False) -> None:
        progress.clear()
        click.echo(text, err=err)

    def ended(row: Mapping[str, Any]) -> None:
        say(run_text(row), err=as_json)

    with reliable_interrupts(), ExitStack() as stack:
        stack.callback(workers.close)
        places = find_places(folders)
        key = None if output is None or no_seal or table_only else key_or_draft()
        results = None
        if output is not None:
            results = stack.enter_context(ResultsFolders(output, key, table_only=table_only))
        work = Recalculation(
            places,
            task,
            workers,
            results,
            ended=ended,
            progress=progress.counted,
            remark=lambda text: say(text, err=True),
        )
        try:
            rows = work.run()
        except BaseException:
            kept = "These results are kept; the same command continues." if output else "Nothing was written."
            say(f"{sum_text(work.counts)} {kept}", err=True)
            raise
    progress.clear()
    if as_json:
        print_json(
            {"runs": rows, "done": work.counts.done + work.counts.skipped, "failed": work.counts.failed}
        )
    else:
        click.echo(sum_text(work.counts))
        if output is not None:
            click.echo(f"Table: {output / TABLE}")
    return 1 if work.counts.failed else 0
