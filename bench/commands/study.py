"""The commands `study` and `compare`: many simulated calibrations, by one method or by several."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bench.base.clock import reliable_interrupts
from bench.base.home import forms
from bench.cluster.work import Workers, require_program_of, results_of
from bench.commands.calibrations import LOSS_HELP, LOSSES, MODEL_HELP, MODELS
from bench.commands.options import (
    SEED,
    SEQUENCE_NAME,
    STATION_NAME,
    NewFile,
    Number,
    OutputFolder,
    command,
    status_text,
)
from bench.commands.output import JSON, STOPPED, show
from bench.commands.workers import WORKERS, CountLine, kept_work, open_workers
from bench.records.storage import write_atomic

if TYPE_CHECKING:
    from bench.cluster.recalculation import PlannedStudy
    from bench.compare.methods import Row
    from bench.compare.run_comparison import Task
    from bench.compare.spec import ComparisonConfig
    from calib.calibration import CalibrationOptions
    from calib.studies.monte_carlo import MonteCarloStudy


PAGE, RESULTS = "comparison.html", "results.json"


@command(
    "starbench compare table1 --repetitions 3",
    "starbench compare my_comparison.yaml -o comparisons/mine",
    status=status_text("0 done, 1 failed{invalid}, 3 stopped by Ctrl-C: the same command continues."),
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
    from bench.compare.table import summarise, table_text
    from bench.simulated import virtual_camera

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
    program = forms()["program"]
    for _, rows in results_of(do_task, ((task, program) for task in tasks), workers):
        yield rows


def do_task(task: Task, program: str) -> dict[str, Row]:
    """Do one task of a comparison, on a worker."""
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


@command(
    "starbench study nine_pose --runs 500 --plot errors.svg",
    "starbench study nine_pose --runs 100000 --workers tls://cluster.lab:8786 -o study",
)
@click.argument("sequence", default="three_pose", type=SEQUENCE_NAME)
@click.option(
    "--station",
    "-s",
    default="simulated",
    type=STATION_NAME,
    show_default=True,
    help="Station file with an `expected` section, or the name of a station that is included.",
)
@click.option(
    "--runs",
    type=click.IntRange(2, 100_000),
    metavar="N",
    default=200,
    show_default=True,
    help="Number of calibrations. Each takes 1 to 2 s of a processor, with --model spherical 0.1 s.",
)
@click.option(
    "--seed", type=SEED, metavar="N", default=1, show_default=True, help="Random seed of the noise."
)
@click.option(
    "--noise-px",
    type=Number(least=0, above=True),
    metavar="PX",
    help="Standard deviation of a star position, px.  [default: the station's expected value]",
)
@click.option(
    "--drift-mm",
    type=Number(least=0),
    metavar="MM",
    default=0.0,
    show_default=True,
    help="Standard deviation of each view's collimator centre about the common centre, mm.",
)
@click.option(
    "--outliers",
    type=Number(least=0, most=1),
    metavar="SHARE",
    default=0.0,
    show_default=True,
    help="Share of stars with gross errors, 0 to 1.",
)
@click.option("--model", type=click.Choice(MODELS), default="joint", show_default=True, help=MODEL_HELP)
@click.option("--loss", type=click.Choice(LOSSES), help=f"{LOSS_HELP}  [default: huber]")
@click.option("--plot", type=NewFile(), help="Plot the errors, in units of their sigma, to an SVG file.")
@WORKERS
@click.option(
    "--output",
    "-o",
    type=OutputFolder(),
    help="Folder that keeps what is done. After an interruption, repeat the command with the same folder: it "
    "continues.",
)
@JSON
def study(
    sequence: str,
    station: str,
    plot: Path | None,
    output: Path | None,
    workers: int | str | None,
    runs: int,
    **options: Any,
) -> int:
    """Calibrate a simulated camera many times, and check whether the stated uncertainties hold.

    Noise, drift and outliers are drawn. U of the joint adjustment also covers faults of the bench, which are not drawn;
    U of the spherical model covers noise alone.
    The work is done on all processors of this computer or on the workers of a Dask scheduler, with the same result.
    """
    from bench.cluster.recalculation import BLOCK, plan_study, write_study_plot
    from calib.calibration import CalibrationOptions

    planned = plan_study(sequence, station, **options)
    who = open_workers(workers, most=-(-runs // BLOCK))
    studied = _run_study(planned, runs, who, output)
    if plot is not None:
        write_study_plot(studied, plot)
    low, high = studied.coverage_band
    held = all(low <= share for share in studied.coverage.values())
    show(
        lambda: {
            "runs": len(studied.values),
            "failed": list(studied.failed),
            "held": held,
            "band": [low, high],
            "scatter": studied.scatter,
            "z_rms": studied.z_rms,
            "coverage": studied.coverage,
        },
        _lines(studied, CalibrationOptions(options["model"], loss=options["loss"]), held=held),
    )
    return 0


def _run_study(planned: PlannedStudy, runs: int, workers: Workers, folder: Path | None) -> MonteCarloStudy:
    """Run a study, with its progress; ``folder`` keeps what is done, None keeps nothing."""
    from bench.cluster.recalculation import STUDY, run_blocks

    line = CountLine(runs, "calibrations")
    with kept_work(workers, folder, STUDY, line, "done") as kept:
        return run_blocks(planned, runs, workers, kept, line.count)


def _lines(study: MonteCarloStudy, options: CalibrationOptions, *, held: bool) -> Iterator[str]:
    low, high = study.coverage_band
    yield f"{len(study.values)} calibrations, model {options.model}, {len(study.failed)} failed."
    if options.unused:
        yield f"Note: {options.unused}"
    width = max(map(len, study.names))
    for name, stated in zip(study.names, study.sigmas.mean(axis=0).tolist(), strict=True):
        yield (
            f"  {name:<{width}} error {study.scatter[name]:>9.4g} rms, stated {stated:>9.4g},"
            f" ratio {study.z_rms[name]:.2f}; within U {study.coverage[name]:.1%}"
        )
    verdict = "no contradiction to the stated uncertainties found"
    if not held:
        verdict = "THE STATED UNCERTAINTIES DO NOT HOLD"
    elif max(study.coverage.values()) > high:
        verdict = "the stated uncertainties hold; some are larger than what was drawn explains"
    yield f"A correct U (k = 2, or more) covers the error in {low:.1%} to {high:.1%} of calibrations: {verdict}."
