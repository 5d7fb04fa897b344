"""The command `calibrate`: without devices, from existing data; all together, or with ``--each`` every run alone."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bench.base.errors import UsageError
from bench.commands.calibration_text import offline_dict, offline_lines
from bench.commands.engine_options import engine_options
from bench.commands.keys import key_or_draft
from bench.commands.options import ExistingPath, OutputFolder, epilog
from bench.commands.output import JSON, show, wants_json
from bench.commands.workers import WORKERS

if TYPE_CHECKING:
    from bench.results.offline_options import OfflineOptions


class _PathOrUrl(ExistingPath):
    """A file or folder that exists, or the URL of a folder."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """See `click.ParamType.convert`."""
        return value if "://" in str(value) else super().convert(value, param, ctx)


@click.command(
    epilog=epilog(
        "starbench calibrate runs/cam7 --model auto --compare",
        "starbench calibrate runs/cam8 --passport collimator.json --views 1",
        "starbench calibrate points/*.csv --image-size 1280x720 --distortion k1k2k3",
        "starbench calibrate runs/ --each --output recalculated --workers 4",
        "starbench calibrate s3://captures/2026 --each --workers tls://cluster.lab:8786 -o recalculated",
    )
)
@click.argument("paths", nargs=-1, required=True, metavar="PATH...", type=_PathOrUrl())
@engine_options
@click.option("--compare", is_flag=True, help="Compare with OpenCV's planar method and the published recipe.")
@click.option(
    "--output",
    "-o",
    type=OutputFolder(),
    help="New folder for results, report, exports and hashes of the input files; sealed with the bench's key. With"
    " --each: one folder of results for each run, and one table of all runs (recalculated.jsonl); after an"
    " interruption, repeat the command with the same folder: it continues.",
)
@click.option("--no-seal", is_flag=True, help="Leave the results a DRAFT, without a seal.")
@click.option(
    "--find-again",
    is_flag=True,
    help="Find the stars (of a board: its points) in every recording again; use none that an earlier command has kept.",
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
    compare: bool,
    output: Path | None,
    no_seal: bool,
    find_again: bool,
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
    from bench.results.offline_options import OfflineOptions

    chosen = OfflineOptions.from_command_line(**options)
    if each:
        if compare:
            raise UsageError("--compare and --each cannot be used together.", remedy="Leave out one of them.")
        from bench.commands.calibrate_each import calibrate_each

        return calibrate_each(
            paths,
            chosen,
            workers,
            output,
            table_only=table_only,
            no_seal=no_seal,
            find_again=find_again,
        )
    if table_only or workers is not None:
        what = "--table-only" if table_only else "--workers"
        raise UsageError(f"{what} needs --each.", remedy=f"Add --each, or leave {what} out.")
    return _calibrate_together(
        [ExistingPath().convert(path, None, None) for path in paths],
        chosen,
        output,
        compare=compare,
        no_seal=no_seal,
        find_again=find_again,
    )


def _calibrate_together(
    paths: list[Path],
    options: OfflineOptions,
    output: Path | None,
    *,
    compare: bool,
    no_seal: bool,
    find_again: bool,
) -> int:
    """Calibrate from all views, write and seal the results where an output folder is given, and print."""
    from bench.records.run_folder import REPORT
    from bench.results.offline import calibrate_paths, compare_methods
    from bench.results.offline_folder import require_new, write_offline_results
    from bench.views.kept_views import KeptViews

    if output is not None:
        require_new(output)
    key = None if output is None or no_seal else key_or_draft()
    kept = None if find_again else KeptViews.of_bench()
    result = calibrate_paths(paths, options, kept)
    for remark in kept.remarks if kept else ():
        click.echo(remark, err=True)
    if output is not None:
        write_offline_results(result, output, key)
    baselines = compare_methods(result) if compare else None
    if not wants_json():
        for line in result.skipped:
            click.echo(f"left out: {line}", err=True)
    show(lambda: offline_dict(result, baselines), offline_lines(result, baselines))
    if output is not None and not wants_json():
        click.echo(f"Report: {output / REPORT}")
    return 0
