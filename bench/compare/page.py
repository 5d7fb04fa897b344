"""The page of a comparison: one HTML file without scripts and without files beside it."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence

import numpy as np

from bench import __version__
from bench.compare.methods import Row, SolvedRow, solved
from bench.compare.spec import STAR_METHODS
from bench.compare.table import (
    DATA_HEADS,
    HEADS,
    PARAMETERS,
    ColumnSummary,
    Summary,
    data_rows,
    parameter_rows,
    table_rows,
)
from bench.report.html import environment
from bench.report.svg_plot import INK, MUTED, POSE_COLOURS, Key, Picture, Words, axes_in
from bench.report.svg_scale import Scale, decades, plain

_WIDTH = 760.0
_ROW_HEIGHT = 19.5
_MARGIN = 46.0
_JITTER = 0.26
_LINEAR_PX = 5.0
_FINE_UP_TO, _SMALLEST_TICK = 300.0, 0.1
_LINES_HEIGHT, _FEWEST_POINTS = 290.0, 3
_BESIDE = 0.04
"""Room at each end of an axis, as a share of its length."""
_DASHES = ("", "6 2", "2 2", "8 2 2 2", "1 2", "10 3")
"""Dashes tell lines apart where colours do not."""

_COLOUR_OF = dict(
    zip(
        ("starbench", "recipe", "zhang", "checkerboard", "reconstruction", "angles"),
        POSE_COLOURS,
        strict=True,
    )
)
"""Colours of the methods."""


def direction_plot(columns: Mapping[str, str], rows: Mapping[str, Sequence[Row]]) -> str:
    """Draw the error of direction of each repetition, on a logarithmic scale, columns from top to bottom."""
    values = [_distances(solved(rows[name])) for name in columns]
    return _dots(
        columns,
        values,
        "error of direction, rms over the sensor, µrad",
        identifier="direction",
        label="Error of direction of every repetition of each column, in microradians, on a logarithmic scale",
        logarithmic=True,
    )


def focal_plot(columns: Mapping[str, str], rows: Mapping[str, Sequence[Row]]) -> str:
    """Draw the error of fx of each repetition, with the mean expanded uncertainty that the method states."""
    chosen = [solved(rows[name]) for name in columns]
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


def images_plot(columns: Sequence[ColumnSummary]) -> str:
    """Draw the error of direction against the number of images, one line for alike columns, as SVG."""
    series = _by_images(columns)
    if not series:
        return ""
    every = [error for points in series.values() for _, error in points]
    counts = sorted({images for points in series.values() for images, _ in points})
    keys = [
        Key(name, POSE_COLOURS[place % len(POSE_COLOURS)], "dashed" if place % len(_DASHES) else "line")
        for place, name in enumerate(series)
    ]
    label = "Error of direction by the number of images, both on logarithmic scales"
    parts = (f"{name}: {points[0][1]:.3g} to {points[-1][1]:.3g} µrad" for name, points in series.items())
    picture = Picture(_WIDTH, _LINES_HEIGHT + 13.0 * len(series) / 2, "images", label, "; ".join(parts) + ".")
    low, high = _longer(counts[0], counts[-1])
    across = Scale(low, high, "log", ticks=_labelled(counts))
    words = Words((), "images", "error of direction, rms, µrad", keys)
    axes = axes_in(picture, across, _log_scale(min(every), max(every)), words, grid="xy")
    for place, (key, points) in enumerate(zip(keys, series.values(), strict=True)):
        axes.line(points, key.colour, 1.4, dash=_DASHES[place % len(_DASHES)])
        axes.dots(points, key.colour, 5.0)
    return picture.svg()


def _longer(low: float, high: float) -> tuple[float, float]:
    """Return the ends of a logarithmic axis, a little beyond the values."""
    factor = max(high / low, 1.2) ** _BESIDE
    return low / factor, high * factor


def _by_images(columns: Sequence[ColumnSummary]) -> dict[str, list[tuple[int, float]]]:
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


def _distances(rows: Sequence[SolvedRow]) -> list[float]:
    return [row["direction_rms_urad"] for row in rows if row["direction_rms_urad"] is not None]


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
    largest = max((abs(each) for some in values for each in some), default=1.0)
    smallest = min((abs(each) for some in values for each in some if each), default=0.1 * largest)
    rows = [(place, name) for place, name in enumerate(columns)]
    across = _log_scale(smallest, largest) if logarithmic else _two_sided_scale(values, bands or [])
    counts = (f"{name}: {len(some)}" for name, some in zip(columns, values, strict=True))
    about = f"Repetitions: {', '.join(counts)}."
    picture = Picture(_WIDTH, _ROW_HEIGHT * len(columns) + _MARGIN, identifier, label, about)
    axes = axes_in(picture, across, Scale(len(columns) - 0.4, -0.6, ticks=rows), Words((), axis), grid="x")
    if not logarithmic:
        axes.upright(0.0, MUTED)
    rng = np.random.default_rng(0)
    for place, (some, method) in enumerate(zip(values, columns.values(), strict=True)):
        if bands is not None and np.isfinite(bands[place]):
            axes.rectangle((-bands[place], bands[place]), (place - 0.36, place + 0.36), POSE_COLOURS[0], 0.13)
        height = place + _JITTER * rng.uniform(-1, 1, len(some))
        axes.dots(np.column_stack([some, height]), _COLOUR_OF[method], 3.2, 0.75)
        if logarithmic and len(some):
            middle = float(np.sqrt(np.mean(np.square(some))))
            axes.line([(middle, place - 0.36), (middle, place + 0.36)], INK, 1.4)
    return picture.svg()


def _labelled(values: Sequence[float]) -> list[tuple[float, str]]:
    return [(value, plain(value)) for value in values]


def _log_scale(smallest: float, largest: float) -> Scale:
    """Return a logarithmic axis with ticks at 1, 2, 5, 10, 20, ..., at powers of ten for large values; from 0.1 on."""
    low, high = _longer(smallest, largest)
    digits = (1, 2, 5) if largest <= _FINE_UP_TO else (1,)
    ticks = decades(max(low, _SMALLEST_TICK), high, digits) if high >= _SMALLEST_TICK else []
    return Scale(low, high, "log", ticks=_labelled(ticks))


def _two_sided_scale(values: Sequence[Sequence[float]], bands: Sequence[float]) -> Scale:
    """Return an axis that is linear near zero, logarithmic beyond, and shows all values and bands."""
    every = [each for some in values for each in some]
    every += [end for half in bands if np.isfinite(half) for end in (-half, half)]
    low, high = (1.15 * end for end in (min(every, default=-1.0), max(every, default=1.0)))
    low, high = min(low, -0.2 * _LINEAR_PX), max(high, 0.2 * _LINEAR_PX)
    steps = [_LINEAR_PX * 10.0**power for power in range(7)]
    marks = [value for value in (*(-step for step in reversed(steps)), 0.0, *steps) if low <= value <= high]
    return Scale(low, high, "symlog", _LINEAR_PX, _labelled(marks))


# What the paper prints for its one real camera: Table 1 of arXiv:2512.16092.

PAPER_NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "reprojection error, px", "images")

PAPER_TABLE_1: tuple[tuple[str, tuple[str, ...]], ...] = (
    (
        "paper: Prophesee toolbox, checkerboard on a screen",
        ("3365.18", "3364.93", "633.21", "362.05", "0.65", "-1.39", "0.45", "20"),
    ),
    (
        "paper: MATLAB toolbox, the same images",
        ("3337.61", "3337.25", "624.07", "369.07", "-0.07", "5.43", "0.41", "20"),
    ),
    (
        "paper: Zhang, collimator",
        ("3412.76", "3412.75", "647.06", "366.26", "0.06", "-0.08", "0.10", "3"),
    ),
    (
        "paper: its own method, the same images",
        ("3345.06", "3345.27", "642.10", "363.32", "0.06", "-0.90", "0.08", "3"),
    ),
)
"""Rows of the table: the method, and its values in the order of `PAPER_NAMES`."""


TABLE_1 = "Table 1"
"""Name of the comparison that makes the paper's Table 1 again; its page shows the paper's numbers as well."""


def render_page(summary: Summary, rows: Mapping[str, Sequence[Row]], true: Mapping[str, float]) -> str:
    """Render the page of a comparison from its summary and rows, and the true values of the camera."""
    simulated = [column for column in summary["columns"] if not column["settings"]["data"]]
    methods = {column["settings"]["name"]: column["settings"]["method"] for column in simulated}
    drawn = {name: method for name, method in methods.items() if solved(rows[name])}
    failures = [
        (column["settings"]["name"], failed["times"], failed["why"])
        for column in summary["columns"]
        for failed in column["failed"]
    ]
    return (
        environment()
        .get_template("comparison.html.j2")
        .render(
            summary=summary,
            heads=HEADS,
            simulated=bool(simulated),
            data_heads=DATA_HEADS,
            data_table=data_rows(summary),
            paper_names=PAPER_NAMES,
            paper=PAPER_TABLE_1 if summary["name"] == TABLE_1 else (),
            by_images=images_plot(simulated),
            table=table_rows(summary),
            begins=_begins_group(simulated),
            parameters=PARAMETERS,
            values=parameter_rows(summary, PARAMETERS),
            truth=[f"{true[name]:g}" if name in true else "-" for name in PARAMETERS],
            failures=failures,
            direction=direction_plot(drawn, rows) if drawn else "",
            focal=focal_plot(drawn, rows) if drawn else "",
            software=__version__,
        )
    )


def _begins_group(columns: Sequence[ColumnSummary]) -> list[bool]:
    """Return for each column whether it has another kind of target or another collimator than the one before."""
    kinds = []
    for column in columns:
        settings = column["settings"]
        stars = settings["method"] in STAR_METHODS and settings["method"] != "angles"
        kinds.append(settings["collimator"] if stars else settings["method"])
    return [number > 0 and kind != kinds[number - 1] for number, kind in enumerate(kinds)]
