"""The command `runs`: which runs are meant, their list, and the comparison of their parameters."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

import click

from bench.base.errors import JournalBroken, UsageError
from bench.base.home import home_folder
from bench.commands.ledger import ledger_findings
from bench.commands.options import MOMENT, MOMENT_FORM, ExistingFolder, RunChoice, command, status_text
from bench.commands.output import JSON, print_findings, show
from bench.evidence.authorisation import known_authorisations, lost_authorisations
from bench.evidence.states import home_trust, shown_state
from bench.records.ledger import Ledger, bench_ledger
from bench.records.run_facts import REPEATS_TEXT, IndexedRun
from bench.records.run_folder import JOURNAL
from bench.records.run_index import RunIndex, run_folders
from bench.report.text import with_uncertainty
from bench.results.trends import Agreement, compare_runs, repeats
from bench.terminal.encoding import counted

_EVERY_PARAMETER = "all"
"""Stands for `--chart` without a parameter."""


@command(
    "starbench runs --serial 00051234 --since 2026-03-01 --compare",
    "starbench runs runs/night --how failed",
    "starbench runs --chart fx --output fx.html",
    "starbench runs --capability operator,day --since 2026-03-01",
    "starbench runs --output runs.csv",
    status=status_text(
        "0 runs shown, 1 a run is missing or was changed, or the ledger is broken{invalid}{ctrl_c}"
    ),
)
@click.argument("folder", required=False, type=ExistingFolder())
@click.option("--serial", metavar="NUMBER", help="Only runs of the camera with this serial number.")
@click.option(
    "--since", type=MOMENT, metavar=MOMENT_FORM, help="Only runs that began at or after this time (UTC)."
)
@click.option(
    "--until", type=MOMENT, metavar=MOMENT_FORM, help="Only runs that began before this time (UTC)."
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
    "--chart",
    is_flag=False,
    flag_value=_EVERY_PARAMETER,
    metavar="[PARAMETER]",
    help="Write an HTML page with control charts and drift tests of one parameter, such as fx; without a name, of all"
    " parameters.",
)
@click.option(
    "--capability",
    is_flag=False,
    flag_value="operator",
    metavar="[FACTOR,...]",
    help="Gauge study of several cameras: repeatability, and reproducibility by operator, bench or day (several with"
    " commas; default: operator), as %GRR, number of distinct categories and, with limits, Cp and Cpk.",
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
    "--output",
    "-o",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="With --chart: file for the page.  [default: runs-charts.html]  Without: write all runs as a table, .parquet"
    " or .csv.",
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
    chart: str | None,
    capability: str | None,
    by: Literal["camera", "type"] | None,
    baseline: int | None,
    output: Path | None,
) -> int:
    """List, filter, compare, chart or export the runs in FOLDER; without FOLDER, all runs in the ledger of this bench.

    The command names runs that occur twice, are missing or were changed. Option --ledger merges the runs of several
    benches. A chart never mixes simulated and real runs, different targets, or different models.
    """
    filters = {
        "camera": serial,
        "since": since.replace(tzinfo=UTC) if since else None,
        "until": until.replace(tzinfo=UTC) if until else None,
        "sequence": sequence,
        "how": how,
    }
    choice = RunChoice(folder, ledgers, filters)
    if compare and (chart or output):
        raise UsageError(
            "--compare cannot be used with --chart or --output.", remedy="Call the command once for each."
        )
    if capability is not None:
        from bench.commands.runs_capability import show_capability

        if compare or chart or output:
            raise UsageError(
                "--capability cannot be used with --compare, --chart or --output.",
                remedy="Call the command once for each.",
            )
        return show_capability(choice, capability)
    if chart is not None:
        from bench.commands.runs_capability import chart_runs

        if folder is None and Path(chart).is_dir():  # `runs --chart FOLDER`: the folder, not a parameter
            choice, chart = replace(choice, folder=Path(chart)), _EVERY_PARAMETER
        parameter = None if chart == _EVERY_PARAMETER else chart
        return chart_runs(choice, parameter, by, baseline, output or Path("runs-charts.html"))
    if output is not None:
        from bench.commands.runs_capability import export_runs

        return export_runs(choice, output)
    return _show_runs(choice, compare=compare)


def _show_runs(choice: RunChoice, *, compare: bool) -> int:
    """Print a list of runs, or compare their parameters; return 1 if the ledgers and the folders do not agree."""
    if choice.ledgers:
        from bench.commands.runs_capability import find_runs

        merged = find_runs(choice)
        found, faults, notes = merged.runs, merged.faults, merged.notes
    else:
        found, faults, notes = _runs_of_bench(choice)
    findings = {"faults": faults, **({"notes": notes} if notes else {})}
    if compare:
        solved = [run for run in found if run.parameters]
        compared = compare_runs(solved)
        more = {"compared": [one.to_dict() for one in compared], "of": [run.folder for run in solved]}
        show(lambda: {**_runs_dict(found), **more, **findings}, _agreement_lines(solved, compared))
    else:
        show(lambda: {**_runs_dict(found), **findings}, _runs_lines(found))
    return print_findings(faults, notes)


def _runs_of_bench(choice: RunChoice) -> tuple[list[IndexedRun], list[str], list[str]]:
    """Return the runs of this bench, faults, and notes."""
    index, ledger = RunIndex(home_folder()), bench_ledger()
    folders, missing = (run_folders(choice.folder), []) if choice.folder else _ledger_folders(ledger, index)
    found, faults = index.runs(folders, **choice.filters)
    broken, notes = ledger_findings(ledger)
    return found, [*faults, *missing, *broken, *lost_authorisations(known_authorisations(ledger.home))], notes


def _ledger_folders(ledger: Ledger, index: RunIndex) -> tuple[list[Path], list[str]]:
    """Return the ledger's existing run folders, a fault for the others; the index's if the ledger is damaged."""
    try:
        entries = ledger.runs()
    except JournalBroken:
        known = [Path(run.folder) for run in index.entered()]
        return [folder for folder in known if (folder / JOURNAL).is_file()], []
    present = [Path(run.folder) for run in entries if (Path(run.folder) / JOURNAL).is_file()]
    missing = [
        f"run {run.number} ({run.run_id}, {run.how}): its folder {run.folder} is missing"
        for run in entries
        if run.seal is None and not (Path(run.folder) / JOURNAL).is_file()
    ]
    return present, [*ledger.faults(), *missing]


def _runs_dict(runs: Sequence[IndexedRun]) -> dict[str, Any]:
    states = _states(runs)
    rows = [{**run.to_dict(), "state": states[run.folder]} for run in runs]
    return {"schema": "starbench/runs/1", "runs": rows}


def _runs_lines(runs: Sequence[IndexedRun]) -> Iterator[str]:
    if not runs:
        yield "No runs."
        return
    states = _states(runs)
    yield f"{'begun (UTC)':<17} {'camera':<10} {'how':<9} {'poses':>5}  {'rms px':>7}  run"
    for run in runs:
        rms = "" if run.rms_px is None else f"{run.rms_px:.4f}"
        marks = "  REHEARSAL" if run.rehearsal else "  SIMULATED" if run.simulated else ""
        marks += f"  {states[run.folder]}"
        marks += f"  {counted(run.deviations, 'deviation')}" if run.deviations else ""
        begun = run.begun_utc[:16].replace("T", " ")
        yield f"{begun:<17} {run.camera:<10} {run.how:<9} {run.accepted:>5}  {rms:>7}  {run.folder}{marks}"


def _states(runs: Sequence[IndexedRun]) -> dict[str, str]:
    """Return DRAFT, SEALED or AUTHORISED by folder, from the signatures beside each run."""
    trust, now = home_trust(home_folder()), datetime.now(UTC)
    return {run.folder: str(shown_state(Path(run.folder), trust, now).state) for run in runs}


def signed(number: float) -> str:
    """Write a number with its sign and two decimals; zero has no sign."""
    text = f"{number:+.2f}"
    return "0.00" if float(text) == 0 else text


def _agreement_lines(runs: Sequence[IndexedRun], compared: Sequence[Agreement]) -> Iterator[str]:
    head = f"{len(runs)} runs of camera {runs[0].camera}, {runs[0].model} model."
    yield f"{head} ± is the expanded uncertainty U (about 95 %), with the k of the report."
    for parameter in compared:
        mean, expanded = with_uncertainty(parameter.mean, parameter.expanded)
        yield f"{parameter.name}: mean {mean} ± {expanded} (k = {parameter.k:.2f}), Birge ratio {parameter.birge:.2f}"
        if repeats(parameter.birge, len(runs)):
            yield f"  {REPEATS_TEXT}"
        for run, deviation in zip(runs, parameter.deviations, strict=True):
            found = run.parameters[parameter.name]
            value, own = with_uncertainty(found.value, found.expanded)
            begun = run.begun_utc[:16].replace("T", " ")
            yield (
                f"  {begun}  {value:>12} ± {own:<8} (k = {found.k:.2f})  {signed(deviation):>6} sigma  {run.id}"
            )
