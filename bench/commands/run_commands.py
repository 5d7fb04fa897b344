"""Commands about runs, used from another terminal: status, hold, release, abort, skip, answer, runs, messages.

Arguments, options and exit statuses only, like `bench.commands.cli`; other modules do the work.
"""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

import click

from bench.base.errors import UsageError
from bench.commands.options import JSON, RUN, ExistingFolder, RunFolder

_BY = click.option("--operator", "by", metavar="NAME", help="Your name.  [default: user@host]")
_MOMENT = click.DateTime(["%Y-%m-%d", "%Y-%m-%dT%H:%M", "%Y-%m-%d %H:%M", "%Y-%m-%dT%H:%M:%S"])
_MOMENT_FORM = "DATE[THH:MM]"
EVERY_PARAMETER = "all"
"""Stands for `--chart` without a parameter."""
_TAKE_OVER = click.option("--take-over", is_flag=True, help="Do it even if another person holds the run.")


@click.command()
@click.argument("run_folder", metavar="RUN", type=RunFolder(batch=True))
@click.option("--follow", is_flag=True, help="Follow the run until it ends, and return its exit status.")
@JSON
def status(run_folder: Path, follow: bool, as_json: bool) -> int:
    """Show the status of a RUN or a batch. Reads only; can be used at any time, also during the run."""
    from bench.commands.status_output import show_status

    return show_status(run_folder, follow=follow, as_json=as_json)


@click.command()
@RUN
@_BY
@_TAKE_OVER
@JSON
def hold(run_folder: Path, by: str | None, take_over: bool, as_json: bool) -> int:
    """Hold a RUN at its next safe point, with the light off. You hold it until `starbench release`."""
    from bench.commands.run_output import send_command

    return send_command(run_folder, "hold", by=by, take_over=take_over, as_json=as_json)


@click.command()
@RUN
@_BY
@_TAKE_OVER
@JSON
def release(run_folder: Path, by: str | None, take_over: bool, as_json: bool) -> int:
    """Let a held RUN continue."""
    from bench.commands.run_output import send_command

    return send_command(run_folder, "release", by=by, take_over=take_over, as_json=as_json)


@click.command()
@RUN
@_BY
@JSON
def abort(run_folder: Path, by: str | None, as_json: bool) -> int:
    """End a RUN now, safely. Anyone may do this. The run can be resumed."""
    from bench.commands.run_output import send_command

    return send_command(run_folder, "abort", by=by, as_json=as_json)


@click.command()
@RUN
@click.option(
    "--pose", type=click.IntRange(1), metavar="N", help="Number of the pose.  [default: the current one]"
)
@_BY
@_TAKE_OVER
@JSON
def skip(run_folder: Path, pose: int | None, by: str | None, take_over: bool, as_json: bool) -> int:
    """Skip a pose of a RUN. Its recordings are kept, and the report states that the pose was skipped."""
    from bench.commands.run_output import send_command

    return send_command(run_folder, "skip", by=by, pose=pose, take_over=take_over, as_json=as_json)


@click.command()
@RUN
@click.argument("word", type=click.Choice(["yes", "no", "continue", "abort"]))
@_BY
@JSON
def answer(run_folder: Path, word: str, by: str | None, as_json: bool) -> int:
    """Answer a question that a RUN asks: yes (continue) or no (abort)."""
    from bench.commands.run_output import send_command

    choice = {"yes": "continue", "no": "abort"}.get(word, word)
    return send_command(run_folder, "answer", by=by, answer=choice, as_json=as_json)


@click.command()
@click.argument("folder", required=False, type=ExistingFolder())
@click.option("--serial", metavar="NUMBER", help="Only runs of the camera with this serial number.")
@click.option(
    "--since", type=_MOMENT, metavar=_MOMENT_FORM, help="Only runs that began at or after this time (UTC)."
)
@click.option(
    "--until", type=_MOMENT, metavar=_MOMENT_FORM, help="Only runs that began before this time (UTC)."
)
@click.option("--sequence", help="Only runs whose sequence name contains this text.")
@click.option(
    "--how",
    type=click.Choice(["finished", "aborted", "failed", "running", "cut off"]),
    help="Only runs with this outcome or status.",
)
@click.option("--compare", is_flag=True, help="Compare the parameters of the runs that have a result.")
@click.option(
    "--ledger",
    "ledgers",
    multiple=True,
    metavar="FOLDER",
    type=ExistingFolder(),
    help="Read the ledger in this folder, not that of this bench. The folder is the configuration folder of another"
    " bench, or a copy of it. Give the option several times to merge several benches.",
)
@click.option(
    "--export",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Write all runs as a table: .parquet or .csv.",
)
@click.option(
    "--chart",
    is_flag=False,
    flag_value=EVERY_PARAMETER,
    metavar="[PARAMETER]",
    help="Write an HTML page with control charts and drift tests of one parameter, such as fx; without a name, of all"
    " parameters.",
)
@click.option(
    "--by",
    type=click.Choice(["camera", "type"]),
    help="One chart for each camera, or one for each camera type.  [default: both]",
)
@click.option(
    "--baseline",
    type=click.IntRange(2),
    metavar="N",
    help="Calculate the limits of a chart from its first N runs.  [default: from all]",
)
@click.option(
    "--page",
    type=click.Path(path_type=Path),
    metavar="FILE",
    default="runs-charts.html",
    show_default=True,
    help="File for the page with the charts.",
)
@JSON
def runs(
    folder: Path | None,
    serial: str | None,
    since: datetime | None,
    until: datetime | None,
    sequence: str | None,
    how: str | None,
    compare: bool,
    ledgers: tuple[Path, ...],
    export: Path | None,
    chart: str | None,
    by: Literal["camera", "type"] | None,
    baseline: int | None,
    page: Path,
    as_json: bool,
) -> int:
    """List, filter, compare, chart or export the runs in FOLDER; without FOLDER, all runs in the ledger of this bench.

    The command names runs that occur twice, are missing or were changed. Option --ledger merges the runs of several
    benches. A chart never mixes simulated and real runs, different targets, or different models.
    """
    from bench.commands.run_choice import RunChoice

    choice = RunChoice(
        folder,
        ledgers,
        camera=serial,
        since=since.replace(tzinfo=UTC) if since else None,
        until=until.replace(tzinfo=UTC) if until else None,
        sequence=sequence,
        how=how,
    )
    if sum([compare, export is not None, chart is not None]) > 1:
        raise UsageError(
            "--compare, --export and --chart cannot be used together.",
            remedy="Call the command once for each.",
        )
    if export is not None:
        from bench.commands.history_output import export_runs

        return export_runs(choice, export, as_json=as_json)
    if chart is not None:
        from bench.commands.history_output import chart_runs

        if folder is None and Path(chart).is_dir():  # `runs --chart FOLDER`: the folder, not a parameter
            choice, chart = replace(choice, folder=Path(chart)), EVERY_PARAMETER
        parameter = None if chart == EVERY_PARAMETER else chart
        return chart_runs(choice, parameter, by=by, baseline=baseline, page=page, as_json=as_json)
    from bench.commands.run_output import show_runs

    return show_runs(choice, compare=compare, as_json=as_json)


@click.command()
@click.option("--send", "send_now", is_flag=True, help="Try to send the waiting messages now.")
@JSON
def messages(send_now: bool, as_json: bool) -> int:
    """List the messages of this bench: sent ones and waiting ones."""
    from bench.commands.run_output import show_messages

    return show_messages(send_now=send_now, as_json=as_json)


RUN_COMMANDS = (status, hold, release, abort, skip, answer, runs, messages)
