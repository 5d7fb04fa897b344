"""The command `calibrate`: arguments, options and exit statuses; `bench.results` does the work."""

from __future__ import annotations

from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import click

from bench.commands.engine_commands import views_and_options
from bench.commands.options import JSON, OutputFolder


@click.command()
@views_and_options
@click.option("--compare", is_flag=True, help="Compare with OpenCV's planar method and the published recipe.")
@click.option(
    "--output",
    "-o",
    type=OutputFolder(),
    help="New folder for results, report, exports and hashes of the input files; sealed with the bench's key.",
)
@click.option("--no-seal", is_flag=True, help="Leave the folder a DRAFT, without a seal.")
@click.option(
    "--find-again",
    is_flag=True,
    help="Find the stars and calculate, also where an earlier command has kept the result (docs/cluster.md).",
)
@JSON
def calibrate(
    paths: tuple[Path, ...],
    compare: bool,
    output: Path | None,
    no_seal: bool,
    find_again: bool,
    as_json: bool,
    **options: Any,
) -> int:
    """Calibrate without devices, from existing data in one or more PATHs.

    A PATH is a run folder, a RAW file, an image of the target from a frame camera, a file of points (columns x, y,
    X, Y, id), or a folder of such files. A run is calibrated with its own options, passport and gimbal readings, unless
    options are given here.
    """
    from bench.results.kept_answers import KeptAnswers, answer_key

    answers = KeptAnswers.of_bench()
    key = None if output or compare or find_again else answer_key(paths, {**options, "as_json": as_json})
    if key is not None and (known := answers.answer(key)) is not None:
        click.echo(known, nl=False)
        return 0
    text = _calibrated(paths, compare, output, no_seal, find_again, as_json=as_json, **options)
    if key is not None and text:
        answers.keep(key, text)
    for remark in answers.remarks:
        click.echo(remark, err=True)
    return 0


def _calibrated(
    paths: tuple[Path, ...],
    compare: bool,
    output: Path | None,
    no_seal: bool,
    find_again: bool,
    *,
    as_json: bool,
    **options: Any,
) -> str:
    """Calibrate and print; return what was printed, or nothing if a file was left out."""
    from bench.commands.calibration_output import print_calibration
    from bench.commands.keys_output import key_or_draft
    from bench.records.run_folder import REPORT
    from bench.results.offline import calibrate_paths, compare_methods
    from bench.results.offline_options import OfflineOptions
    from bench.views.kept_views import KeptViews

    if output is not None:
        from bench.results.offline_folder import require_new, write_offline_results

        require_new(output)
    key = None if output is None or no_seal else key_or_draft()
    choices = OfflineOptions.from_command_line(**options)
    kept = None if find_again else KeptViews.of_bench()
    result = calibrate_paths(paths, choices, kept)
    for remark in kept.remarks if kept else ():
        click.echo(remark, err=True)
    if output is not None:
        write_offline_results(result, output, key)
    printed = StringIO()
    with redirect_stdout(printed):
        print_calibration(result, compare_methods(result) if compare else None, as_json=as_json)
    click.echo(printed.getvalue(), nl=False)
    if output is not None and not as_json:
        click.echo(f"Report: {output / REPORT}")
    return "" if result.skipped else printed.getvalue()
