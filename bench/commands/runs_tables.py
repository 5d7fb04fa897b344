"""`runs --output` and `runs --chart`: tables and control charts of many runs, of one or several benches."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from bench.base.clock import BenchClock
from bench.base.errors import UsageError
from bench.base.home import home_folder
from bench.commands.ledger import RunChoice, print_findings
from bench.commands.output import show
from bench.evidence.authorisation import known_authorisations
from bench.evidence.states import home_trust, shown_state
from bench.history.chart_findings import Grouped, Level, drifts, find_charts, group_runs, needs_attention
from bench.history.merged_runs import LedgerSource, MergedRuns, merge_ledgers, merge_runs, read_source
from bench.history.table import SCHEMA, require_writable_table, table_row, write_table
from bench.records.ledger import Ledger
from bench.records.run_index import RunIndex, run_folders
from bench.records.storage import write_atomic
from bench.report.control_chart import render_charts
from bench.terminal.encoding import counted

_MOST_GROUPS = 12
"""Most groups of one kind that the terminal describes; it counts the others."""


def find_runs(choice: RunChoice) -> MergedRuns:
    """Find runs by ledgers and folders, and name what does not agree."""
    home, clock = home_folder(), BenchClock()

    def source(folder: Path, *, required: bool) -> LedgerSource:
        ledger = Ledger(folder, utc_now=clock.utc_now, monotonic=clock.monotonic)
        return read_source(ledger, required=required)

    named = [source(folder, required=True) for folder in choice.ledgers]
    ledgers = merge_ledgers(named or [source(home, required=False)])
    folders = run_folders(choice.folder) if choice.folder else []
    index = RunIndex(home)
    merged = merge_runs(index, ledgers, folders, only_folders=bool(choice.folder and not choice.ledgers))
    if any(value is not None for value in choice.filters.values()):
        merged.runs, _ = index.runs([Path(run.folder) for run in merged.runs], **choice.filters)
    return merged


def export_runs(choice: RunChoice, path: Path) -> int:
    """Write the table of runs, and say so; return 1 if ledgers and folders do not agree, else 0."""
    require_writable_table(path)
    merged = find_runs(choice)
    count = write_table(path, _rows(merged), merged.faults)
    facts: dict[str, Any] = {"schema": "starbench/runs-export/1", "table": SCHEMA, "file": str(path)}
    show(
        {**facts, "rows": count, "faults": merged.faults, "notes": merged.notes},
        f"{path}: {counted(count, 'run')}, schema {SCHEMA}.",
    )
    print_findings(merged.notes, merged.faults)
    return 1 if merged.faults else 0


def _rows(merged: MergedRuns) -> Iterator[dict[str, Any]]:
    trust, now = home_trust(home_folder()), datetime.now(UTC)
    known = known_authorisations(home_folder())
    details = RunIndex(home_folder()).details(merged.runs)
    for run, more in zip(merged.runs, details, strict=True):
        state = shown_state(Path(run.folder), trust, now, known)
        yield table_row(run, more, merged.places[run.folder], state)


def chart_runs(
    choice: RunChoice, parameter: str | None, by: Level | None, baseline: int | None, page: Path
) -> int:
    """Write the page of control charts, and print the verdict; None stands for all parameters, or all runs.

    Exit status: 1 out of control, a drift, or ledgers and folders that differ; else 0. ``baseline`` runs set the
    limits.
    """
    _require_page(page)
    merged = find_runs(choice)
    details = RunIndex(home_folder()).details(merged.runs)
    facts = ((run, more, merged.places[run.folder]) for run, more in zip(merged.runs, details, strict=True))
    grouped = group_runs(facts, by)
    _require_parameter(grouped, parameter)
    if parameter is not None:
        grouped.groups = [group for group in grouped.groups if parameter in group.key.parameters]
    found = find_charts(grouped.groups, parameter=parameter, baseline=baseline)
    notes = [*grouped.left_out, *merged.notes]
    write_atomic(page, render_charts(found, notes, merged.faults).encode())
    show(
        lambda: {
            "schema": found["schema"],
            "page": str(page),
            "groups": [_told(group) for group in found["groups"]],
            "faults": merged.faults,
            "notes": notes,
        },
        f"{_verdict_text(found['groups'])}\nCharts: {page}",
    )
    print_findings(notes, merged.faults)
    return 1 if merged.faults or any(map(needs_attention, found["groups"])) else 0


def _require_page(page: Path) -> None:
    if page.suffix.lower() not in {".html", ".htm"} or page.is_dir():
        raise UsageError(
            "The page is an HTML file.", where=str(page), remedy="Choose a name that ends in .html."
        )
    if not page.absolute().parent.is_dir():
        raise UsageError(
            "The folder of this file does not exist.", where=str(page), remedy="Choose another name."
        )


def _require_parameter(grouped: Grouped, parameter: str | None) -> None:
    if not grouped.groups:
        why = " ".join(grouped.left_out)
        raise UsageError(
            f"There is no run with a result. {why}".rstrip(),
            remedy="Name a FOLDER with runs, or a ledger with --ledger.",
        )
    known = dict.fromkeys(name for group in grouped.groups for name in group.key.parameters)
    if parameter is not None and parameter not in known:
        raise UsageError(
            f"No run has a parameter {parameter!r}.",
            remedy=f"There are: {', '.join(known)}. For all of them, write `--chart` as the last word.",
        )


def _verdict_text(groups: Sequence[Mapping[str, Any]]) -> str:
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
    return "\n".join(lines)


def _verdict_lines(group: Mapping[str, Any]) -> list[str]:
    """Return the verdict about a group, and a line for each parameter that needs attention."""
    charts, alone = group["parameters"], len(group["parameters"]) == 1
    shown = [c for c in charts if alone or c["state"] in {"out of control", "check"} or drifts(c)]
    return [
        f"{group['title']} ({group['place']})",
        f"  {group['verdict']}",
        *(f"  {chart['name']}: {chart['verdict']}" for chart in shown),
    ]


def _told(group: Mapping[str, Any]) -> dict[str, Any]:
    """Return a group as ``--json`` prints it: without the values of every run."""
    long = {"values", "sigmas", "expanded", "ranges", "ewma"}
    charts = [
        {name: value for name, value in chart.items() if name not in long} for chart in group["parameters"]
    ]
    for told, chart in zip(charts, group["parameters"], strict=True):
        told["ewma_beyond"] = chart["ewma"]["beyond"] if chart["ewma"] else []
    return {**group, "parameters": charts, "runs": [run["run"] for run in group["runs"]]}
