"""The command `study`: many simulated calibrations show whether the stated uncertainties hold."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bench.commands.engine_options import LOSS_HELP, LOSSES, MODEL_HELP, MODELS
from bench.commands.options import SEED, SEQUENCE_NAME, STATION_NAME, NewFile, Number, OutputFolder, epilog
from bench.commands.output import JSON, show
from bench.commands.workers import CONTINUES, WORKERS, CountLine, open_workers

if TYPE_CHECKING:
    from bench.cluster.work import Workers
    from bench.results.studies import PlannedStudy
    from calib.studies.monte_carlo import MonteCarloStudy


@click.command(
    epilog=epilog(
        "starbench study nine_pose --runs 500 --plot errors.svg",
        "starbench study nine_pose --runs 100000 --workers tls://cluster.lab:8786 -o study",
    )
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
    help="Number of calibrations.",
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
@click.option("--model", type=click.Choice(MODELS), default="spherical", show_default=True, help=MODEL_HELP)
@click.option("--loss", type=click.Choice(LOSSES), default="huber", show_default=True, help=LOSS_HELP)
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

    The work is done on all processors of this computer or on the workers of a Dask scheduler, with the same result.
    """
    from bench.cluster.many_calibrations import BLOCK
    from bench.results.studies import plan_study, write_study_plot

    planned = plan_study(sequence, station, **options)
    who = open_workers(workers, most=-(-runs // BLOCK))
    studied = _run_study(planned, runs, who, output)
    if plot is not None:
        write_study_plot(studied, plot)
    low, high = studied.coverage_band
    held = all(low <= share <= high for share in studied.coverage.values())
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
        _lines(studied, held=held),
    )
    return 0


def _run_study(planned: PlannedStudy, runs: int, workers: Workers, folder: Path | None) -> MonteCarloStudy:
    """Run a study, with its progress.

    folder: Folder that keeps what is done; None to keep nothing.
    Raises BenchError, calib.errors.CalibrationError: As `bench.cluster.many_calibrations.run_blocks`.
    """
    from bench.cluster.kept_rows import KeptRows
    from bench.cluster.many_calibrations import STUDY, run_blocks
    from bench.terminal.signals import reliable_interrupts

    line = CountLine(runs, "calibrations")
    with reliable_interrupts(), ExitStack() as stack:
        stack.callback(workers.close)
        kept = stack.enter_context(KeptRows(folder, STUDY)) if folder is not None else None
        try:
            return run_blocks(planned, runs, workers, kept, line.count)
        except BaseException:
            line.clear()
            click.echo(
                f"{line.text()} done. {CONTINUES if folder else 'Nothing is kept: give -o.'}", err=True
            )
            raise
        finally:
            line.clear()


def _lines(study: MonteCarloStudy, *, held: bool) -> Iterator[str]:
    low, high = study.coverage_band
    yield f"{len(study.values)} calibrations, {len(study.failed)} failed."
    for at, name in enumerate(study.names):
        yield (
            f"  {name:<3} error {study.scatter[name]:>9.4g} rms, stated {float(study.sigmas[:, at].mean()):>9.4g},"
            f" ratio {study.z_rms[name]:.2f}; within U {study.coverage[name]:.1%}"
        )
    verdict = (
        "no contradiction to the stated uncertainties found"
        if held
        else "THE STATED UNCERTAINTIES DO NOT HOLD"
    )
    yield f"A correct U (k = 2, or more) covers the error in {low:.1%} to {high:.1%} of calibrations: {verdict}."
