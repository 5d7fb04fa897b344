"""The uncertainty budget of a report: a row for each source of uncertainty, and what is not included.

Each function takes ``calibration`` of results.json and returns printed text; it is empty if the results have no budget.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from bench.records.estimates import coverage_factor
from bench.records.results import BudgetRowData, CalibrationData
from bench.report.target_words import STARS, TargetWords
from bench.report.text import NOTHING, number

_SHOWN = ("fx", "worst_corner")
_OF_STARS = "stars"
#: Relative values are printed in millionths.
_MILLIONTH = "10\N{SUPERSCRIPT MINUS}\N{SUPERSCRIPT SIX}"
_UNITS = {"1": _MILLIONTH, "urad": "\N{MICRO SIGN}rad"}
_EXACT_DIGITS = 3
_SHARED = "errors that all views share"
_OF_WAVEFRONT = "urad"
"""Unit of the slopes of a wavefront, and of no other row."""


@dataclass(frozen=True)
class PrintedBudgetRow:
    """A source of uncertainty, as printed."""

    # name, type, source: Name of the source, ``A`` or ``B``, and where its value comes from.
    name: str
    type: str
    source: str
    # value, distribution: Stated value with its unit; distribution with its divisor.
    value: str
    distribution: str
    sensitivity: str
    # focal, corner: Contribution to the standard uncertainty of fx and of the worst corner, px.
    focal: str
    corner: str
    # focal_share, corner_share: Share in the variance of fx and of the worst corner, 0 to 1.
    focal_share: float
    corner_share: float


def budget_rows(calibration: CalibrationData, words: TargetWords = STARS) -> list[PrintedBudgetRow]:
    """Return the rows of the uncertainty budget.

    calibration: ``calibration`` of results.json.
    """
    return [_printed(row, words) for row in calibration.get("budget_rows") or []]


def combined(calibration: CalibrationData) -> tuple[tuple[str, str], tuple[str, str]] | None:
    """Return the combined standard uncertainties and the expanded ones (JCGM 100, 5.1.2 and 6.2.1).

    calibration: ``calibration`` of results.json.
    Returns: u, then U = k u, each of fx and of the worst corner, px; None if the results have no budget.
    """
    rows = calibration.get("budget_rows") or []
    if not rows:
        return None
    sums = [math.sqrt(sum(row["contribution"][name] ** 2 for row in rows)) for name in _SHOWN]
    factors = [coverage_factor(calibration, name) for name in _SHOWN]
    standard = [number(one, 2) for one in sums]
    expanded = [number(k * one, 2) for k, one in zip(factors, sums, strict=True)]
    return (standard[0], standard[1]), (expanded[0], expanded[1])


def overlap(calibration: CalibrationData) -> str:
    """Return what to know if two rows of the budget can hold the same errors.

    A stated wavefront and the residuals that all views share can come from the same glass.

    calibration: ``calibration`` of results.json.
    Returns: A sentence; empty if no rows overlap.
    """
    rows = calibration.get("budget_rows") or []
    stated = [str(row["name"]) for row in rows if row["unit"] == _OF_WAVEFRONT]
    if not stated or _SHARED not in {row["name"] for row in rows}:
        return ""
    return (
        f"The rows \N{LEFT DOUBLE QUOTATION MARK}{stated[0]}\N{RIGHT DOUBLE QUOTATION MARK} and"
        f" \N{LEFT DOUBLE QUOTATION MARK}{_SHARED}\N{RIGHT DOUBLE QUOTATION MARK} can hold the same errors of the"
        " collimator. Both are counted, so the uncertainty is an upper limit."
    )


def not_included(calibration: CalibrationData) -> list[tuple[str, str]]:
    """Return the sources of uncertainty that the result does not contain.

    calibration: ``calibration`` of results.json.
    """
    lines = [str(line).partition(": ") for line in calibration.get("not_included") or []]
    return [(name, effect) for name, _, effect in lines]


def _printed(row: BudgetRowData, words: TargetWords) -> PrintedBudgetRow:
    """Return a row as printed."""
    own = words.fitting if row["name"] == _OF_STARS else str  # other sources may be named by the station file
    scale = 1e6 if row["unit"] == "1" else 1.0
    base, _, where = str(row["unit"]).partition(" ")
    unit = _UNITS.get(base, base)
    value, sensitivity, divisor = row.get("value"), row.get("sensitivity") or {}, row.get("divisor")
    distribution = str(row["distribution"])
    if divisor is not None and abs(divisor - 1.0) > 1e-9:
        distribution += f", divisor {number(float(divisor), 3)}"
    elif value is None and row.get("degrees_of_freedom") is not None:
        distribution += f", \N{GREEK SMALL LETTER NU} = {row['degrees_of_freedom']:.0f}"
    contribution, share = row["contribution"], row["share"]
    return PrintedBudgetRow(
        name=own(str(row["name"])),
        type=str(row["type"]),
        source=own(str(row["source"])),
        value=NOTHING if value is None else _stated(scale * value, unit, where),
        distribution=distribution,
        sensitivity=f"{number(float(sensitivity['fx']) / scale, 3)} px / {unit}" if sensitivity else NOTHING,
        focal=_length(contribution["fx"]),
        corner=_length(contribution["worst_corner"]),
        focal_share=float(share["fx"]),
        corner_share=float(share["worst_corner"]),
    )


def _stated(value: float, unit: str, where: str) -> str:
    """Return a stated value with its unit, and where it holds."""
    times = "\N{MULTIPLICATION SIGN} " if unit == _MILLIONTH else ""
    return f"{_short(value)} {times}{unit} {where}".strip()


def _short(value: float) -> str:
    """Return a stated value with up to three significant digits."""
    return f"{value:.{_EXACT_DIGITS}g}" if 1e-3 <= abs(value) < 1e4 or value == 0 else f"{value:.2e}"


def _length(value: float) -> str:
    """Return a contribution with two significant digits, at most three decimals."""
    return "< 0.001" if 0 < value < 0.0005 else number(float(f"{value:.3f}"), 2 if value >= 0.01 else 1)
