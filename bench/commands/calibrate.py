"""The commands `calibrate`, from runs, recordings, images or points, and `check`, of a calibration by new views."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, nullcontext
from pathlib import Path
from typing import Any

import click

from bench.base.encoding import clock_text
from bench.base.errors import UsageError
from bench.base.home import home_folder
from bench.base.program import forms
from bench.commands.calibrations import (
    engine_options,
    offline_lines,
)
from bench.commands.keys import key_or_draft
from bench.commands.options import ExistingPath, OutputFolder, command
from bench.commands.output import JSON, NOT_KEPT, left_out_lines, print_line, show, wants_json
from bench.commands.workers import WORKERS, LiveLine, open_workers, views_line
from bench.measure.kept_views import FOLDER, KeptViews
from bench.record.coverage import factors_text
from bench.record.storage import new_output
from bench.solve.offline_options import OfflineOptions
from bench.wording.numbers import with_uncertainty
from bench.wording.parameters import unit_text
from bench.wording.target_words import words_for
from bench.work.places import find_places
from bench.work.recalculation import Counts, Recalculation
from bench.work.results_folders import TABLE, ResultsFolders
from bench.work.tasks import DoneRow, RunRow, Task

_SHOWN = ("fx", "cx", "cy", "r")
_ROUNDING_SIGMA = 1e-6  # What other processors' arithmetic changes, in standard uncertainties


def calibrate_each(
    paths: Sequence[Path | str],
    options: OfflineOptions,
    workers: int | str | None,
    output: Path | None,
    *,
    table_only: bool,
) -> int:
    """Calibrate runs, a line each; return 1 if one failed.

    ``output`` is for a table of all, and each run's results unless ``table_only``.
    """
    if table_only and output is None:
        raise UsageError("There is no folder for the table.", where="--table-only", remedy="Give one: -o.")
    kept = None if isinstance(workers, str) else str((home_folder() / FOLDER).absolute())
    task = Task(options, forms()["program"], kept)
    who = open_workers(workers)
    as_json = wants_json()  # other threads, which call below, cannot ask
    progress = LiveLine(quiet=as_json)

    def say(text: str, *, err: bool = False) -> None:
        progress.clear()
        print_line(text, err=err)

    def ended(row: RunRow) -> None:
        say(run_text(row), err=as_json)

    def counted(counts: Counts, left_s: float | None) -> None:
        if progress.due():
            progress.show(_progress_text(counts, left_s))

    with ExitStack() as stack:
        stack.callback(who.close)
        places = find_places([str(place) for place in paths])
        key = None if output is None or table_only else key_or_draft()
        results = None
        if output is not None:
            results = stack.enter_context(ResultsFolders(output, key, table_only=table_only))
        work = Recalculation(
            places,
            task,
            who,
            results,
            ended=ended,
            progress=counted,
            remark=lambda text: say(text, err=True),
        )
        try:
            rows = work.run()
        except BaseException:
            kept = "These results are kept; the same command continues." if output else "Nothing was written."
            say(f"{sum_text(work.counts)} {kept}", err=True)
            raise
    progress.clear()
    done = {"done": work.counts.done + work.counts.skipped, "failed": work.counts.failed}
    show({"runs": rows, **done}, _sum_lines(work.counts, output))
    return 1 if work.counts.failed else 0


def _sum_lines(counts: Counts, output: Path | None) -> Iterator[str]:
    yield sum_text(counts)
    if output is not None:
        yield f"Table: {output / TABLE}"


def run_text(row: RunRow) -> str:
    """Return one line on a run: values with U and k, the largest change from its own results; or why it failed."""
    name = Path(row["folder"].rstrip("/")).name
    if row["state"] != "done":
        failure = row["failure"]
        place = f" ({failure['where']})" if failure["where"] else ""
        return f"{name}: FAILED. {failure['what']}{place} {failure['remedy']}".rstrip()
    if "skipped" in row:
        where = f"; its results are in {row['results']}" if row["results"] else ""
        return f"{name}: was done before{where}."
    shown, factors = [], []
    for parameter in _SHOWN:
        if parameter in row["sigma"]:
            factors.append(row["coverage_factors"].get(parameter) or row["coverage_factor"])
            value, expanded = with_uncertainty(
                row["values"][parameter], factors[-1] * row["sigma"][parameter]
            )
            shown.append(f"{parameter} {value} ± {expanded} {unit_text(parameter)}".rstrip())
    located = f"{row['stars']} {words_for(row['board']).points}"
    parts = [f"{', '.join(shown)} (U with {factors_text(factors)})", f"{row['views']} views, {located}"]
    if row["left_out"]:
        parts.append(f"{len(row['left_out'])} recordings left out")
    if not row["converged"]:
        parts.append("NOT CONVERGED")
    return f"{name}: {'; '.join([*parts, change_text(row)])}."


def change_text(row: DoneRow) -> str:
    """Return the largest change against the run's own results, in the standard uncertainties that it stated."""
    before = row["before"]
    if before is None:
        return "no earlier results to compare"
    changes = {
        name: abs(value - before["values"][name]) / before["sigma"][name]
        for name, value in row["values"].items()
        if before["sigma"].get(name)
    }
    if not changes:
        return "no earlier results to compare"
    name = max(changes, key=lambda name: changes[name])
    if changes[name] < _ROUNDING_SIGMA:
        return "all values as in the run"
    return f"largest change since the run: {name} by {changes[name]:.2g} sigma"


