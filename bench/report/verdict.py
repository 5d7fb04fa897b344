"""The first lines of a report: the verdict, the main values, the worst corner, and what to read before use.

Text from results.json alone.
"""

from __future__ import annotations

from dataclasses import dataclass

from bench.records.estimates import coverage_factor, factors_text
from bench.records.results import CalibrationData, Results
from bench.report import budget_tables, pose_tables, run_tables
from bench.report.change_rows import change_sentence
from bench.report.target_words import words_of
from bench.report.text import exact, number, with_uncertainty

_MILLI_FROM_URAD = 1000.0


@dataclass(frozen=True)
class Verdict:
    """The verdict on a calibration, as printed."""

    kind: str  # ``pass``, ``marginal`` or ``fail``
    headline: str
    # Main values, worst corner, support by stars, change since the last calibration.
    sentences: tuple[str, ...]
    # What to read before the values are used: gates, goals that were not met, deviations.
    reasons: tuple[str, ...]


def verdict(results: Results) -> Verdict:
    """Return the verdict on a calibration.

    Returns: ``fail`` if the optimisation did not converge or a gate failed; ``marginal`` if there are other
      reasons to read before use.
    """
    calibration = results["calibration"]
    reasons = tuple(run_tables.alerts(results))
    judged = [row.verdict for row in pose_tables.gates(results.get("gates") or [])]
    if not calibration["converged"]:
        return Verdict(
            "fail", "Not calibrated.", ("The optimisation did not converge: do not use the values.",), reasons
        )
    kind, headline = "pass", "Calibrated."
    if failed := judged.count("fail"):
        kind = "fail"
        headline = f"Calibrated, but {failed} of {len(judged)} gates {'fails' if failed == 1 else 'fail'}."
    elif reasons:
        kind, headline = "marginal", "Calibrated, with reservations."
    sentences = (
        _focal_lengths(calibration),
        _directions(results),
        _support(results),
        change_sentence(results),
    )
    return Verdict(kind, headline, tuple(filter(None, sentences)), reasons)


def _focal_lengths(calibration: CalibrationData) -> str:
    """Return fx and fy with their expanded uncertainties."""
    sigma, found, factors = calibration["sigma"], [], []
    for name in ("fx", "fy"):
        if name in sigma:
            factors.append(coverage_factor(calibration, name))
            value, expanded = with_uncertainty(calibration["camera"][name], factors[-1] * sigma[name])
            found.append(f"{name} {value} ± {expanded} px")
    return f"{', '.join(found)} ({factors_text(factors)}, about 95 %)." if found else ""


def _directions(results: Results) -> str:
    """Return the uncertainty of a direction in the worst corner; without `projection`, only what the budget says."""
    calibration, facts = results["calibration"], results.get("projection")
    k = _k(coverage_factor(calibration))
    if not facts:
        sums = budget_tables.combined(calibration)
        return (
            f"Error of an image point in the worst corner: at most {sums[1][1]} px (k = {k})." if sums else ""
        )
    corner, middle = (
        f"{angle_text(found['expanded_urad'])} = {number(found['expanded_px'], 2)} px"
        for found in (facts["worst_corner"], facts["median"])
    )
    where = facts["worst_corner"]["corner"]
    return (
        f"Error of a direction: at most {corner} in the worst corner ({where}); "
        f"{middle} in the median over the sensor (k = {k})."
    )


def _support(results: Results) -> str:
    """Return how much of the sensor the stars support, and the uncertainty there."""
    facts = results.get("projection")
    found = facts["supported"] if facts else None
    if not found:
        return ""
    share = f"{words_of(results).capital} are near {100 * found['share']:.0f} % of the sensor"
    if found["expanded_px"] is None or found["expanded_urad"] is None or found["share"] >= 0.995:
        return f"{share}."
    k = _k(coverage_factor(results["calibration"]))
    there = f"{angle_text(found['expanded_urad'])} = {number(found['expanded_px'], 2)} px"
    return f"{share}; there, the error of a direction is at most {there} (k = {k}). Elsewhere, the model extrapolates."


def angle_text(urad: float) -> str:
    """Print a small angle with two significant digits, in µrad, or in mrad from 1000 µrad on.

    urad: The angle, µrad.

    Examples
    --------
    >>> angle_text(23.44), angle_text(1488.0)
    ('23 µrad', '1.5 mrad')
    """
    # Rounded first: 999.6 µrad is 1.0 mrad.
    rounded = float(f"{urad:.2g}")
    if rounded >= _MILLI_FROM_URAD:
        return f"{number(rounded / 1000.0, 2)} mrad"
    return f"{number(urad, 2)} \N{MICRO SIGN}rad"


def _k(k: float) -> str:
    return exact(round(k, 2))
