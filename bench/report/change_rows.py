"""The change since the last calibration of the same camera, as text: one sentence for the verdict, rows of a table."""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import datetime

from bench.records.estimates import coverage_factor
from bench.records.results import CameraData, ChangeData, Results
from bench.report.text import NOTHING, exact, fixed, moment, number, unit_of, with_uncertainty

_DAY_S, _HOUR_S = 86400.0, 3600.0


@dataclass(frozen=True)
class ChangeRow:
    """The change of one value, as printed; ``normalised`` is the E_n number."""

    name: str
    before: str
    before_expanded: str
    now: str
    now_expanded: str
    change: str
    change_expanded: str
    unit: str
    normalised: str
    verdict: str


@dataclass(frozen=True)
class Change:
    """What is printed about the change since the last calibration."""

    why_not: str  # Why there is no comparison; empty if there is one
    facts: tuple[tuple[str, str], ...] = ()
    rows: tuple[ChangeRow, ...] = ()
    over_sensor: str = ""


def change(results: Results) -> Change | None:
    """Return what is printed about the change since the last calibration of the same camera.

    Returns: None if the results do not say whether there was an earlier calibration.
    """
    previous = results.get("previous")
    if not previous:
        return None
    if not previous.get("calibration"):
        return Change(str(previous["why_not"]))
    then, now = previous["calibration"], results["calibration"]
    temperature = previous.get("temperature_c")
    facts = (
        ("Compared with run", f"{previous['run']} (number {previous['number']} of this bench)"),
        ("Finished", f"{moment(previous.get('finished_utc'))}{_earlier(results)}"),
        ("Sequence, model", f"{previous.get('sequence') or NOTHING}, {then['model']}"),
        (
            "Camera temperature then",
            NOTHING if temperature is None else f"{number(float(temperature), 3)} °C",
        ),
        ("SHA-256 of its results", str(previous["results_sha256"])),
        ("SHA-256 of its seal", str(previous["seal"])),
    )
    rows = tuple(_row(name, then, now) for name in now["camera"] if _in_both(name, then, now))
    return Change("", facts, rows, _over_sensor(previous.get("change")))


def change_sentence(results: Results) -> str:
    """Return the change since the last calibration in one sentence.

    Returns: The sentence; empty if the results do not say whether there was an earlier calibration.
    """
    previous = results.get("previous")
    if not previous:
        return ""
    found = previous.get("change")
    if not found:
        return str(previous.get("why_not") or "")
    since = f"Since the last calibration of this camera ({previous['run']}{_earlier(results)})"
    largest = f"largest change {number(found['largest_px'], 2)} px"
    if found["largest_ratio"] <= 1:
        return f"{since}: no change beyond the uncertainty; {largest}."
    return f"{since}: changed by up to {_times_u(found)} at one place; {largest}."


def _earlier(results: Results) -> str:
    """Return how long before this run the earlier one finished."""
    before, now = results["previous"].get("finished_utc"), results["run"].get("started_utc")
    if not before or not now:
        return ""
    passed_s = (datetime.fromisoformat(now) - datetime.fromisoformat(before)).total_seconds()
    if passed_s < 0:
        return ""
    if passed_s >= 2 * _DAY_S:
        return f", {passed_s / _DAY_S:.0f} days earlier"
    return (
        f", {passed_s / _HOUR_S:.0f} hours earlier"
        if passed_s >= 2 * _HOUR_S
        else f", {passed_s / 60:.0f} min earlier"
    )


def _in_both(name: str, then: CameraData, now: CameraData) -> bool:
    return name in then["camera"] and all(one["sigma"].get(name, 0) > 0 for one in (then, now))


def _row(name: str, then: CameraData, now: CameraData) -> ChangeRow:
    """Return the change of one value with its expanded uncertainty, sqrt(U1^2 + U2^2), and E_n (ISO 13528)."""
    expanded = [coverage_factor(one, name) * one["sigma"][name] for one in (then, now)]
    moved, whole = now["camera"][name] - then["camera"][name], math.hypot(*expanded)
    normalised = moved / whole
    return ChangeRow(
        name,
        *with_uncertainty(then["camera"][name], expanded[0]),
        *with_uncertainty(now["camera"][name], expanded[1]),
        *with_uncertainty(moved, whole),
        unit_of(name),
        fixed(normalised, 2),
        "pass" if abs(normalised) <= 1 else "marginal",
    )


def _over_sensor(found: ChangeData | None) -> str:
    if not found:
        return ""
    column, row = found["at_px"]
    return (
        f"Over the sensor, the same direction is projected {number(found['rms_px'], 2)} px (RMS) and at most "
        f"{number(found['largest_px'], 2)} px apart. Compared with its expanded uncertainty, the change is largest at "
        f"column {exact(round(column))}, row {exact(round(row))}: {_times_u(found)}."
    )


def _times_u(found: ChangeData) -> str:
    return f"{number(found['px_there'], 2)} px = {number(found['largest_ratio'], 2)} U"
