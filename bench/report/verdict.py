"""The first lines of a report: the verdict, the main values, the worst corner, and what to read before use."""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from bench.record.coverage import coverage_factor, factors_text
from bench.record.results import CalibrationData, CameraData, ProjectionChange, Results
from bench.report import calibration_tables, pose_tables, run_tables
from bench.wording.causes import cause_sentences
from bench.wording.conformity import conformity_headline, conformity_sentences
from bench.wording.numbers import (
    NOTHING,
    angle_text,
    exact,
    fixed,
    moment,
    number,
    plus_minus,
    with_uncertainty,
)
from bench.wording.target_words import words_of

_DAY_S, _HOUR_S = 86400.0, 3600.0  # Seconds


@dataclass(frozen=True)
class Change:
    """What is printed about the change since the last calibration."""

    why_not: str  # Why there is no comparison; empty if there is one
    facts: tuple[tuple[str, str], ...] = ()
    rows: tuple[dict[str, Any], ...] = ()  # Each with ``normalised``, the E_n number
    over_sensor: str = ""


def change(results: Results) -> Change | None:
    """Return what is printed about the change since the camera's last calibration; None if none is mentioned."""
    previous = results.get("previous")
    if not previous:
        return None
    if not previous.get("calibration"):
        return Change(str(previous["why_not"]))
    then, now = previous["calibration"], results["calibration"]
    temperature = previous.get("temperature_c")
    warm = NOTHING if temperature is None else f"{number(float(temperature), 3)} °C"
    facts = (
        ("Compared with run", f"{previous['run']} (number {previous['number']} of this bench)"),
        ("Finished", f"{moment(previous.get('finished_utc'))}{_earlier(results)}"),
        ("Sequence, model", f"{previous.get('sequence') or NOTHING}, {then['model']}"),
        ("Camera temperature then", warm),
        ("SHA-256 of its results", str(previous["results_sha256"])),
        ("SHA-256 of its seal", str(previous["seal"])),
    )
    rows = tuple(_row(name, then, now) for name in now["camera"] if _in_both(name, then, now))
    return Change("", facts, rows, _over_sensor(previous.get("change")))


def change_sentence(results: Results) -> str:
    """Return the change since the last calibration in one sentence; empty if the results mention none."""
    previous = results.get("previous")
    if not previous:
        return ""
    change = previous.get("change")
    if not change:
        return str(previous.get("why_not") or "")
    since = f"Since the last calibration of this camera ({previous['run']}{_earlier(results)})"
    largest = f"largest change {number(change.largest_px, 2)} px"
    if change.largest_ratio <= 1:
        return f"{since}: no change beyond the uncertainty; {largest}."
    return f"{since}: changed by up to {_times_u(change)} at one place; {largest}."


def _earlier(results: Results) -> str:
    """Return how long before this run the earlier one finished."""
    before, now = results["previous"].get("finished_utc"), results["run"].get("started_utc")
    if not before or not now:
        return ""
    passed_s = (datetime.fromisoformat(now) - datetime.fromisoformat(before)).total_seconds()
    if passed_s < 0:
        return ""
    for name, unit_s in (("days", _DAY_S), ("hours", _HOUR_S)):
        if passed_s >= 2 * unit_s:
            return f", {passed_s / unit_s:.0f} {name} earlier"
    return f", {passed_s / 60:.0f} min earlier"


def _in_both(name: str, then: CameraData, now: CameraData) -> bool:
    return name in then["camera"] and all(
        calibration["sigma"].get(name, 0) > 0 for calibration in (then, now)
    )


def _row(name: str, then: CameraData, now: CameraData) -> dict[str, Any]:
    """Return the change of one value with its expanded uncertainty, sqrt(U1^2 + U2^2), and E_n (ISO 13528)."""
    expanded = [
        coverage_factor(calibration, name) * calibration["sigma"][name] for calibration in (then, now)
    ]
    moved, whole = now["camera"][name] - then["camera"][name], math.hypot(*expanded)
    normalised = moved / whole
    return {
        "name": name,
        "before": with_uncertainty(then["camera"][name], expanded[0]),
        "now": with_uncertainty(now["camera"][name], expanded[1]),
        "change": with_uncertainty(moved, whole),
        "normalised": fixed(normalised, 2),
        "verdict": "pass" if abs(normalised) <= 1 else "marginal",
    }


def _over_sensor(change_data: ProjectionChange | None) -> str:
    if not change_data:
        return ""
    column, row = change_data.at_px
    return (
        f"Over the sensor, the same direction is projected {number(change_data.rms_px, 2)} px (RMS) and at most "
        f"{number(change_data.largest_px, 2)} px apart. Compared with its expanded uncertainty, the change is "
        f"largest at column {exact(round(column))}, row {exact(round(row))}: {_times_u(change_data)}."
    )


