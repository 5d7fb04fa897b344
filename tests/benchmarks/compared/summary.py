"""The table of a comparison: statistics of each column over its repetitions, as Markdown."""

from collections import Counter
from collections.abc import Sequence

import numpy as np

from .columns import Column
from .methods import Row

HEADS = (
    "method",
    "images",
    "solved",
    "fx error, px",
    "stated U, px",
    "reproj., px",
    "direction, µrad",
    "worst, µrad",
    "fx in U",
    "corner in U",
    "gimbal, %",
)
"""Heads of the table. Errors are root mean squares over the repetitions."""


def table(columns: Sequence[Column], rows: Sequence[Sequence[Row]]) -> str:
    """Return the table, a line for each column; the reasons of failures come last."""
    lines: list[tuple[str, ...]] = [HEADS, ("---", *("--:" for _ in HEADS[1:]))]
    for column, of_column in zip(columns, rows, strict=True):
        if column.group:
            lines.append((f"**{column.group}**", *("" for _ in HEADS[1:])))
        lines.append(_cells(column, of_column))
    failures = [
        f"* {column.name}, {times} times without a result, such as: {why}"
        for column, of_column in zip(columns, rows, strict=True)
        if (reasons := [row["error"] for row in of_column if "error" in row])
        for times, why in [(len(reasons), Counter(reasons).most_common(1)[0][0])]
    ]
    return "\n".join(
        [*(f"| {' | '.join(cells)} |" for cells in lines), *([""] if failures else []), *failures]
    )


def _cells(column: Column, rows: Sequence[Row]) -> tuple[str, ...]:
    good = [row for row in rows if "error" not in row]
    covered = {
        what: _mean([float(row["covered"][what]) for row in good if what in row["covered"]])
        for what in ("fx", "corner")
    }
    gimbal = _rms([row["gimbal_ratio_error"] for row in good])
    return (
        column.name,
        str(column.images),
        f"{len(good)} of {len(rows)}",
        shown(_rms([row["errors"]["fx"] for row in good])),
        shown(_mean([row["k"] * row["sigma"]["fx"] for row in good if "fx" in row["sigma"]])),
        shown(_rms([row["rms_px"] for row in good]), 2),
        shown(_rms([row["direction_rms_urad"] for row in good])),
        shown(max((row["direction_worst_urad"] for row in good), default=None)),
        share(covered["fx"]),
        share(covered["corner"]),
        "-" if gimbal is None else f"{100 * gimbal:.2f}",
    )


def _mean(numbers: Sequence[float]) -> float | None:
    return float(np.mean(numbers)) if numbers else None


def _rms(numbers: Sequence[float | None]) -> float | None:
    known = [number for number in numbers if number is not None]
    return float(np.sqrt(np.mean(np.square(known)))) if known else None


def shown(number: float | None, digits: int = 3) -> str:
    """Return a number with a few significant digits; a dash for none."""
    if number is None:
        return "-"
    text = f"{number:.{digits}g}"
    return f"{number:.0f}" if "e" in text else text


def share(number: float | None) -> str:
    """Return a share, 0 to 1, as per cent; a dash for none."""
    return "-" if number is None else f"{100 * number:.0f} %"
