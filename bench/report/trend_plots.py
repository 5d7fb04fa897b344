"""Plots of a batch: the time of each run, and each parameter over time and against temperature."""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import datetime, timedelta, tzinfo
from textwrap import shorten

import numpy as np
from numpy.typing import NDArray

from bench.record.summaries import ItemData, PointData, TrendData
from bench.report.svg_plot import MUTED, POSE_COLOURS, Key, Picture, Place, Words, axes_in, write_legend
from bench.report.svg_scale import Scale
from bench.wording.parameters import unit_of

Array = NDArray[np.float64]

_K = 2.0
_WIDTH, _ROW, _GAP = 835.0, 150.0, 14.0
"""Width of a picture, height of a row of plots, and distance between plots, points."""
_COLUMNS = 3
_KEY_HEIGHT, _BAND_OPACITY = 24.0, 0.14
_MOST_TICKS = 8
_STEPS_H = (1 / 60, 1 / 30, 1 / 12, 1 / 6, 0.25, 0.5, 1, 2, 3, 6, 12, 24)
_BEFORE = 0.02
"""Share of the time span by which an axis may begin earlier, to show a round time of day."""
_POINT, _LINE_COLOUR = POSE_COLOURS[0], POSE_COLOURS[1]
END_COLOURS = {
    "finished": "#0072b2",
    "failed": "#d55e00",
    "died": "#d55e00",
    "hung": "#d55e00",
    "aborted": "#e69f00",
    "cut off": "#e69f00",
}
"""Colour of a run's bar for each outcome."""


def timeline(items: Sequence[ItemData], zone: tzinfo | None) -> str:
    """Draw when each run of summary.json was in progress, one row for each job; zone None is this computer's."""
    bars = [
        (
            item["job"],
            datetime.fromisoformat(one["begun_utc"]),
            datetime.fromisoformat(one["ended_utc"]),
            one["how"],
        )
        for item in items
        for one in item["tries"]
    ]
    if not bars:
        return ""
    jobs = list(dict.fromkeys(job for job, *_ in bars))
    shown_jobs = [shorten(job, 34, placeholder="\N{HORIZONTAL ELLIPSIS}") for job in jobs]
    first, last = min(begun for _, begun, _, _ in bars), max(ended for _, _, ended, _ in bars)
    span_h = max(_hours(last, first), 1 / 3600)
    ends = [how for *_, how in bars]
    shown = [how for how in END_COLOURS if how in ends]
    words = Words((), "", "", [Key(how, END_COLOURS[how], "box") for how in shown])
    counts = [f"{ends.count(how)} {how}" for how in shown]
    picture = Picture(
        _WIDTH, 46.0 + 20.0 * len(jobs), "timeline", "Time of each run", ", ".join(counts) + "."
    )
    across = Scale(-_BEFORE * span_h, (1 + _BEFORE) * span_h, ticks=_clock(first.astimezone(zone), span_h))
    rows = Scale(len(jobs) - 0.4, -0.6, ticks=list(enumerate(shown_jobs)))
    axes = axes_in(picture, across, rows, words, grid="x")
    for job, begun, ended, how in bars:
        begin, row = _hours(begun, first), jobs.index(job)
        end = begin + max(_hours(ended, begun), span_h / 500)
        axes.rectangle((begin, end), (row - 0.31, row + 0.31), END_COLOURS.get(how, MUTED))
    return picture.svg()


def over_time(
    runs: Sequence[PointData], trends: Sequence[TrendData], zone: tzinfo | None, identifier: str
) -> str:
    """Draw each parameter of a camera over time, with U = 2 u; ``zone`` None is this computer's."""
    moments = [datetime.fromisoformat(run["begun_utc"]) for run in runs]
    hours = np.array([_hours(moment, moments[0]) for moment in moments])
    return _panels(hours, runs, trends, identifier, begin=moments[0].astimezone(zone), label="")


def against_temperature(runs: Sequence[PointData], trends: Sequence[TrendData], identifier: str) -> str:
    """Draw each parameter of a camera against its temperature, degrees Celsius, with U = 2 u."""
    degrees_c = np.array([run["temperature_c"] for run in runs], float)
    return _panels(degrees_c, runs, trends, identifier, begin=None, label="camera, °C")


