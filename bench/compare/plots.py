"""Plots of a comparison: errors of direction and of the focal length of every repetition, column by column."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from bench.report.drawing import INK, LINE, MUTED, POSE_COLOURS, STYLE, WIDE, hide_frame, to_svg

Row = Mapping[str, Any]

_ROW_HEIGHT = 0.27
_MARGIN = 0.85
_JITTER = 0.26
_LINEAR_PX = 5.0
_FINE_UP_TO = 300.0
_LINES_HEIGHT, _FEWEST_POINTS = 4.2, 3
_MARKS = ("o", "s", "D", "^", "v", "P")


_COLOUR_OF = dict(
    zip(
        ("starbench", "recipe", "zhang", "checkerboard", "reconstruction", "angles"),
        POSE_COLOURS,
        strict=True,
    )
)
"""Colours of the methods."""


def direction_plot(columns: Mapping[str, str], rows: Sequence[Row]) -> str:
    """Draw the error of direction of each repetition, on a logarithmic scale.

    Parameters
    ----------
    columns
        Method by name of the column, from top to bottom.
    rows
        All rows.

    Returns
    -------
    str
        SVG.
    """
    values = [[row["direction_rms_urad"] for row in _solved(rows, name)] for name in columns]
    return _dots(
        columns,
        values,
        "error of direction, rms over the sensor, µrad",
        identifier="direction",
        label="Error of direction of every repetition of each column, in microradians, on a logarithmic scale",
        logarithmic=True,
    )


def focal_plot(columns: Mapping[str, str], rows: Sequence[Row]) -> str:
    """Draw the error of fx of each repetition, with the mean expanded uncertainty that the method states.

    Parameters
    ----------
    columns
        Method by name of the column, from top to bottom.
    rows
        All rows.

    Returns
    -------
    str
        SVG.
    """
    chosen = [_solved(rows, name) for name in columns]
    values = [[row["errors"]["fx"] for row in some] for some in chosen]
    stated = [
        float(np.mean([row["k"] * row["sigma"]["fx"] for row in some if "fx" in row["sigma"]] or [np.nan]))
        for some in chosen
    ]
    return _dots(
        columns,
        values,
        "error of fx, px (band: stated expanded uncertainty)",
        identifier="focal",
        label="Error of the focal length of every repetition of each column, in pixels, with the stated uncertainty",
        bands=stated,
    )


def images_plot(columns: Sequence[Mapping[str, Any]]) -> str:
    """Draw the error of direction against the number of images, a line for columns that differ in nothing else.

    Parameters
    ----------
    columns
        Columns of the summary, from `bench.compare.summary.summarise`.

    Returns
    -------
    str
        SVG; empty if no line has three points.
    """
    series = _by_images(columns)
    if not series:
        return ""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDE, _LINES_HEIGHT), layout="constrained")
        axes = figure.add_subplot()
        for place, (name, points) in enumerate(series.items()):
            images, errors = zip(*points, strict=True)
            colour, mark = POSE_COLOURS[place % len(POSE_COLOURS)], _MARKS[place % len(_MARKS)]
            axes.plot(images, errors, color=colour, marker=mark, markersize=5, linewidth=1.4, label=name)
        axes.set_xscale("log")
        axes.set_yscale("log")
        counts = sorted({images for points in series.values() for images, _ in points})
        axes.set_xticks(counts)
        every = [error for points in series.values() for _, error in points]
        axes.set_yticks([step for step in _decades(max(every)) if step >= 0.5 * min(every)])
        axes.minorticks_off()
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.grid(color=LINE, linewidth=0.6)
        axes.set_xlabel("images")
        axes.set_ylabel("error of direction, rms, µrad")
        figure.legend(loc="outside lower center", ncols=2, frameon=False, labelcolor=INK)
        hide_frame(axes)
        return to_svg(
            figure, "images", "Error of direction by the number of images, both on logarithmic scales"
        )


def _by_images(columns: Sequence[Mapping[str, Any]]) -> dict[str, list[tuple[int, float]]]:
    """Return for each group of at least three columns, which differ in name and number of images only, its points."""
    groups: dict[str, list[tuple[int, float]]] = {}
    names: dict[str, str] = {}
    for column in columns:
        settings = dict(column["settings"])
        error = column.get("direction_rms_urad")
        if error is None:
            continue
        name, images = settings.pop("name"), settings.pop("images")
        key = json.dumps(settings, sort_keys=True)
        names.setdefault(key, re.sub(r",? *\d+( images?)?$", "", name))
        groups.setdefault(key, []).append((images, error))
    return {names[key]: sorted(points) for key, points in groups.items() if len(points) >= _FEWEST_POINTS}


def _solved(rows: Sequence[Row], name: str) -> list[Row]:
    """Return the rows of a column that have a result."""
    return [row for row in rows if row["column"] == name and "error" not in row]


def _dots(
    columns: Mapping[str, str],
    values: Sequence[Sequence[float]],
    axis: str,
    *,
    identifier: str,
    label: str,
    logarithmic: bool = False,
    bands: Sequence[float] | None = None,
) -> str:
    """Draw one line of dots for each column."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDE, _ROW_HEIGHT * len(columns) + _MARGIN), layout="constrained")
        axes = figure.add_subplot()
        rng = np.random.default_rng(0)
        for place, (some, method) in enumerate(zip(values, columns.values(), strict=True)):
            if bands is not None and np.isfinite(bands[place]):
                axes.barh(place, 2 * bands[place], left=-bands[place], height=0.72, color="#e3edf5", zorder=1)
            height = place + _JITTER * rng.uniform(-1, 1, len(some))
            colour = _COLOUR_OF[method]
            axes.scatter(some, height, s=9, color=colour, alpha=0.75, linewidths=0, zorder=3)
            if logarithmic and len(some):
                middle = float(np.sqrt(np.mean(np.square(some))))
                axes.plot([middle, middle], [place - 0.36, place + 0.36], color=INK, linewidth=1.4, zorder=4)
        axes.set_yticks(range(len(columns)), list(columns))
        axes.set_ylim(len(columns) - 0.4, -0.6)
        axes.tick_params(axis="y", length=0, labelcolor=INK)
        axes.grid(axis="x", color=LINE, linewidth=0.6, zorder=0)
        largest = max((abs(each) for some in values for each in some), default=1.0)
        if logarithmic:
            axes.set_xscale("log")
            axes.set_xticks(_decades(largest))
        else:
            axes.axvline(0.0, color=MUTED, linewidth=0.8, zorder=2)
            axes.set_xscale("symlog", linthresh=_LINEAR_PX)
            steps = [
                _LINEAR_PX * 10.0**power for power in range(5) if _LINEAR_PX * 10.0**power <= 2.5 * largest
            ]
            axes.set_xticks([-step for step in reversed(steps)] + [0.0, *steps])
        axes.minorticks_off()
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}".replace("-", "\u2212")))
        axes.set_xlabel(axis)
        hide_frame(axes)
        return to_svg(figure, identifier, label)


def _decades(largest: float) -> list[float]:
    """Return 1, 2, 5, 10, 20, ... up to a number of the same size as the largest; 1, 10, 100, ... if that is many."""
    digits = (1, 2, 5) if largest <= _FINE_UP_TO else (1,)
    steps = [digit * 10.0**power for power in range(7) for digit in digits]
    return [step for step in steps if step <= (2.5 if len(digits) > 1 else 10.0) * largest]
