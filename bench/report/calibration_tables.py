"""Rows of the report's tables about the calibration: values, fit, uncertainty budget, correlation, comparisons, checks.

Rows of printed text from a part of results.json; none if it is missing: the page then omits the table.
"""

from __future__ import annotations

import math
from typing import Any

from bench.record.coverage import coverage_factor
from bench.record.results import CalibrationData, GimbalComparison, Results
from bench.report.run_tables import parallax_rows
from bench.wording.numbers import NOTHING, angle, exact, fixed, number, plus_minus, with_uncertainty
from bench.wording.target_words import STARS, TargetWords
from calib.model.result_parts import BudgetRow, Witness

_SHOWN = ("fx", "worst_corner")
_OF_STARS = "stars"
#: Relative values are printed in millionths.
_MILLIONTH = "10\N{SUPERSCRIPT MINUS}\N{SUPERSCRIPT SIX}"
_UNITS = {"1": _MILLIONTH, "urad": "\N{MICRO SIGN}rad"}
_EXACT_DIGITS = 3  # A stated uncertainty has two
_SHARED = "errors that all views share"
_OF_WAVEFRONT = "urad"
"""Unit of the slopes of a wavefront, and of no other row."""
_UNUSUAL, _CONTRADICTION = 2.0, 4.0
"""Sizes of an innovation, in units of its standard uncertainty: by chance, one in 22 exceeds the first, one in 16,000
the second."""
_DOUBTED = 0.3
"""Probability of a fault from which on a statement is named in the notes (`calib.joint.words`)."""

_VERDICTS = {
    "agrees": "readings and rotations agree",
    "ambiguous": "no scale can be stated",
    "scale or parallax": "scale error or parallax",
    "views biased": "no fault shown; the views contradict each other",
}
"""Headings of those verdicts of the hand-eye check that name no cause."""

Cell = tuple[str, float]
"""A cell of a matrix: its text and the strength of its shading, 0 to 1."""


def budget_rows(calibration: CalibrationData, words: TargetWords = STARS) -> list[dict[str, Any]]:
    """Return the rows of the uncertainty budget, as printed; shares are in the variance, 0 to 1."""
    return [_printed(row, words) for row in calibration["budget_rows"]]


def combined(calibration: CalibrationData) -> tuple[tuple[str, str], tuple[str, str]] | None:
    """Return u and U = k u (JCGM 100, 5.1.2 and 6.2.1) of fx and of the worst corner, px; None without a budget."""
    rows = calibration["budget_rows"]
    if not rows:
        return None
    sums = [math.sqrt(sum(row.contribution[name] ** 2 for row in rows)) for name in _SHOWN]
    factors = [coverage_factor(calibration, name) for name in _SHOWN]
    standard = [number(u, 2) for u in sums]
    expanded = [number(k * u, 2) for k, u in zip(factors, sums, strict=True)]
    return (standard[0], standard[1]), (expanded[0], expanded[1])


def overlap(calibration: CalibrationData) -> str:
    """Return what to know if the stated wavefront and common residuals can be of the same glass; else empty."""
    rows = calibration["budget_rows"]
    stated = [row.name for row in rows if row.unit == _OF_WAVEFRONT]
    if not stated or _SHARED not in {row.name for row in rows}:
        return ""
    return (
        f"The rows \N{LEFT DOUBLE QUOTATION MARK}{stated[0]}\N{RIGHT DOUBLE QUOTATION MARK} and"
        f" \N{LEFT DOUBLE QUOTATION MARK}{_SHARED}\N{RIGHT DOUBLE QUOTATION MARK} can hold the same errors of the"
        " collimator. Both are counted, so the uncertainty is an upper limit."
    )


def not_included(calibration: CalibrationData) -> list[tuple[str, str]]:
    """Return the sources of uncertainty that the result does not contain."""
    lines = [str(line).partition(": ") for line in calibration["not_included"]]
    return [(name, effect) for name, _, effect in lines]


def _printed(row: BudgetRow, words: TargetWords) -> dict[str, Any]:
    """Return a row as printed."""
    of_stars = row.name == _OF_STARS  # of the points, if a board is seen
    scale = 1e6 if row.unit == "1" else 1.0
    base, _, where = row.unit.partition(" ")
    unit = _UNITS.get(base, base)
    value, divisor = row.value, row.divisor
    distribution = row.distribution
    if divisor is not None and abs(divisor - 1.0) > 1e-9:
        distribution += f", divisor {number(divisor, 3)}"
    elif value is None and row.degrees_of_freedom is not None:
        distribution += f", \N{GREEK SMALL LETTER NU} = {row.degrees_of_freedom:.0f}"
    contribution, share = row.contribution, row.share
    return {
        "name": words.points if of_stars else row.name,
        "type": row.type,
        "source": row.source,
        "value": NOTHING if value is None else _stated(scale * value, unit, where),
        "distribution": distribution,
        "sensitivity": f"{number(row.sensitivity['fx'] / scale, 3)} px / {unit}"
        if row.sensitivity
        else NOTHING,
        "lengths": [_length(contribution[name]) for name in _SHOWN],
        "shares": [share[name] for name in _SHOWN],
    }


def _stated(value: float, unit: str, where: str) -> str:
    """Return a stated value with its unit, and where it holds."""
    times = "\N{MULTIPLICATION SIGN} " if unit == _MILLIONTH else ""
    return f"{_short(value)} {times}{unit} {where}".strip()


def _short(value: float) -> str:
    """Return a stated value with up to three significant digits."""
    return exact(float(f"{value:.{_EXACT_DIGITS}g}"))


def _length(value: float) -> str:
    """Return a contribution with two significant digits, at most three decimals."""
    return "< 0.001" if 0 < value < 0.0005 else number(float(f"{value:.3f}"), 2 if value >= 0.01 else 1)