def _panels(
    x: NDArray[np.float64],
    runs: Sequence[PointData],
    trends: Sequence[TrendData],
    identifier: str,
    *,
    begin: datetime | None,
    label: str,
) -> str:
    """Draw one panel for each parameter; ``x`` is in hours after ``begin`` if there is one."""
    per = "°C" if begin is None else "h"
    fitted = [trend["per_c"] if begin is None else trend["per_hour"] for trend in trends]
    slopes = [one["value"] if one and one["seen"] else None for one in fitted]
    about = "; ".join(_about(*one, per) for one in zip(trends, slopes, strict=True)) + "."
    rows = math.ceil(len(trends) / _COLUMNS)
    picture = Picture(_WIDTH, _KEY_HEIGHT + _ROW * rows, identifier, "Parameters of the runs", about)
    low, high = float(x.min()), float(x.max())
    beside = 0.03 * (high - low) or 0.5
    marks = None if begin is None else _clock(begin, high)
    across = Scale(low - beside, high + beside, ticks=marks)
    width = _WIDTH / _COLUMNS
    _key(picture)
    for number, (trend, slope) in enumerate(zip(trends, slopes, strict=True)):
        row, column = divmod(number, _COLUMNS)
        place = (column * width, _KEY_HEIGHT + row * _ROW, width - _GAP, _ROW - _GAP / 2)
        words = Words((_titled(trend["name"]),), label)
        found = [run["parameters"][trend["name"]] for run in runs]
        points = np.array([x, [one["value"] for one in found], [one["sigma"] for one in found]])
        _panel(picture, place, across, words, points, trend, slope)
    return picture.svg()


def _titled(name: str) -> str:
    return name if unit_of(name) == "1" else f"{name}, {unit_of(name)}"


def _panel(
    picture: Picture,
    place: Place,
    across: Scale,
    words: Words,
    points: NDArray[np.float64],
    trend: TrendData,
    slope: float | None,
) -> None:
    """Draw the values of a parameter with bars, the weighted mean with its band, and the slope if it is significant.

    ``points``, (3, N), are the places, the values and their standard uncertainties.
    """
    x, values, sigmas = points
    expanded, mean = _K * sigmas, trend["mean"]
    low, high = float((values - expanded).min()), float((values + expanded).max())
    margin = 0.06 * max(high - low, 1e-12)
    up = Scale(low - margin, high + margin)
    axes = axes_in(picture, across, up, words, place=place, grid="y")
    half = _K * trend["sigma"]
    axes.rectangle((across.low, across.high), (mean - half, mean + half), _POINT, _BAND_OPACITY)
    axes.level(mean, MUTED)
    axes.strokes(
        np.column_stack([x, values - expanded]), np.column_stack([x, values + expanded]), _POINT, 0.9, 0.7
    )
    axes.dots(np.column_stack([x, values]), _POINT, 3.4)
    if slope is not None:
        middle = float(np.average(x, weights=1.0 / sigmas**2))
        ends = np.array([x.min(), x.max()])
        axes.line(np.column_stack([ends, mean + slope * (ends - middle)]), _LINE_COLOUR, 1.8)


def _key(picture: Picture) -> None:
    """Write the legend of all plots of a picture."""
    keys = [
        Key("one run, ± U (k = 2)", _POINT, "dot"),
        Key("weighted mean", MUTED),
        Key("U of the mean", "#cfe2ee", "box"),
        Key("trend, if it exceeds 3.5 standard uncertainties", _LINE_COLOUR),
    ]
    write_legend(picture, keys, 0.0, 0.0, picture.width)


def _about(trend: TrendData, slope: float | None, per: str) -> str:
    """Return the mean of a parameter, and its slope if that is significant."""
    found = f"{trend['name']}: mean {trend['mean']:.6g}"
    return found if slope is None else f"{found}, trend {slope:.2g} per {per}"


def _hours(moment: datetime, begin: datetime) -> float:
    return (moment - begin).total_seconds() / 3600.0


def _clock(begin: datetime, last_h: float) -> list[tuple[float, str]]:
    """Return the ticks of an axis of hours after a local time, labelled with times of day."""
    step_h = next((s for s in _STEPS_H if last_h / s <= _MOST_TICKS), 48.0)
    midnight = begin.replace(hour=0, minute=0, second=0, microsecond=0)
    since_h = _hours(begin, midnight)
    number = math.ceil((since_h - _BEFORE * last_h) / step_h)
    found = []
    while number * step_h - since_h <= last_h + 1e-9:
        found.append(number * step_h - since_h)
        number += 1
    return [(h, f"{begin + timedelta(hours=h, seconds=30):%H:%M}") for h in found or [0.0]]
