"""Rows of the report's tables on the calibration: values, agreement, budget, correlation, comparisons, checks.

Knows the structure of results.json; each function takes a part of it and gives rows of printed text, empty where the
part is missing, so that the page can leave the table out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from bench.report.text import NOTHING, fixed, meaning_of, number, unit_of, with_uncertainty

Json = Mapping[str, Any]

_USUAL_COVERAGE_FACTOR = 2.0


@dataclass(frozen=True)
class ValueRow:
    """A calibrated value with its expanded uncertainty."""

    name: str
    meaning: str
    value: str
    expanded: str
    relative: str
    unit: str


@dataclass(frozen=True)
class Cell:
    """A cell of a matrix, and how strongly it is shaded, 0 to 1."""

    text: str
    shade: float


def coverage_factor(calibration: Json) -> float:
    """Give k: the expanded uncertainty U is this many standard uncertainties and covers about 95 %."""
    return float(calibration.get("coverage_factor") or _USUAL_COVERAGE_FACTOR)


def values(calibration: Json) -> list[ValueRow]:
    """Give each value with its expanded uncertainty."""
    found = {**calibration["camera"], **(calibration.get("collimator") or {})}
    k = coverage_factor(calibration)
    rows = []
    for name, sigma in calibration["sigma"].items():
        if name not in found:
            continue
        value, expanded = with_uncertainty(found[name], k * sigma)
        share = k * sigma / abs(found[name]) if found[name] else float("inf")
        relative = f"{number(100 * share, 2)} %" if share < 1 else NOTHING
        rows.append(ValueRow(name, meaning_of(name), value, expanded, relative, unit_of(name)))
    return rows


def fit_statistics(calibration: Json) -> list[tuple[str, str, str]]:
    """Say how well the model follows the data: what, number, unit."""
    stars = sum(view["n"] for view in calibration["views"])
    rows = [
        ("RMS reprojection error", number(calibration["rms_px"], 3), "px"),
        ("mean reprojection error", number(calibration["mean_px"], 3), "px"),
        ("RMS of poses left out of the fit", number(calibration.get("left_out_rms_px"), 3), "px"),
        (f"stars in {len(calibration['views'])} poses", number(stars), ""),
        ("degrees of freedom", number(calibration.get("degrees_of_freedom")), ""),
        ("variance factor of the stars", number(calibration.get("variance_factor"), 3), ""),
        ("disagreement of the poses, 1 is none", number(calibration.get("disagreement"), 3), ""),
    ]
    return [row for row in rows if row[1] != NOTHING]


def budget(calibration: Json) -> tuple[list[str], list[tuple[str, list[Cell]]]]:
    """Give the names of the parameters and, for each source, its share of each one's variance."""
    sources = calibration.get("budget") or {}
    names = [name for name in calibration["sigma"] if all(name in sigmas for sigmas in sources.values())]
    rows = []
    for source, sigmas in sources.items():
        wholes = [sum(other[name] ** 2 for other in sources.values()) for name in names]
        shares = [
            sigmas[name] ** 2 / whole if whole else 0.0 for name, whole in zip(names, wholes, strict=True)
        ]
        rows.append((str(source), [Cell(f"{100 * share:.0f} %", round(share, 2)) for share in shares]))
    return (names, rows) if rows else ([], [])


def correlation(calibration: Json) -> tuple[list[str], list[list[Cell]]]:
    """Give the names of the parameters and their correlation coefficients."""
    covariance = calibration.get("covariance") or {"names": [], "matrix": []}
    matrix = covariance["matrix"]
    rows = []
    for i, row in enumerate(matrix):
        scales = [(row[i] * matrix[j][j]) ** 0.5 for j in range(len(row))]
        shares = [entry / scale if scale > 0 else 0.0 for entry, scale in zip(row, scales, strict=True)]
        rows.append([Cell(fixed(share, 2), round(min(1.0, abs(share)), 2)) for share in shares])
    return list(covariance["names"]), rows


def planar_comparison(calibration: Json, planar: Json | None) -> list[tuple[str, str, str, str, str]]:
    """Compare with the planar calibration: name, value, U, planar value, planar U."""
    if planar is None:
        return []
    k, k_planar = coverage_factor(calibration), coverage_factor(planar)
    rows = []
    for name, sigma in planar["sigma"].items():
        if name in calibration["camera"] and name in calibration["sigma"]:
            own = with_uncertainty(calibration["camera"][name], k * calibration["sigma"][name])
            rows.append((name, *own, *with_uncertainty(planar["camera"][name], k_planar * sigma)))
    rms = (number(calibration["rms_px"], 3), "", number(planar["rms_px"], 3), "")
    return [*rows, ("RMS, px", *rms)]


def candidates(calibration: Json) -> list[tuple[str, str, str, str, str]]:
    """List the models that were compared: name, parameters, RMS, RMS of left-out views, BIC."""
    return [
        (
            str(model["model"]),
            number(model["parameters"]),
            number(model["rms_px"], 3),
            number(model["left_out_rms_px"], 3),
            number(model["bic"], 6),
        )
        for model in calibration.get("candidates") or []
    ]


def comparison(rows: Sequence[Json], k: float) -> list[tuple[str, str, str, str, str, str]]:
    """Compare with the simulated truth: name, value, U, truth, error, error in sigmas."""
    printed = []
    for row in rows:
        value, expanded = with_uncertainty(row["value"], k * row["sigma"])
        error, _ = with_uncertainty(row["error"], k * row["sigma"])
        truth, _ = with_uncertainty(row["truth"], k * row["sigma"])
        sigmas = fixed(row["error_sigmas"], 2)
        printed.append((row["name"], value, expanded, truth, error, sigmas))
    return printed


def checks(results: Json) -> list[tuple[str, str]]:
    """Tell of checks that took no part in the result: halves of the poses apart, and the gimbal's readings."""
    rows = []
    if halves := results.get("halves"):
        told = f"RMS {number(halves['rms_px'], 3)} px over the sensor, at most {number(halves['worst_px'], 3)} px; "
        told += f"their uncertainties let one expect {number(halves['expected_px'], 3)} px"
        rows.append(("Every other pose against the rest", told))
    if gimbal := results.get("gimbal"):
        told = f"RMS {number(gimbal['rms_arcsec'], 3)}\N{DOUBLE PRIME}"
        if gimbal.get("agrees") is False:
            told += (
                ", more than the stars' uncertainty explains: the gimbal repeats worse than the camera sees,"
            )
            told += " or an axis slipped; the result does not rest on its readings"
        rows.append(("Rotations against the gimbal", told))
        for axis, scale in gimbal["scale"].items():
            value, expanded = with_uncertainty(scale, 2 * gimbal["scale_sigma"][axis])
            rows.append(
                (f"Scale of the gimbal's {axis.removesuffix('_deg')}", f"{value} ± {expanded} (k = 2)")
            )
    return rows