def _progress_text(counts: Counts, left_s: float | None) -> str:
    """Return how far a recalculation is; ``left_s`` is None if unknown."""
    left = "" if left_s is None else f", {clock_text(left_s)} left"
    failed = f", {counts.failed} failed" if counts.failed else ""
    return f"{counts.ended} of {counts.runs} runs{failed}, {counts.recordings} recordings{left}"


def sum_text(counts: Counts) -> str:
    """Return how a recalculation ended."""
    parts = [f"{counts.done} of {counts.runs} runs calibrated"]
    if counts.skipped:
        parts.append(f"{counts.skipped} were done before")
    if counts.failed:
        parts.append(f"{counts.failed} FAILED")
    missing = counts.runs - counts.ended
    if missing:
        parts.append(f"{missing} not done")
    kept = f", {counts.kept} of them with kept views" if counts.kept else ""
    return f"{'; '.join(parts)} ({counts.recordings} recordings{kept})."


class _PathOrUrl(ExistingPath):
    """A file or folder that exists, or the URL of a folder."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """See `click.ParamType.convert`."""
        return value if "://" in str(value) else super().convert(value, param, ctx)


@command(
    "starbench calibrate runs/cam7 --model joint",
    "starbench calibrate runs/cam8 --passport collimator.json --views 1",
    "starbench calibrate points/*.csv --image-size 1280x720 --distortion k1k2k3",
    "starbench calibrate runs/ --each --output recalculated --workers 4",
    "starbench calibrate s3://captures/2026 --each --workers tls://cluster.lab:8786 -o recalculated",
)
@click.argument("paths", nargs=-1, required=True, metavar="PATH...", type=_PathOrUrl())
@engine_options
@click.option(
    "--output",
    "-o",
    type=OutputFolder(),
    help="New folder for results, report, exports and hashes of the input files; sealed with the bench's key. With"
    " --each: one folder of results for each run, and one table of all runs (recalculated.jsonl); after an"
    " interruption, repeat the command with the same folder: it continues.",
)
@click.option("--each", is_flag=True, help="Calibrate each run alone. If a run fails, the others continue.")
@click.option(
    "--table-only",
    is_flag=True,
    help="With --each: write only the table, without results, report and exports of each run. This is much faster.",
)
@WORKERS
@JSON
def calibrate(
    paths: tuple[Path | str, ...],
    output: Path | None,
    each: bool,
    table_only: bool,
    workers: int | str | None,
    **options: Any,
) -> int:
    """Calibrate without devices, from existing data in one or more PATHs.

    A PATH is a run folder, a RAW file, an image of the target from a frame camera, a file of points (columns x, y,
    X, Y, id), or a folder of such files. A run is calibrated with its own options, passport and gimbal readings, unless
    options are given here. All views make one calibration.

    With --each, every run makes a calibration of its own, on all processors of this computer or on the workers of a
    Dask scheduler. A PATH is then a run, a folder of runs, a folder of recordings, or a URL of runs, such as
    s3://bucket/runs.
    """
    chosen = OfflineOptions.from_command_line(**options)
    if each:
        return calibrate_each(paths, chosen, workers, output, table_only=table_only)
    if table_only or workers is not None:
        what = "--table-only" if table_only else "--workers"
        raise UsageError(f"{what} needs --each.", remedy=f"Add --each, or leave {what} out.")
    places = [ExistingPath().convert(path, None, None) for path in paths]
    return _calibrate_together(places, chosen, output)


def _calibrate_together(paths: list[Path], options: OfflineOptions, output: Path | None) -> int:
    """Calibrate from all views, write and seal the results where an output folder is given, and print."""
    from bench.record.run_folder import REPORT
    from bench.solve.offline import calibrate_paths
    from bench.solve.offline_folder import write_offline_results

    kept = KeptViews.of_bench()
    with new_output(output) if output is not None else nullcontext() as part:
        key = None if output is None else key_or_draft()
        with views_line(quiet=wants_json()) as progress:
            result = calibrate_paths(paths, options, kept, progress)
        for remark in kept.remarks:
            print_line(remark, err=True)
        if output is not None and part is not None:
            write_offline_results(result, output.resolve().name, part, key)
    if not wants_json():
        for line in left_out_lines(result.skipped):
            print_line(line, err=True)
    show(result.to_dict, offline_lines(result))
    if output is not None and not wants_json():
        print_line(f"Report: {output / REPORT}")
    return NOT_KEPT if (judged := result.conformity) and not judged.passed else 0
