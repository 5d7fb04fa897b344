"""The table of a comparison as text for a terminal, and as rows for the page."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, TypedDict

import numpy as np

from bench.compare.methods import Row, SolvedRow, bench_time_s, is_failed, solved
from bench.compare.spec import ColumnConfig, ComparisonConfig

PARAMETERS = ("fx", "fy", "cx", "cy", "k1", "k2")


class ParameterSummary(TypedDict):
    """One parameter of a column over its repetitions; None where fewer than needed state it."""

    mean: float | None
    spread: float | None
    rms_error: float | None
    stated_sigma: float | None


class Failures(TypedDict):
    """How often a column had no result, for one reason."""

    why: str
    times: int


class _AnyColumn(TypedDict):
    settings: Mapping[str, Any]  # Its `ColumnConfig`
    bench_time_s: float | None  # None for recorded data
    solved: int
    failed: Sequence[Failures]
    images_cpu_s: float | None


class ColumnSummary(_AnyColumn, total=False):
    """Statistics of a column, of errors their rms; without one result only those of `_AnyColumn`."""

    parameters: Mapping[str, ParameterSummary]
    rms_px: float | None
    mean_px: float | None
    left_out_px: float | None
    direction_rms_urad: float | None
    centre_urad: float | None
    gimbal_ratio_error: float | None
    halves_urad: float | None
    direction_worst_urad: float | None
    corner_rms_urad: float | None
    corner_worst_urad: float | None
    expanded_fx_px: float | None
    coverage: Mapping[str, float | None]  # Share of errors within the expanded uncertainty
    models: Mapping[str, int]
    views: float | None
    solve_cpu_s: float | None


class Summary(TypedDict):
    """``results.json`` of a comparison."""

    schema: str
    name: str
    about: str
    seed: int
    repetitions: int
    columns: Sequence[ColumnSummary]  # In the order of the specification


def summarise(spec: ComparisonConfig, rows: Mapping[str, Sequence[Row]]) -> Summary:
    """Return the statistics of a comparison from the rows of each column."""
    return {
        "schema": "starbench/comparison-results/1",
        "name": spec.name,
        "about": spec.about,
        "seed": spec.seed,
        "repetitions": spec.repetitions,
        "columns": [_column(column, rows[column.name]) for column in spec.columns],
    }


def _column(column: ColumnConfig, rows: Sequence[Row]) -> ColumnSummary:
    good = solved(rows)
    reasons = [row["error"] for row in rows if is_failed(row)]
    found: ColumnSummary = {
        "settings": column.model_dump(),
        "bench_time_s": None if column.data else bench_time_s(column),
        "solved": len(good),
        "failed": [{"why": why, "times": times} for why, times in Counter(reasons).items()],
        "images_cpu_s": _mean([row["images_cpu_s"] for row in rows]),
    }
    if not good:
        return found
    return {
        **found,
        "parameters": {name: _parameter(good, name) for name in PARAMETERS if name in good[0]["camera"]},
        "rms_px": _rms([row["rms_px"] for row in good]),
        "mean_px": _rms([row["mean_px"] for row in good]),
        "left_out_px": _rms([row["left_out_px"] for row in good]),
        "direction_rms_urad": _rms([row["direction_rms_urad"] for row in good]),
        "centre_urad": _rms([row["centre_urad"] for row in good]),
        "gimbal_ratio_error": _rms([row["gimbal_ratio_error"] for row in good if "halves_urad" not in row]),
        "halves_urad": _rms([row["halves_urad"] for row in good if "gimbal_ratio_error" not in row]),
        "direction_worst_urad": _largest([row["direction_worst_urad"] for row in good]),
        "corner_rms_urad": _rms([row["corner_urad"] for row in good]),
        "corner_worst_urad": _largest([row["corner_urad"] for row in good]),
        "expanded_fx_px": _mean([row["k"] * row["sigma"]["fx"] for row in good if "fx" in row["sigma"]]),
        "coverage": {
            what: _mean([float(row["covered"][what]) for row in good if what in row["covered"]])
            for what in ("fx", "fy", "cx", "cy", "corner")
            if any(what in row["covered"] for row in good)
        },
        "models": Counter(str(row["model"]) for row in good),
        "views": _mean([float(row["views"]) for row in good]),
        "solve_cpu_s": _mean([row["solve_cpu_s"] for row in good]),
    }


def _parameter(rows: Sequence[SolvedRow], name: str) -> ParameterSummary:
    return {
        "mean": _mean([row["camera"][name] for row in rows]),
        "spread": _deviation([row["camera"][name] for row in rows]),
        "rms_error": _rms([row["errors"].get(name) for row in rows]),
        "stated_sigma": _rms([row["sigma"].get(name) for row in rows]),
    }


def _known(numbers: Sequence[float | None]) -> list[float]:
    return [number for number in numbers if number is not None]


def _mean(numbers: Sequence[float | None]) -> float | None:
    known = _known(numbers)
    return float(np.mean(known)) if known else None


def _rms(numbers: Sequence[float | None]) -> float | None:
    known = _known(numbers)
    return float(np.sqrt(np.mean(np.square(known)))) if known else None


def _deviation(numbers: Sequence[float | None]) -> float | None:
    known = _known(numbers)
    return float(np.std(known, ddof=1)) if len(known) > 1 else None


def _largest(numbers: Sequence[float | None]) -> float | None:
    known = _known(numbers)
    return float(max(known)) if known else None


HEADS = (
    "images",
    "solved",
    "fx error px",
    "U(fx) px",
    "cx error px",
    "reproj. px",
    "direction µrad",
    "worst µrad",
    "fx in U",
    "corner in U",
    "gimbal %",
    "bench s",
)
"""Heads of the columns after the name. Errors are root mean squares over the repetitions."""

DATA_HEADS = (
    "images",
    "solved",
    "fx px",
    "U(fx) px",
    "reproj. px",
    "left out px",
    "halves µrad",
    "fx within U",
    "cx within U",
)
"""Heads for recorded data, after the name."""


def table_rows(summary: Summary) -> list[list[str]]:
    """Return a row for each column of simulated images: its name, then a cell for each of `HEADS`."""
    return [
        _cells(column, summary["repetitions"])
        for column in summary["columns"]
        if not column["settings"]["data"]
    ]


def data_rows(summary: Summary) -> list[list[str]]:
    """Return a row for each column of recorded data: its name, then a cell for each of `DATA_HEADS`."""
    return [
        _data_cells(column, summary["repetitions"])
        for column in summary["columns"]
        if column["settings"]["data"]
    ]


def table_text(summary: Summary) -> str:
    """Return the table for a terminal; the reasons of failures come last."""
    blocks = [(HEADS, table_rows(summary)), (DATA_HEADS, data_rows(summary))]
    lines = [line for heads, rows in blocks if rows for line in _aligned([["", *heads], *rows])]
    lines += [
        f"{column['settings']['name']}: {failed['times']} without a result: {failed['why']}"
        for column in summary["columns"]
        for failed in column["failed"]
    ]
    return "\n".join(line.rstrip() for line in lines)


def _aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Return lines of equal columns, the first one left, the others right."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return [
        "  ".join(
            [
                row[0].ljust(widths[0]),
                *(cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True)),
            ]
        )
        for row in rows
    ]


def shown(number: float | None, digits: int = 3) -> str:
    """Return a number with a few significant digits; a dash for none.

    >>> shown(1234.5), shown(0.01234), shown(None)
    ('1234', '0.0123', '-')
    """
    if number is None:
        return "-"
    text = f"{number:.{digits}g}"
    return f"{number:.0f}" if "e" in text else text


def share(number: float | None) -> str:
    """Return a share, 0 to 1, as per cent; a dash for none."""
    return "-" if number is None else f"{100 * number:.0f} %"


def _cells(column: ColumnSummary, repetitions: int) -> list[str]:
    settings = column["settings"]
    head = [settings["name"], str(settings["images"]), f"{column['solved']} of {repetitions}"]
    if not column["solved"]:
        return head + ["-"] * (len(HEADS) - 3) + [shown(column["bench_time_s"], 2)]
    values, covered = column["parameters"], column["coverage"]
    return [
        *head,
        shown(values["fx"]["rms_error"]),
        shown(column["expanded_fx_px"]),
        shown(values["cx"]["rms_error"]),
        shown(column["rms_px"], 2),
        shown(column["direction_rms_urad"]),
        shown(column["direction_worst_urad"]),
        share(covered.get("fx")),
        share(covered.get("corner")),
        "-" if column["gimbal_ratio_error"] is None else f"{100 * column['gimbal_ratio_error']:.2f}",
        f"{column['bench_time_s']:.0f}",
    ]


def _data_cells(column: ColumnSummary, repetitions: int) -> list[str]:
    settings = column["settings"]
    head = [settings["name"], str(settings["images"]), f"{column['solved']} of {repetitions}"]
    if not column["solved"]:
        return head + ["-"] * (len(DATA_HEADS) - 2)
    return [
        *head,
        _spread(column["parameters"]["fx"]),
        shown(column["expanded_fx_px"]),
        shown(column["rms_px"], 2),
        shown(column["left_out_px"], 2),
        shown(column["halves_urad"]),
        share(column["coverage"].get("fx")),
        share(column["coverage"].get("cx")),
    ]


def parameter_rows(summary: Summary, names: Sequence[str]) -> list[list[str]]:
    """Return a row for each column: its name, then ``mean ± spread`` of each parameter, as in the paper's Table 1."""
    rows = []
    for column in summary["columns"]:
        values = column.get("parameters", {})
        cells = [_spread(values[name]) if name in values else "-" for name in names]
        rows.append([column["settings"]["name"], *cells])
    return rows


def _spread(value: ParameterSummary) -> str:
    """Return a mean with the standard deviation over the repetitions."""
    if value["mean"] is None or not value["spread"]:
        return shown(value["mean"], 6)
    digits = max(0, 1 - int(f"{value['spread']:.1e}".split("e")[1]))
    return f"{value['mean']:.{digits}f} ± {value['spread']:.{digits}f}"
