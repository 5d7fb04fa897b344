"""The verdict about charts in plain words. Pure: text from the numbers of `bench.history.chart_findings`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any

from bench.history.control_limits import SHEWHART_CHANCE
from bench.report.text import number, with_uncertainty

_DAYS_A_YEAR = 365.25
_NAMED = 3
_SCATTER_SIGMAS = 3.5

Json = Mapping[str, Any]


def slope_text(slope: Json, unit: str, per: str) -> str:
    """Return a slope with its expanded uncertainty.

    slope: ``value`` and ``expanded``.
    unit: Unit of the parameter; empty for a pure number.
    per: ``day``, ``hour``, ``year`` or ``°C``.

    Examples
    --------
    >>> slope_text({"value": 0.5, "expanded": 0.1}, "px", "day")
    '+0.50 ± 0.10 px per day'
    """
    factor = {"hour": 1.0 / 24.0, "year": _DAYS_A_YEAR}.get(per, 1.0)
    value, expanded = with_uncertainty(slope["value"] * factor, slope["expanded"] * factor)
    sign = "+" if slope["value"] > 0 else ""
    return f"{sign}{value} ± {expanded}{' ' if unit else ''}{unit} per {per}"


def time_unit(span_days: float) -> str:
    """Return the unit of time in which to state a slope.

    span_days: Time between the first and the last run, days.
    Returns: ``hour``, ``day`` or ``year``.
    """
    return "hour" if span_days < 2.0 else "day" if span_days < 120.0 else "year"


def name_slopes(chart: dict[str, Any], group: Json) -> None:
    """Add ``text`` to the slopes of a chart: the value with its uncertainty, in a unit of time that suits the runs."""
    per = time_unit(_span_days(group))
    for name, unit in (("per_day", per), ("per_c", "°C")):
        if chart["drift"][name] is not None:
            slope = chart["drift"][name]
            slope |= {"text": slope_text(slope, chart["unit"], unit), "per": unit}


def parameter_verdict(chart: Json, group: Json) -> str:
    """Say what a chart shows.

    chart: The parameter, with its ``state``.
    group: Its group, with ``runs``.
    """
    runs = len(chart["values"])
    if chart["state"] == "too few":
        return f"{_counted(runs, 'run')}: too few for limits (at least 5 are needed)."
    sentences = [_control(chart, group, runs), *_drifts(chart)]
    if group["level"] == "camera" and (ratio := excess_scatter(chart, runs)):
        sentences.append(
            f"The runs scatter {number(ratio, 2)} times as much as their stated uncertainties predict."
        )
    if chart["provisional"]:
        sentences.append(f"The limits come from {chart['baseline']} runs: provisional until there are 20.")
    return " ".join(sentences)


def excess_scatter(chart: Json, runs: int) -> float | None:
    """Return the Birge ratio of a chart if it is significantly above 1.

    If the uncertainties are right, its standard deviation is about 1 / sqrt(2 n) (Birge, Phys. Rev. 40 (1932) 207).

    Returns: The ratio; None if it exceeds 1 by less than 3.5 of its standard deviations.
    """
    ratio = chart["drift"]["scatter"]
    least = 1.0 + _SCATTER_SIGMAS / math.sqrt(2.0 * max(runs - 2, 1))
    return float(ratio) if ratio is not None and ratio > least else None


def _control(chart: Json, group: Json, runs: int) -> str:
    beyond, averages = chart["beyond"], chart["ewma"]["beyond"]
    low, high = (
        with_uncertainty(chart["lower"], chart["sigma"])[0],
        with_uncertainty(chart["upper"], chart["sigma"])[0],
    )
    within = f"{low} to {high}{' ' if chart['unit'] else ''}{chart['unit']}"
    if chart["state"] == "in control":
        return f"In control: all {runs} runs lie within {within}."
    parts = []
    if beyond:
        expected = number(SHEWHART_CHANCE * runs, 2)
        parts.append(
            f"{_counted(len(beyond), 'run')} of {runs} {'lies' if len(beyond) == 1 else 'lie'} outside {within}"
            f" ({_named(beyond, group)}); about {expected} by chance"
        )
    if averages:
        place = averages[0]
        parts.append(
            f"the moving average (EWMA) left its limits at {_named([place], group)}: the mean may have shifted"
        )
    lead = "Out of control" if chart["state"] == "out of control" else "Check, it may be chance"
    return f"{lead}: {'; '.join(parts)}."  # fmt: skip


def _drifts(chart: Json) -> list[str]:
    drift = chart["drift"]
    found = []
    for name, what in (("per_day", "time"), ("per_c", "temperature")):
        slope = drift[name]
        if slope is not None and slope["seen"]:
            chance = (
                f"p = {number(slope['p_adjusted'], 1)}" if slope["p_adjusted"] >= 1e-6 else "p < 0.000001"
            )
            found.append(f"It drifts with {what}: {slope['text']} ({chance}).")
    if found and not drift["separable"]:
        found.append(
            "Time and temperature changed together, so the runs do not show which of them is the cause."
        )
    tested = [
        what for name, what in (("per_day", "time"), ("per_c", "temperature")) if drift[name] is not None
    ]
    return found or ([f"No significant drift with {' or '.join(tested)}."] if tested else [])


def _span_days(group: Json) -> float:
    first, last = (datetime.fromisoformat(group["runs"][place]["begun_utc"]) for place in (0, -1))
    return (last - first).total_seconds() / 86400.0


def _named(places: Sequence[int], group: Json) -> str:
    names = [group["runs"][place]["run"] for place in places[:_NAMED]]
    return ", ".join(names) + (", ..." if len(places) > _NAMED else "")


def group_title(group: Json) -> str:
    """Return the heading of a group."""
    camera = f"Camera {group['serial'] or 'without a serial number'}, {group['camera_type']}"
    if group["level"] == "type":
        camera = f"Camera type {group['camera_type']}, {_counted(group['cameras'], 'camera')}"
    kind = "" if group["kind"] == "measured" else f"{group['kind'].upper()}: "
    return f"{kind}{camera}: {_counted(len(group['runs']), 'run')}"


def group_place(group: Json) -> str:
    """Return where and how the runs of a group were made."""
    parts = [f"Station {group['station'] or 'without a name'}"]
    parts += [group["bench"]] if group["bench"] else []
    parts += [f"collimator {group['collimator']}"] if group["collimator"] else []
    parts += [f"target {group['target']}"] if group["target"] else []
    return ", ".join([*parts, f"model {group['model']}"])


def group_verdict(group: Json) -> str:
    """Say in one or two sentences what the charts of a group show.

    group: The group, with the ``state`` of each parameter.
    """
    charts = group["parameters"]
    if group["state"] == "too few":
        return f"{_counted(len(group['runs']), 'run')}: too few for a verdict (at least 5 are needed)."
    wrong = [c["name"] for c in charts if c["state"] == "out of control"]
    check = [c["name"] for c in charts if c["state"] == "check"]
    drifting = [
        c["name"] for c in charts if any((c["drift"][s] or {}).get("seen") for s in ("per_day", "per_c"))
    ]
    sentences = []
    if wrong:
        sentences.append(f"Out of control: {', '.join(wrong)}.")
    if check:
        sentences.append(f"Beyond a limit, perhaps by chance: {', '.join(check)}.")
    if drifting:
        sentences.append(f"Significant drift: {', '.join(drifting)}.")
    if not wrong and not check:
        sentences.insert(0, "In control.")
    if not drifting:
        sentences.append("No significant drift.")
    return " ".join(sentences)


def _counted(count: int, what: str) -> str:
    return f"{count} {what}{'' if count == 1 else 's'}"
