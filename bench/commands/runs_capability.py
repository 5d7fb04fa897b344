"""`runs --capability`: a gauge study of many runs, from the ledgers or a folder."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from statistics import fmean
from typing import Any

from bench.base.clock import BenchClock
from bench.base.errors import UsageError
from bench.base.home import home_folder
from bench.commands.options import RunChoice
from bench.commands.output import print_findings, show
from bench.evidence.authorisation import known_authorisations
from bench.evidence.states import home_trust, shown_state
from bench.history.chart_findings import find_charts, needs_attention
from bench.history.chart_groups import Grouped, Level, group_runs
from bench.history.merged_runs import (
    LedgerSource,
    MergedRuns,
    RunPlace,
    merge_ledgers,
    merge_runs,
    read_source,
)
from bench.history.statistics import PART, REPEATABILITY, Capability, GaugeStudy, capability, plural, study
from bench.history.table import SCHEMA, Row, require_writable_table, table_row, write_table
from bench.records.ledger import Ledger
from bench.records.run_facts import IndexedRun, RunDetails
from bench.records.run_index import RunIndex, run_folders
from bench.records.storage import write_atomic
from bench.records.summaries import ChartGroupData, drifts, has_limits
from bench.report.control_chart import render_charts
from bench.report.text import number, unit_text
from bench.terminal.encoding import counted
from calib.model.camera import PINHOLE
from calib.model.lens import BROWN, FISHEYE

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
    return print_findings(merged.faults, merged.notes)


def _rows(merged: MergedRuns) -> Iterator[Row]:
    trust, now = home_trust(home_folder()), datetime.now(UTC)
    known = known_authorisations(home_folder())
    for run, more in RunIndex(home_folder()).details(merged.runs):
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
    facts = RunIndex(home_folder()).details(merged.runs)
    grouped = group_runs(((run, more, merged.places[run.folder]) for run, more in facts), by)
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
    status = print_findings(merged.faults, notes)
    return status or int(any(map(needs_attention, found["groups"])))


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


def _verdict_text(groups: Sequence[ChartGroupData]) -> str:
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
    long = {"values", "sigmas", "expanded", "ranges", "ewma"}
    charts = [
        {name: value for name, value in chart.items() if name not in long} for chart in group["parameters"]
    ]
    for told, chart in zip(charts, group["parameters"], strict=True):
        told["ewma_beyond"] = chart["ewma"]["beyond"] if has_limits(chart) else []
    return {**group, "parameters": charts, "runs": [run["run"] for run in group["runs"]]}


_OF_THE_CAMERA = {*PINHOLE, *BROWN, *FISHEYE}


@dataclass(frozen=True)
class _Run:
    """A run with a result, and what it has in common with others."""

    run: IndexedRun
    details: RunDetails
    place: RunPlace

    @property
    def kind(self) -> tuple[str, ...]:
        """What all runs of a study share."""
        names = sorted(name for name in self.run.parameters if name in _OF_THE_CAMERA)
        camera = self.details["camera_type"] or "camera type not known"
        return self.run.kind, camera, f"model {self.run.model}", ", ".join(names)


_FACTORS: Mapping[str, Callable[[_Run], str]] = {
    "operator": lambda one: one.run.operator or "",
    "bench": lambda one: f"{one.place.bench} {one.run.station}".strip(),
    "day": lambda one: one.run.begun_utc[:10],
}


@dataclass(frozen=True)
class _Studied:
    """A parameter with its study and, if its runs state limits, its capability."""

    name: str
    study: GaugeStudy
    capability: Capability | None


def show_capability(choice: RunChoice, words: str) -> int:
    """Print the gauge study; exit status 1 if ledgers and folders do not agree."""
    factors = _factors(words)
    merged = find_runs(choice)
    chosen = [
        _Run(run, more, merged.places[run.folder])
        for run, more in RunIndex(home_folder()).details(merged.runs)
        if run.how == "finished" and run.parameters
    ]
    _require_one_kind(chosen)
    levels = {name: [_FACTORS[name](one) for one in chosen] for name in factors}
    if "" in levels.get("operator", ()):
        raise UsageError(
            f"{levels['operator'].count('')} of {len(chosen)} runs name no operator.",
            remedy="Leave them out with --since, or study another factor: --capability day.",
        )
    cameras = [one.run.camera for one in chosen]
    found = [
        _studied(name, chosen, cameras, levels) for name in chosen[0].run.parameters if name in _OF_THE_CAMERA
    ]
    show(
        lambda: _as_json(chosen, cameras, levels, found),
        _lines(chosen, cameras, levels, found),
    )
    return print_findings(merged.faults, merged.notes)


def _factors(words: str) -> list[str]:
    names = [word.strip() for word in words.split(",")]
    if wrong := [name for name in names if name not in _FACTORS]:
        raise UsageError(
            f"There is no factor {wrong[0]!r}.",
            where="--capability",
            remedy=f"There are: {', '.join(_FACTORS)}; several with commas.",
        )
    return list(dict.fromkeys(names))


def _require_one_kind(chosen: Sequence[_Run]) -> None:
    kinds = sorted({one.kind for one in chosen})
    if not kinds:
        raise UsageError(
            "There is no finished run with a result.",
            remedy="Name a FOLDER with runs, or a ledger with --ledger.",
        )
    if len(kinds) > 1:
        told = " and ".join(" / ".join(kind) for kind in kinds[:2])
        raise UsageError(
            f"The runs are of {len(kinds)} kinds, which a study never mixes: {told}.",
            remedy="Choose runs of one kind with --since, --until, --sequence or a FOLDER.",
        )


def _studied(
    name: str, chosen: Sequence[_Run], cameras: Sequence[str], levels: Mapping[str, Sequence[str]]
) -> _Studied:
    values = [one.run.parameters[name].value for one in chosen]
    found = study(values, cameras, levels)
    lower, upper = chosen[-1].details["limits"].get(name, (None, None))
    return _Studied(name, found, capability(lower, upper, fmean(values), found.total, found.gauge))


def _as_json(
    chosen: Sequence[_Run],
    cameras: Sequence[str],
    levels: Mapping[str, Sequence[str]],
    found: Sequence[_Studied],
) -> dict[str, Any]:
    return {
        "schema": "starbench/capability/1",
        "runs": [one.run.folder for one in chosen],
        "cameras": sorted(set(cameras)),
        "factors": {name: sorted(set(of_runs)) for name, of_runs in levels.items()},
        "parameters": [_parameter_json(one) for one in found],
    }


def _parameter_json(one: _Studied) -> dict[str, Any]:
    made = one.study
    return {
        "name": one.name,
        "unit": unit_text(one.name),
        "analysis": [{"term": term.name, **_parts(term, _OF_TERM)} for term in made.terms],
        "pooled": list(made.pooled),
        "components": dict(made.components),
        **_parts(made, _OF_STUDY),
        **_parts(one.capability, _OF_CAPABILITY),
    }


def _parts(of: object, names: Sequence[str]) -> dict[str, Any]:
    """Return some attributes of an object by name; of None, None each."""
    return {name: of and getattr(of, name) for name in names}


_OF_TERM = ("sum_of_squares", "degrees_of_freedom", "mean_square", "f", "p")
_OF_STUDY = ("repeatability", "reproducibility", "gauge", "total", "gauge_percent", "categories", "verdict")
_OF_CAPABILITY = ("cp", "cpk", "tolerance_percent")
_HEADS = ("", "unit", "EV", "AV", "GRR", "PV", "TV", "%GRR", "ndc", "%tol", "Cp", "Cpk")


def _lines(
    chosen: Sequence[_Run],
    cameras: Sequence[str],
    levels: Mapping[str, Sequence[str]],
    found: Sequence[_Studied],
) -> Iterator[str]:
    counts = [f"{len(set(of_runs))} {plural(name)}" for name, of_runs in levels.items()]
    head = ", ".join([counted(len(chosen), "run"), f"{len(set(cameras))} {plural(PART)}", *counts])
    yield f"{head}; standard deviations:"
    yield _row(_HEADS)
    for one in found:
        yield f"{_row(_cells(one))}  {one.study.verdict}"
    yield "EV repeatability, AV reproducibility, GRR both, PV cameras, TV total; %GRR = GRR / TV; ndc categories."
    yield "%GRR below 10 is good, to 30 conditional, above it not good; ndc should be 5 or more (AIAG MSA)."
    if any(one.capability for one in found):
        yield "%tol = 6 GRR over the tolerance; Cp and Cpk by TV and the limits of the newest run."
    for one in found:
        seen = [
            f"{name} {number(value, 2)}"
            for name, value in one.study.components.items()
            if name not in (PART, REPEATABILITY) and value > 0
        ]
        if seen:
            yield f"  {one.name}, parts of AV: {', '.join(seen)}"


def _cells(one: _Studied) -> tuple[str, ...]:
    made, fits = one.study, one.capability
    sizes = (made.repeatability, made.reproducibility, made.gauge, made.components[PART], made.total)
    share = f"{made.gauge_percent:.1f}"
    judged = (fits.tolerance_percent, fits.cp, fits.cpk) if fits else (None, None, None)
    categories = "-" if made.categories is None else str(made.categories)
    ratios = (
        "-" if value is None else f"{value:.{digits}f}"
        for value, digits in zip(judged, (1, 2, 2), strict=True)
    )
    return (
        one.name,
        unit_text(one.name),
        *(number(size, 2) for size in sizes),
        share,
        categories,
        *ratios,
    )


def _row(cells: Sequence[str]) -> str:
    return f"{cells[0]:<4}{cells[1]:<5}" + "".join(f"{cell:>9}" for cell in cells[2:])
