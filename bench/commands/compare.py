"""The command `compare`: methods of calibration on the simulated bench. `bench.compare` does the work."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from bench.commands.options import epilog
from bench.commands.output import JSON, STOPPED, show
from bench.commands.workers import WORKERS, open_workers

if TYPE_CHECKING:
    from bench.cluster.work import Workers
    from bench.compare.run_comparison import Row, Task
    from bench.compare.spec import ComparisonConfig

PAGE, RESULTS = "comparison.html", "results.json"


@click.command(
    epilog=epilog(
        "starbench compare table1 --repetitions 3", "starbench compare my_comparison.yaml -o comparisons/mine"
    )
)
@click.argument("spec")
@click.option(
    "--output",
    "-o",
    type=click.Path(path_type=Path, file_okay=False),
    help="Folder of the comparison. An interrupted one continues with the same folder.  [default: comparisons/NAME]",
)
@click.option(
    "--repetitions", type=click.IntRange(1, 1000), metavar="N", help="In place of that of the SPEC."
)
@click.option("--seed", type=click.IntRange(0, 2**31 - 1), metavar="N", help="In place of that of the SPEC.")
@WORKERS
@JSON
def compare(
    spec: str,
    output: Path | None,
    repetitions: int | None,
    seed: int | None,
    workers: int | str | None,
) -> int:
    """Compare calibration methods on the simulated bench, where the truth is known.

    SPEC is a YAML file, or the name of an included specification: table1 (the paper's Table 1 again) or sweep (number
    of images, collimators, noise). Each repetition records new event images of a star target or a board, and every
    method gets the same images. What is done is kept: after Ctrl-C, the same command continues.
    """
    from bench.compare.spec import read_spec

    read = read_spec(spec)
    given = {"repetitions": repetitions, "seed": seed}
    changed = read.value.model_copy(
        update={name: value for name, value in given.items() if value is not None}
    )
    folder = output or Path("comparisons") / Path(spec).stem
    return _run(changed, read.text, folder, open_workers(workers))


def _run(spec: ComparisonConfig, text: bytes, folder: Path, workers: Workers) -> int:
    """Run a comparison, write its page and results, and print the table; return 3 if Ctrl-C stopped it."""
    from bench.compare.page import render_page
    from bench.compare.run_comparison import compare as run_all
    from bench.compare.scenes import true_camera
    from bench.compare.summary import summarise
    from bench.compare.table import table_text
    from bench.records.storage import write_atomic
    from bench.simulated import virtual_camera
    from bench.terminal.signals import reliable_interrupts

    try:
        with reliable_interrupts():
            rows = run_all(
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
    show(summary, f"{table_text(summary)}\nPage: {folder / PAGE}")
    return 0


def _do_tasks(workers: Workers, tasks: Sequence[Task]) -> Iterator[dict[str, Row]]:
    """Do the tasks of a comparison by workers, and yield the rows of each."""
    from bench.cluster.work import results_of
    from bench.results.forms import forms

    program = forms()["program"]
    for _, rows in results_of(do_task, ((task, program) for task in tasks), workers):
        yield rows


def do_task(task: Task, program: str) -> dict[str, Row]:
    """Do one task of a comparison, on a worker.

    program: Hash of the program that hands out the work.
    Raises BenchError: If this worker runs another program.
    """
    from bench.cluster.program import require_program_of
    from bench.compare.run_comparison import run_task

    require_program_of(program)
    return run_task(task)


def _show_progress(done: int, total: int, left_s: float | None) -> None:
    """Show how much is done, on one line of a terminal; without a terminal, a line for each tenth."""
    from bench.report.text import duration

    left = f", {duration(left_s)} left" if left_s is not None and done < total else ""
    line = f"{done} of {total} results{left}"
    if sys.stderr.isatty():
        click.echo(f"\r\033[K{line}", err=True, nl=done == total)
    elif done == total or done % max(1, total // 10) == 0:
        click.echo(line, err=True)
