"""Plots of a batch: the time of each run, and each parameter over time and against temperature.

Depends on Matplotlib and plain numbers; reads no file.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from datetime import datetime, timedelta, tzinfo
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from bench.report.drawing import INK, LINE, MUTED, POSE_COLOURS, STYLE, hide_frame, to_svg
from bench.report.text import unit_of

_K = 2.0
_WIDTH_IN, _ROW_IN = 11.6, 2.05
_COLUMNS = 3
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


class Bar(NamedTuple):
    """A bar of the timeline: one attempt at a run, with its job, begin, end and outcome."""

    job: str
    begun: datetime
    ended: datetime
    how: str


class Series(NamedTuple):
    """The values of one parameter in several runs.

    Attributes
    ----------
    name
        The parameter.
    values, sigmas
        Value of each run and its standard uncertainty, in the parameter's unit.
    mean, sigma
        Weighted mean of the values and its standard uncertainty.
    slope
        Change per hour or per degree Celsius, and whether it is significant; None if there is no slope.
    """

    name: str
    values: Sequence[float]
    sigmas: Sequence[float]
    mean: float
    sigma: float
    slope: tuple[float, bool] | None


def timeline(bars: Sequence[Bar], zone: tzinfo | None) -> str:
    """Draw when each run was in progress, one row for each job.

    Parameters
    ----------
    bars
        One bar for each attempt, at least one.
    zone
        Time zone of the axis; None for this computer's.

    Returns
    -------
    str
        SVG.
    """
    jobs = list(dict.fromkeys(bar.job for bar in bars))
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(_WIDTH_IN, 0.85 + 0.3 * len(jobs)), layout="constrained")
        axes = figure.add_subplot()
        first, last = min(bar.begun for bar in bars), max(bar.ended for bar in bars)
        least_s = max((last - first).total_seconds() / 500.0, 1.0)
        for bar in bars:
            width_s = max((bar.ended - bar.begun).total_seconds(), least_s)
            axes.barh(
                jobs.index(bar.job), width_s / 3600.0,
                left=_hours(bar.begun, first), height=0.62,
                color=END_COLOURS.get(bar.how, MUTED),
                edgecolor="white",
                linewidth=0.3 if width_s > 3 * least_s else 0.0,
            )  # fmt: skip
        axes.set(ylim=(len(jobs) - 0.4, -0.6), yticks=range(len(jobs)), yticklabels=jobs)
        axes.tick_params(axis="y", length=0, labelcolor=INK)
        axes.grid(axis="x", color=LINE, linewidth=0.6)
        axes.set_axisbelow(True)
        _clock(axes, first.astimezone(zone), _hours(last, first))
        shown = [how for how in END_COLOURS if any(bar.how == how for bar in bars)]
        axes.legend(
            handles=[Patch(color=END_COLOURS[how], label=how) for how in shown],
            loc="lower left", bbox_to_anchor=(0, 1.0), ncols=len(shown), frameon=False, borderaxespad=0.2,
            handlelength=1.0,
        )  # fmt: skip
        hide_frame(axes)
        axes.spines["left"].set_visible(False)
        return to_svg(figure, "timeline", "Time of each run")


def over_time(
    moments: Sequence[datetime], series: Sequence[Series], zone: tzinfo | None, identifier: str
) -> str:
    """Draw each parameter over time, with U = 2 u.

    Parameters
    ----------
    moments
        Begin of each run.
    series
        One series for each parameter; slopes are per hour.
    zone
        Time zone of the axis; None for this computer's.
    identifier
        Prefix of the ids in the SVG, unique on the page.

    Returns
    -------
    str
        SVG.
    """
    hours = np.array([_hours(moment, moments[0]) for moment in moments])
    return _panels(hours, series, identifier, begin=moments[0].astimezone(zone), label="")


def against_temperature(degrees_c: Sequence[float], series: Sequence[Series], identifier: str) -> str:
    """Draw each parameter against the camera's temperature, with U = 2 u.

    Parameters
    ----------
    degrees_c
        Temperature of the camera in each run, degrees Celsius.
    series
        One series for each parameter; slopes are per degree Celsius.
    identifier
        Prefix of the ids in the SVG, unique on the page.

    Returns
    -------
    str
        SVG.
    """
    return _panels(np.asarray(degrees_c), series, identifier, begin=None, label="camera, °C")


def _panels(
    x: NDArray[np.float64], series: Sequence[Series], identifier: str, *, begin: datetime | None, label: str
) -> str:
    """Draw one panel for each parameter; ``x`` is in hours after ``begin`` if there is one."""
    rows = math.ceil(len(series) / _COLUMNS)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(_WIDTH_IN, 0.45 + _ROW_IN * rows), layout="constrained")
        grid = figure.subplots(rows, _COLUMNS, squeeze=False, sharex=True)
        for axes, one in zip(grid.flat, series, strict=False):
            _panel(axes, x, one)
        for axes in list(grid.flat)[len(series) :]:
            axes.set_visible(False)
        for number, axes in enumerate(grid.flat):
            last_in_column = number + _COLUMNS >= len(series)
            axes.tick_params(axis="x", labelbottom=last_in_column)
            if last_in_column and label:
                axes.set_xlabel(label)
        if begin is not None:
            _clock(grid[0, 0], begin, float(x.max()))
        _key(figure)
        return to_svg(figure, identifier, "Parameters of the runs")


def _panel(axes: Axes, x: NDArray[np.float64], one: Series) -> None:
    values, expanded = np.asarray(one.values), _K * np.asarray(one.sigmas)
    unit = "" if unit_of(one.name) == "1" else f", {unit_of(one.name)}"
    axes.axhspan(one.mean - _K * one.sigma, one.mean + _K * one.sigma, color="#dbe6f0", linewidth=0)
    axes.axhline(one.mean, color=MUTED, linewidth=0.8)
    axes.errorbar(
        x, values, expanded, linestyle="none", marker="o", markersize=3.2, color=_POINT, ecolor=_POINT,
        elinewidth=0.9, alpha=0.85,
    )  # fmt: skip
    if one.slope is not None and one.slope[1]:
        weights = 1.0 / np.asarray(one.sigmas) ** 2
        middle = float(np.average(x, weights=weights))
        ends = np.array([x.min(), x.max()])
        axes.plot(ends, one.mean + one.slope[0] * (ends - middle), color=_LINE_COLOUR, linewidth=1.8)
    axes.set_title(f"{one.name}{unit}", fontweight="bold")
    low, high = float((values - expanded).min()), float((values + expanded).max())
    margin = 0.06 * max(high - low, 1e-12)
    axes.set_ylim(low - margin, high + margin)
    axes.ticklabel_format(axis="y", useOffset=False, style="plain")
    axes.grid(axis="y", color=LINE, linewidth=0.5)
    axes.set_axisbelow(True)
    hide_frame(axes)


def _key(figure: Figure) -> None:
    handles = [
        Line2D([], [], color=_POINT, marker="o", markersize=4, linewidth=0.9, label="one run, ± U (k = 2)"),
        Line2D([], [], color=MUTED, linewidth=0.8, label="weighted mean"),
        Patch(color="#dbe6f0", label="U of the mean"),
        Line2D(
            [],
            [],
            color=_LINE_COLOUR,
            linewidth=1.8,
            label="trend, if it exceeds 3.5 standard uncertainties",
        ),
    ]
    figure.legend(handles=handles, loc="outside upper left", ncols=4, frameon=False)


def _hours(moment: datetime, begin: datetime) -> float:
    return (moment - begin).total_seconds() / 3600.0


def _clock(axes: Axes, begin: datetime, last_h: float) -> None:
    """Label an axis of hours after a local time with times of day."""
    step_h = next((s for s in _STEPS_H if last_h / s <= _MOST_TICKS), 48.0)
    midnight = begin.replace(hour=0, minute=0, second=0, microsecond=0)
    since_h = _hours(begin, midnight)
    number = math.ceil((since_h - _BEFORE * last_h) / step_h)
    ticks_h = []
    while number * step_h - since_h <= last_h + 1e-9:
        ticks_h.append(number * step_h - since_h)
        number += 1
    axes.set_xticks(ticks_h or [0.0])
    shown = [begin + timedelta(hours=h) for h in ticks_h or [0.0]]
    axes.set_xticklabels([f"{moment + timedelta(seconds=30):%H:%M}" for moment in shown])


def bars_of(items: Sequence[Mapping[str, Any]]) -> list[Bar]:
    """Convert the items of a summary to the bars of the timeline.

    Parameters
    ----------
    items
        ``items`` of ``summary.json``.

    Returns
    -------
    list of Bar
        A bar for each attempt that has ended.
    """
    return [
        Bar(
            item["job"],
            datetime.fromisoformat(one["begun_utc"]),
            datetime.fromisoformat(one["ended_utc"]),
            one["how"],
        )
        for item in items
        for one in item["tries"]
    ]