def witness_rows(calibration: CalibrationData) -> list[dict[str, str]]:
    """List the statements, those that are most at odds with the others first."""
    by_doubt = sorted(
        calibration["witnesses"],
        key=lambda witness: (-witness.fault_probability, -abs(witness.innovation)),
    )
    return [_row(witness) for witness in by_doubt]


def _row(witness: Witness) -> dict[str, str]:
    size = abs(witness.innovation)
    doubted = witness.fault_probability >= _DOUBTED or size >= _CONTRADICTION
    return {
        "name": witness.name,
        "source": witness.source,
        "stated": _value(witness.stated, witness.sigma, witness.unit),
        "expected": _value(witness.expected, witness.expected_sigma, witness.unit),
        "innovation": fixed(witness.innovation, 1),
        "fault": f"{100 * witness.fault_probability:.0f} %",
        "verdict": "fail" if doubted else "marginal" if size > _UNUSUAL else "pass",
    }


def _value(value: float | None, sigma: float | None, unit: str) -> str:
    if value is None or sigma is None or not math.isfinite(sigma):
        return NOTHING
    return plus_minus(value, sigma, "" if unit == "1" else unit)


def values(calibration: CalibrationData) -> list[tuple[str, str, str, str, str]]:
    """Return name, value, U = k u (JCGM 100, 6.2.1), the relative U if it is below 100 %, and k."""
    parameters = {**calibration["camera"], **(calibration["collimator"] or {})}
    rows = []
    for name, sigma in calibration["sigma"].items():
        if name not in parameters:
            continue
        k = coverage_factor(calibration, name)
        share = k * sigma / abs(parameters[name]) if parameters[name] else float("inf")
        relative = f"{number(100 * share, 2)} %" if share < 1 else NOTHING
        rows.append((name, *with_uncertainty(parameters[name], k * sigma), relative, fixed(k, 2)))
    return rows


def fit_statistics(calibration: CalibrationData, words: TargetWords = STARS) -> list[tuple[str, str, str]]:
    """Return the statistics of the fit: residuals, numbers of stars and degrees of freedom, variance factors."""
    stars = sum(view["n"] for view in calibration["views"])
    rows = [
        ("RMS reprojection error", number(calibration["rms_px"], 3), "px"),
        ("mean reprojection error", number(calibration["mean_px"], 3), "px"),
        ("RMS reprojection error of left-out poses", number(calibration["left_out_rms_px"], 3), "px"),
        (f"{words.points} in {len(calibration['views'])} poses", number(stars), ""),
        ("degrees of freedom", number(calibration["degrees_of_freedom"]), ""),
        (f"variance factor of the {words.points}", number(calibration["variance_factor"], 3), ""),
        ("Birge ratio of the poses; 1 is agreement", number(calibration["disagreement"], 3), ""),
    ]
    return [row for row in rows if row[1] != NOTHING]


def budget(
    calibration: CalibrationData, words: TargetWords = STARS
) -> tuple[list[str], list[tuple[str, list[Cell]]]]:
    """Return parameters, and each source with its shares of their variances, which add up to 100 % but for rounding."""
    sources = calibration["budget"]
    names = [name for name in calibration["sigma"] if all(name in sigmas for sigmas in sources.values())]
    wholes = {name: sum(other[name] ** 2 for other in sources.values()) for name in names}
    rows = []
    for source, sigmas in sources.items():
        shares = [sigmas[name] ** 2 / whole if whole else 0.0 for name, whole in wholes.items()]
        cells = [(f"{100 * share:.0f} %", round(share, 2)) for share in shares]
        rows.append((words.points if source == _OF_STARS else source, cells))
    return (names, rows) if rows else ([], [])


def correlation(calibration: CalibrationData) -> tuple[list[str], list[list[Cell]]]:
    """Return the correlation coefficients of the parameters (JCGM 100, 5.2.2, equation 14)."""
    covariance = calibration.get("covariance") or {"names": [], "matrix": []}
    matrix = covariance["matrix"]
    rows = []
    for i, row in enumerate(matrix):
        scales = [(row[i] * matrix[j][j]) ** 0.5 for j in range(len(row))]
        shares = [entry / scale if scale > 0 else 0.0 for entry, scale in zip(row, scales, strict=True)]
        rows.append([(fixed(share, 2), round(min(1.0, abs(share)), 2)) for share in shares])
    return list(covariance["names"]), rows


def checks(results: Results) -> list[tuple[str, str]]:
    """Describe the checks that do not influence the result: split half, the gimbal's readings, the parallax."""
    rows = []
    if halves := results.get("halves"):
        difference = f"RMS difference {number(halves.rms_px, 3)} px over the sensor, "
        difference += f"at most {number(halves.worst_px, 3)} px; "
        difference += f"expected from the uncertainties: {number(halves.expected_px, 3)} px"
        rows.append(("Split half: every other pose against the rest", difference))
    if gimbal := results.get("gimbal"):
        rows += _gimbal(gimbal)
    return rows + parallax_rows(results.get("parallax"))


def _gimbal(gimbal: GimbalComparison) -> list[tuple[str, str]]:
    """Describe the hand-eye check."""
    text = f"RMS difference {angle(gimbal.rms_arcsec)}."
    rows = [("Hand-eye check: rotations against the gimbal's readings", text)]
    rows.append((f"Gimbal: {_VERDICTS.get(gimbal.verdict, gimbal.verdict)}", " ".join(gimbal.says)))
    for axis, scale in gimbal.scale.items():
        name = f"Angle seen over angle read, {axis.removesuffix('_deg')}"
        rows.append((name, f"{plus_minus(scale, 2 * gimbal.scale_sigma[axis])} (k = 2)"))
    return rows
