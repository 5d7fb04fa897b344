"""The command `calibrate`: arguments, options and exit statuses; `bench.results` does the work."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bench.commands.engine_commands import views_and_options
from bench.commands.options import JSON, OutputFolder

if TYPE_CHECKING:
    from bench.results.kept_answers import KeptAnswers
    from bench.results.offline import OfflineResult

MOST_RUN_BYTES = 1 << 30
"""Largest run about which an answer is kept at its end: all files are read again, at some 0.5 GB a second."""


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
    help="Do all work again; use nothing that an earlier command has kept (docs/cluster.md).",
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
    key = None if output or compare or find_again else answer_key(paths, options)
    if key is not None and (known := answers.answer(key, as_json=as_json)) is not None:
        click.echo(known, nl=False)
        return 0
    result = _calibrated(paths, compare, output, no_seal, find_again, as_json=as_json, **options)
    if key is not None:
        _keep(answers, key, result)
    for remark in answers.remarks:
        click.echo(remark, err=True)
    return 0


def keep_answer_of_run(folder: Path) -> None:
    """Keep what `calibrate` will print about a finished run, as text and as JSON, while the engine is loaded.

    folder: Folder of the sealed run. Of a run of more than `MOST_RUN_BYTES` nothing is kept.
    """
    from bench.base.errors import BenchError
    from bench.results.kept_answers import KeptAnswers, answer_key
    from calib.errors import CalibrationError

    options = dict(calibrate.make_context("calibrate", [str(folder)]).params)
    for name in ("paths", "compare", "output", "no_seal", "find_again", "as_json"):
        del options[name]
    try:
        if sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()) > MOST_RUN_BYTES:
            return
        result = _calculated((folder,), find_again=False, options=options)
    except (BenchError, CalibrationError, OSError):
        return  # `calibrate` says the same, to somebody who asks
    if (key := answer_key((folder,), options)) is not None:
        _keep(KeptAnswers.of_bench(), key, result)


def _keep(answers: KeptAnswers, key: str, result: OfflineResult) -> None:
    """Keep both forms of an answer, unless a file was left out: the reason is printed elsewhere."""
    if not result.skipped:
        text, as_json = (_printed(result, compare=False, as_json=form) for form in (False, True))
        answers.keep(key, text, as_json)


def _calibrated(
    paths: tuple[Path, ...],
    compare: bool,
    output: Path | None,
    no_seal: bool,
    find_again: bool,
    *,
    as_json: bool,
    **options: Any,
) -> OfflineResult:
    """Calibrate, write and seal the results where an output folder is given, and print."""
    from bench.commands.keys_output import key_or_draft
    from bench.records.run_folder import REPORT

    if output is not None:
        from bench.results.offline_folder import require_new, write_offline_results

        require_new(output)
    key = None if output is None or no_seal else key_or_draft()
    result = _calculated(paths, find_again=find_again, options=options)
    if output is not None:
        write_offline_results(result, output, key)
    click.echo(_printed(result, compare=compare, as_json=as_json), nl=False)
    if output is not None and not as_json:
        click.echo(f"Report: {output / REPORT}")
    return result


def _calculated(paths: tuple[Path, ...], *, find_again: bool, options: Mapping[str, Any]) -> OfflineResult:
    """Calibrate, with the views that earlier commands have kept."""
    from bench.results.offline import calibrate_paths
    from bench.results.offline_options import OfflineOptions
    from bench.views.kept_views import KeptViews

    kept = None if find_again else KeptViews.of_bench()
    result = calibrate_paths(paths, OfflineOptions.from_command_line(**options), kept)
    for remark in kept.remarks if kept else ():
        click.echo(remark, err=True)
    return result


def _printed(result: OfflineResult, *, compare: bool, as_json: bool) -> str:
    """Return a calibration as it is printed."""
    from bench.commands.calibration_output import print_calibration
    from bench.results.offline import compare_methods

    printed = StringIO()
    with redirect_stdout(printed):
        print_calibration(result, compare_methods(result) if compare else None, as_json=as_json)
    return printed.getvalue()
