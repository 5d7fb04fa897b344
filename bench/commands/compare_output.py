"""Runs a comparison, shows its progress, and prints its table."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

import click

from bench.cluster.program import require_program_of
from bench.cluster.work import Workers, results_of
from bench.commands.output import STOPPED, print_json
from bench.compare.page import render_page
from bench.compare.run_comparison import Row, Task, compare, run_task
from bench.compare.scenes import true_camera
from bench.compare.spec import ComparisonConfig
from bench.compare.summary import summarise
from bench.compare.table import table_text
from bench.records.storage import write_atomic
from bench.report.text import duration
from bench.results.forms import forms
from bench.simulated import virtual_camera
from bench.terminal.signals import reliable_interrupts

PAGE, RESULTS = "comparison.html", "results.json"


def run_and_print(
    spec: ComparisonConfig, text: bytes, folder: Path, workers: Workers, *, as_json: bool
) -> int:
    """Run a comparison, write its page and results, and print the table.

    as_json: Whether to print JSON.
    Returns: Exit status: 0 done, 3 stopped by Ctrl-C.
    Raises UsageError, StorageError, BenchError: As `bench.compare.run_comparison.compare`.
    """
    try:
        with reliable_interrupts():
            rows = compare(
                spec, text, folder, do_tasks=partial(_do_tasks, workers), on_progress=_show_progress
            )
    except KeyboardInterrupt:
        click.echo(f"\nStopped. What is done is kept in {folder}; the same command continues.", err=True)
        return STOPPED
    finally:
        workers.close()
    summary = summarise(spec, rows)
    true = true_camera(virtual_camera({}, spec.seed).truth()["camera"]).to_dict()
    write_atomic(folder / PAGE, render_page(summary, rows, true).encode())
    write_atomic(folder / RESULTS, (json.dumps(summary, indent=1, allow_nan=False) + "\n").encode())
    if as_json:
        print_json(summary)
    else:
        click.echo(table_text(summary))
        click.echo(f"Page: {folder / PAGE}")
    return 0


def _do_tasks(workers: Workers, tasks: Sequence[Task]) -> Iterator[dict[str, Row]]:
    """Do the tasks of a comparison by workers, and yield the rows of each."""
    program = forms()["program"]
    for _, rows in results_of(do_task, ((task, program) for task in tasks), workers):
        yield rows


def do_task(task: Task, program: str) -> dict[str, Row]:
    """Do one task of a comparison, on a worker.

    program: Hash of the program that hands out the work.
    Raises BenchError: If this worker runs another program.
    """
    require_program_of(program)
    return run_task(task)


def _show_progress(done: int, total: int, left_s: float | None) -> None:
    """Show how much is done, on one line of a terminal; without a terminal, a line for each tenth."""
    left = f", {duration(left_s)} left" if left_s is not None and done < total else ""
    line = f"{done} of {total} results{left}"
    if sys.stderr.isatty():
        click.echo(f"\r\033[K{line}", err=True, nl=done == total)
    elif done == total or done % max(1, total // 10) == 0:
        click.echo(line, err=True)
