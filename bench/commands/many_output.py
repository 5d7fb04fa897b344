"""Runs the commands whose work many workers share: keeps what is done, shows the progress, and says what remains."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

import click

from bench.commands.live_line import CountLine

if TYPE_CHECKING:
    from bench.cluster.work import Workers
    from bench.results.studies import PlannedStudy
    from calib.studies.monte_carlo import MonteCarloStudy

CONTINUES = "What is done is kept; the same command continues."


def run_study(planned: PlannedStudy, runs: int, workers: Workers, folder: Path | None) -> MonteCarloStudy:
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