def _times_u(change_data: ProjectionChange) -> str:
    return f"{number(change_data.px_there, 2)} px = {number(change_data.largest_ratio, 2)} U"


@dataclass(frozen=True)
class Verdict:
    """The verdict on a calibration, as printed."""

    kind: str  # ``pass``, ``marginal`` or ``fail``
    headline: str
    # Limits of station and sequence, main values, worst corner, support by stars, change since the last one.
    sentences: tuple[str, ...]
    # What to read before the values are used: gates, goals that were not met, deviations.
    reasons: tuple[str, ...]
    # What a person did to the bench, the most probable first; it stands before all else.
    causes: tuple[str, ...] = ()

    @property
    def line(self) -> str:
        """The headline with its first reservation, for status, panel, messages, lists; causes stand beside it there."""
        reservation = "" if self.kind == "pass" or self.causes else next(iter(self.reasons), "")
        return f"{self.headline} {reservation}".rstrip()


def verdict(results: Results) -> Verdict:
    """Return the verdict: ``fail`` if not converged, or a gate or limit failed; ``marginal`` with other reasons."""
    calibration = results["calibration"]
    reasons, causes = tuple(run_tables.alerts(results)), tuple(cause_sentences(results.get("causes", ())))
    judged = [row.verdict for row in pose_tables.gates(results.get("gates") or [])]
    if not calibration["converged"]:
        return Verdict(
            "fail",
            f"{'FAIL. ' if results.get('conformity') else ''}Not calibrated.",
            ("The optimisation did not converge: do not use the values.",),
            reasons,
            causes,
        )
    kind, headline = "pass", "Calibrated."
    if failed := judged.count("fail"):
        kind = "fail"
        headline = f"Calibrated, but {failed} of {len(judged)} gates {'fails' if failed == 1 else 'fail'}."
    elif reasons or causes:
        kind, headline = "marginal", "Calibrated, with reservations."
    if conformity := results.get("conformity"):
        headline = f"{conformity_headline(conformity)} {headline}"
        kind = kind if conformity.passed else "fail"
    sentences = (
        *(conformity_sentences(conformity) if conformity else ()),
        _focal_lengths(calibration),
        _directions(results),
        _support(results),
        change_sentence(results),
    )
    return Verdict(kind, headline, tuple(filter(None, sentences)), reasons, causes)


def _focal_lengths(calibration: CalibrationData) -> str:
    """Return fx and fy with their expanded uncertainties."""
    sigma, parts, factors = calibration["sigma"], [], []
    for name in ("fx", "fy"):
        if name in sigma:
            factors.append(coverage_factor(calibration, name))
            parts.append(f"{name} {plus_minus(calibration['camera'][name], factors[-1] * sigma[name], 'px')}")
    return f"{', '.join(parts)} ({factors_text(factors)}, about 95 %)." if parts else ""


def _directions(results: Results) -> str:
    """Return the uncertainty of a direction in the worst corner; without `projection`, only what the budget says."""
    calibration, facts = results["calibration"], results.get("projection")
    k = _k(coverage_factor(calibration))
    if not facts:
        sums = calibration_tables.combined(calibration)
        return (
            f"Error of an image point in the worst corner: at most {sums[1][1]} px (k = {k})." if sums else ""
        )
    corner, middle = (
        f"{angle_text(direction.expanded_urad)} = {number(direction.expanded_px, 2)} px"
        for direction in (facts.worst_corner, facts.median)
    )
    where = facts.worst_corner.corner
    return (
        f"Error of a direction: at most {corner} in the worst corner ({where}); "
        f"{middle} in the median over the sensor (k = {k})."
    )


def _support(results: Results) -> str:
    """Return how much of the sensor the stars support, and the uncertainty there."""
    facts = results.get("projection")
    supported = facts.supported if facts else None
    if not supported:
        return ""
    share = f"{words_of(results).capital} are near {100 * supported.share:.0f} % of the sensor"
    if supported.expanded_px is None or supported.expanded_urad is None or supported.share >= 0.995:
        return f"{share}."
    k = _k(coverage_factor(results["calibration"]))
    there = f"{angle_text(supported.expanded_urad)} = {number(supported.expanded_px, 2)} px"
    return f"{share}; there, the error of a direction is at most {there} (k = {k}). Elsewhere, the model extrapolates."


def _k(k: float) -> str:
    return exact(round(k, 2))
