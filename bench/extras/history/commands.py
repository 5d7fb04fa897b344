"""The command `history`: control charts, agreement and table of many runs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import click

from bench.base.encoding import counted
from bench.base.errors import UsageError
from bench.base.home import home_folder
from bench.charts.chart_findings import find_charts, needs_attention
from bench.charts.chart_groups import group_runs
from bench.commands.options import AnyPath, RunChoice, command, run_options, status_text
from bench.commands.output import JSON, print_findings, show
from bench.commands.runs import find_runs
from bench.commands.values import WholeNumber
from bench.evidence.authorisations import known_authorisations
from bench.evidence.merged_runs import MergedRuns
from bench.evidence.states import home_trust, shown_state
from bench.extras.history.columns import SCHEMA, Row, table_row
from bench.extras.history.table import require_ending, require_writable_table, write_table
from bench.record.coverage import REPEATS_TEXT
from bench.record.run_facts import IndexedRun
from bench.record.run_index import RunIndex
from bench.record.storage import write_atomic
from bench.record.summaries import AgreedData, ChartGroupData, drifts, has_limits
from bench.report.control_chart import render_charts
from bench.solve.agreement import compare_runs
from bench.wording.numbers import plus_minus, with_uncertainty

_MOST_GROUPS = 12
"""Most groups of one kind that the terminal describes, a screen; it counts the others."""


_CHARTS, _AGREEMENT, _TABLE = "charts", "agreement", "table"


@command(
    "starbench history charts --baseline 30",
    "starbench history agreement --serial 00051234",
    "starbench history table -o runs.parquet",
    status=status_text(
        "0 nothing is out of control and nothing drifts, 1 something is or does, a run is missing or was changed, or a "
        "ledger is broken{invalid}{ctrl_c}"
    ),
)
@click.argument("what", type=click.Choice([_CHARTS, _AGREEMENT, _TABLE]))
@run_options
@click.option(
    "--baseline",
    type=WholeNumber(2),
    metavar="N",
    help="charts: calculate the limits from the first N runs.  [default: from all]",
)
@click.option(
    "--output",
    "-o",
    type=AnyPath(),
    metavar="FILE",
    help="charts: file for the page [default: runs-charts.html]. table: a new .parquet or .csv file.",
)
@JSON
def history(what: str, baseline: int | None, output: Path | None, **given: Any) -> int:
    """Show what many runs tell together: those in FOLDER, or all runs in the ledger of this bench.

    charts: an HTML page with control charts and drift tests. agreement: whether the results of one camera agree within
    their uncertainties. table: all runs as a table. Simulated and real runs, different targets and different models are
    never mixed.
    """
    if baseline is not None and what != _CHARTS:
        raise UsageError(
            f"`history {what}` has no --baseline.", remedy="Leave it out; `history charts` has it."
        )
    choice = RunChoice.of(given)
    if output is not None and what == _AGREEMENT:
        raise UsageError(f"`history {what}` writes no file.", remedy="Leave out --output.")
    if what == _CHARTS:
        return _chart_runs(choice, baseline, output or Path("runs-charts.html"))
    if what == _TABLE:
        if output is None:
            raise UsageError("The file is missing.", remedy="Name it: --output runs.parquet, or .csv.")
        return _export_runs(choice, output)
    return _show_agreement(find_runs(choice))


def _show_agreement(merged: MergedRuns) -> int:
    """Print how the parameters of runs agree; return 1 if ledgers and folders do not agree."""
    solved = [run for run in merged.runs if run.parameters]
    compared = compare_runs(solved)
    show(
        lambda: {
            "schema": "starbench/agreement/1",
            "compared": compared,
            "of": [run.folder for run in solved],
            "faults": merged.faults,
            "notes": merged.notes,
        },
        _agreement_lines(solved, compared),
    )
    return print_findings(merged.faults, merged.notes)


def _export_runs(choice: RunChoice, path: Path) -> int:
    """Write the table of runs, and say so; return 1 if ledgers and folders do not agree, else 0."""
    require_writable_table(path)
    merged = find_runs(choice)
    count = write_table(path, _rows(merged), merged.faults)
    facts: dict[str, Any] = {"schema": "starbench/runs-export/1", "table": SCHEMA, "file": str(path)}
    show(
        {**facts, "rows": count, "faults": merged.faults, "notes": merged.notes},
        [f"{path}: {counted(count, 'run')}, schema {SCHEMA}."],
    )
    return print_findings(merged.faults, merged.notes)


def _rows(merged: MergedRuns) -> Iterator[Row]:
    trust, now = home_trust(home_folder()), datetime.now(UTC)
    known = known_authorisations(home_folder())
    for run, more in RunIndex(home_folder()).details(merged.runs):
        state = shown_state(Path(run.folder), trust, now, known)
        yield table_row(run, more, merged.places[run.folder], state)


def _chart_runs(choice: RunChoice, baseline: int | None, page: Path) -> int:
    """Write the page of control charts, and print the verdict. The first ``baseline`` runs set the limits; None: all.

    Exit status: 1 out of control, a drift, or ledgers and folders that differ; else 0.
    """
    require_ending(page, (".html", ".htm"))
    if not page.absolute().parent.is_dir():
        what = "The folder of this file does not exist."
        raise UsageError(what, where=str(page), remedy="Choose another name.")
    merged = find_runs(choice)
    facts = RunIndex(home_folder()).details(merged.runs)
    grouped = group_runs(((run, more, merged.places[run.folder]) for run, more in facts))
    if not grouped.groups:
        why = " ".join(grouped.left_out)
        raise UsageError(
            f"There is no run with a result. {why}".rstrip(),
            remedy="Name a FOLDER with runs, or a ledger with --ledger.",
        )
    charts = find_charts(grouped.groups, baseline=baseline)
    notes = [*grouped.left_out, *merged.notes]
    write_atomic(page, render_charts(charts, notes, merged.faults).encode())
    show(
        lambda: {
            "schema": charts["schema"],
            "page": str(page),
            "groups": [_told(group) for group in charts["groups"]],
            "faults": merged.faults,
            "notes": notes,
        },
        [*_verdict(charts["groups"]), f"Charts: {page}"],
    )
    status = print_findings(merged.faults, notes)
    return status or int(any(map(needs_attention, charts["groups"])))


def _verdict(groups: Sequence[ChartGroupData]) -> list[str]:
    """Return the verdict: the groups that need attention first; of very many others, only their number."""
    wrong = [group for group in groups if needs_attention(group)]
    rest = [group for group in groups if not needs_attention(group)]
    lines = [line for group in wrong[:_MOST_GROUPS] for line in _verdict_lines(group)]
    if len(wrong) > _MOST_GROUPS:
        lines.append(
            f"{len(wrong) - _MOST_GROUPS} further groups of runs need attention; the page shows each of them."
        )
    if len(rest) <= _MOST_GROUPS:
        lines += [line for group in rest for line in _verdict_lines(group)]
    else:
        lines.append(f"{len(rest)} other groups of runs need no attention; the page shows each of them.")
    if len(groups) > 1:
        lines.append(f"{len(wrong)} of {len(groups)} groups of runs need attention.")
    return lines


def _verdict_lines(group: ChartGroupData) -> list[str]:
    """Return the verdict about a group, and a line for each parameter that needs attention."""
    charts, alone = group["parameters"], len(group["parameters"]) == 1
    shown = [c for c in charts if alone or c["state"] in {"out of control", "check"} or drifts(c)]
    return [
        f"{group['title']} ({group['place']})",
        f"  {group['verdict']}",
        *(f"  {chart['name']}: {chart['verdict']}" for chart in shown),
    ]


def _told(group: ChartGroupData) -> dict[str, Any]:
    """Return a group as ``--json`` prints it: without the values of every run."""
    long = {"values", "sigmas", "expanded", "ewma"}
    charts = [
        {name: value for name, value in chart.items() if name not in long} for chart in group["parameters"]
    ]
    for chart_data, chart in zip(charts, group["parameters"], strict=True):
        chart_data["ewma_beyond"] = chart["ewma"]["beyond"] if has_limits(chart) else []
    return {**group, "parameters": charts, "runs": [run["run"] for run in group["runs"]]}


def signed(number: float) -> str:
    """Write a number with its sign and two decimals; zero has no sign."""
    text = f"{number:+.2f}"
    return "0.00" if float(text) == 0 else text


def _agreement_lines(runs: Sequence[IndexedRun], compared: Sequence[AgreedData]) -> Iterator[str]:
    head = f"{len(runs)} runs of camera {runs[0].camera}, {runs[0].model} model."
    yield f"{head} ± is the expanded uncertainty U (about 95 %), with the k of the report."
    for parameter in compared:
        name, k = parameter["name"], parameter["coverage_factor"]
        mean = plus_minus(parameter["mean"], parameter["expanded"])
        yield f"{name}: mean {mean} (k = {k:.2f}), Birge ratio {parameter['birge']:.2f}"
        if parameter["repeats"]:
            yield f"  {REPEATS_TEXT}"
        for run, deviation in zip(runs, parameter["deviations"], strict=True):
            estimate = run.parameters[name]
            value, own = with_uncertainty(estimate.value, estimate.expanded)
            begun = run.begun_utc[:16].replace("T", " ")
            yield (
                f"  {begun}  {value:>12} ± {own:<8} (k = {estimate.k:.2f})  {signed(deviation):>6} sigma  {run.id}"
            )
