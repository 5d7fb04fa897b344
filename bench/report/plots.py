"""Plots of residuals, coverage and deviations, as SVG that is the same for the same data.

If there are many stars, a part of them is drawn (`thinned`); every number and line in a plot is computed from all of
them. Depends on Matplotlib and arrays, on no results file. Text in a plot stays text, so that a reader can search it
and it takes the page's typeface. The output depends neither on the date nor on Matplotlib's global state.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from textwrap import shorten

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
from numpy.typing import NDArray

from bench.report.drawing import (
    INK,
    MUTED,
    PANEL,
    POSE_COLOURS,
    SENSOR_PANEL,
    STYLE,
    WIDE,
    hide_frame,
    sensor,
    shade_unsupported,
    strokes,
    to_svg,
)
from bench.report.view_picture import ViewPicture, thinned

Array = NDArray[np.float64]

_REGIONS = (4, 3)
_CLOUD_PERCENTILE = 99.5


def residual_vectors(views: Sequence[ViewPicture], image_size: tuple[int, int]) -> str:
    """Draw the residual vector of each star at its place on the sensor, magnified by the factor that the plot states.

    Parameters
    ----------
    views
        Poses of the report, with at least one star.
    image_size
        Width and height, px.

    Returns
    -------
    str
        SVG.
    """
    lengths = np.concatenate([np.linalg.norm(view.residuals, axis=1) for view in views])
    magnification = _round_down(image_size[0] / 28 / max(float(np.percentile(lengths, 95)), 1e-6))
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDE, WIDE * image_size[1] / image_size[0] + 0.42), layout="constrained")
        axes = figure.add_subplot()
        for colour, detected, residuals in _by_colour(thinned(views)):
            strokes(axes, detected, detected, colour, 2.6)
            strokes(axes, detected, detected + magnification * residuals, colour, 1.0)
        sensor(axes, image_size)
        _legend(axes, views)
        _scale_bar(axes, image_size, magnification)
        return to_svg(figure, "vectors", "Residual vectors on the sensor")


def residual_cloud(views: Sequence[ViewPicture]) -> str:
    """Draw the residuals around zero.

    Parameters
    ----------
    views
        Poses of the report, with at least one star.

    Returns
    -------
    str
        SVG.
    """
    lengths, limit = _lengths(views)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=PANEL, layout="constrained")
        axes = figure.add_subplot()
        for colour, _, shown in _by_colour(thinned(views)):
            within = np.linalg.norm(shown, axis=1) <= limit
            strokes(axes, shown[within], shown[within], colour, 2.2, alpha=0.6)
        rms = float(np.sqrt(np.mean(lengths**2)))
        axes.add_patch(Circle((0, 0), rms, fill=False, edgecolor=INK, linewidth=1.0))
        axes.set(
            xlim=(-limit, limit), ylim=(limit, -limit), aspect="equal", xlabel="column, px", ylabel="row, px"
        )
        axes.set_title("Residuals; the circle is their RMS length")
        hide_frame(axes)
        return to_svg(figure, "cloud", "Residuals around zero")


def residual_radial(views: Sequence[ViewPicture], principal_point: tuple[float, float]) -> str:
    """Draw the lengths of the residuals against the distance from the principal point.

    Parameters
    ----------
    views
        Poses of the report, with at least one star.
    principal_point
        cx and cy, px.

    Returns
    -------
    str
        SVG.
    """
    lengths, limit = _lengths(views)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=PANEL, layout="constrained")
        axes = figure.add_subplot()
        for colour, detected, shown in _by_colour(thinned(views)):
            points = np.column_stack(
                [np.linalg.norm(detected - principal_point, axis=1), np.linalg.norm(shown, axis=1)]
            )
            points = points[points[:, 1] <= limit]
            strokes(axes, points, points, colour, 2.2, alpha=0.6)
        radius = np.concatenate([np.linalg.norm(view.detected - principal_point, axis=1) for view in views])
        _running_rms(axes, radius, lengths)
        axes.set(xlim=(0, radius.max() * 1.03), ylim=(0, limit), ylabel="length, px")
        axes.set_xlabel("distance from the principal point, px")
        axes.set_title("Length of the residuals; the line is their RMS")
        hide_frame(axes)
        return to_svg(figure, "radial", "Residuals against the distance from the principal point")


def _lengths(views: Sequence[ViewPicture]) -> tuple[Array, float]:
    """Return the lengths of all residuals, and the largest length that is drawn, px."""
    lengths = np.concatenate([np.linalg.norm(view.residuals, axis=1) for view in views])
    return lengths, 1.15 * max(float(np.percentile(lengths, _CLOUD_PERCENTILE)), 1e-6)


def coverage(
    views: Sequence[ViewPicture], image_size: tuple[int, int], principal_point: tuple[float, float]
) -> str:
    """Draw the stars on the sensor, and the part of it that they support.

    Parameters
    ----------
    views
        Poses of the report, with at least one star.
    image_size
        Width and height, px.
    principal_point
        cx and cy, px.

    Returns
    -------
    str
        SVG.
    """
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=SENSOR_PANEL, layout="constrained")
        axes = figure.add_subplot()
        axes.set_facecolor("#eef3f8")
        for colour, detected, _ in _by_colour(thinned(views)):
            strokes(axes, detected, detected, colour, 2.2)
        share = shade_unsupported(axes, np.concatenate([view.detected for view in views]), image_size)
        axes.plot(*principal_point, marker="+", markersize=13, markeredgewidth=1.6, color=INK)
        axes.set_title(f"Stars; they support {100 * share:.0f} % of the sensor (blue)")
        sensor(axes, image_size)
        return to_svg(figure, "coverage", "Stars on the sensor, and the part that they support")


def regions(views: Sequence[ViewPicture], image_size: tuple[int, int]) -> str:
    """Draw the RMS residual and the number of stars for each region of the sensor.

    Parameters
    ----------
    views
        Poses of the report, with at least one star.
    image_size
        Width and height, px.

    Returns
    -------
    str
        SVG.
    """
    points = np.concatenate([view.detected for view in views])
    squares = np.sum(np.concatenate([view.residuals for view in views]) ** 2, axis=1)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=SENSOR_PANEL, layout="constrained")
        axes = figure.add_subplot()
        _region_map(axes, points, squares, image_size)
        axes.set_title("RMS residual, px, and number of stars")
        sensor(axes, image_size)
        return to_svg(figure, "regions", "Residuals and number of stars by region")


def deviations_from_truth(names: Sequence[str], error_sigmas: Sequence[float]) -> str:
    """Draw the deviation of each value from the truth, in units of its standard uncertainty.

    Parameters
    ----------
    names
        Names of the parameters.
    error_sigmas
        For each parameter: value minus truth, divided by the standard uncertainty.

    Returns
    -------
    str
        SVG.
    """
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(PANEL[0], 0.6 + 0.22 * len(names)), layout="constrained")
        axes = figure.add_subplot()
        for inner, colour in ((2.0, "#eef3f8"), (1.0, "#dbe6f0")):
            axes.axvspan(-inner, inner, color=colour, linewidth=0)
        axes.axvline(0, color=MUTED, linewidth=0.8)
        rows = np.arange(len(names))
        axes.plot(error_sigmas, rows, linestyle="none", marker="o", markersize=5, color=POSE_COLOURS[0])
        reach = max(3.2, 1.15 * float(np.abs(error_sigmas).max()))
        axes.set(xlim=(-reach, reach), ylim=(len(names) - 0.4, -0.6), yticks=rows, yticklabels=list(names))
        axes.set_xlabel("(value \N{MINUS SIGN} truth) / u; shaded: within 1 and 2")
        hide_frame(axes)
        axes.tick_params(axis="y", length=0, labelcolor=INK)
        return to_svg(figure, "truth", "Deviations from the truth in standard uncertainties")


def _by_colour(views: Sequence[ViewPicture]) -> Iterator[tuple[str, Array, Array]]:
    """Yield each colour with the stars and the residuals of all poses that have this colour."""
    for number, colour in enumerate(POSE_COLOURS):
        if alike := views[number :: len(POSE_COLOURS)]:
            yield (
                colour,
                np.concatenate([view.detected for view in alike]),
                np.concatenate([view.residuals for view in alike]),
            )


def _legend(axes: Axes, views: Sequence[ViewPicture]) -> None:
    if len(views) > len(POSE_COLOURS):
        return
    for number, view in enumerate(views):
        axes.plot(
            [],
            [],
            color=POSE_COLOURS[number],
            linewidth=2.5,
            label=shorten(view.name, 28, placeholder="\N{HORIZONTAL ELLIPSIS}"),
        )
    axes.legend(loc="lower left", bbox_to_anchor=(0, 1.0), ncols=len(views), frameon=False, borderaxespad=0.2)


def _scale_bar(axes: Axes, image_size: tuple[int, int], magnification: float) -> None:
    length_px = _round_down(image_size[0] / 14 / magnification)
    right, above = image_size[0] - 0.5, -0.022 * image_size[1]
    left = right - length_px * magnification
    axes.plot([left, right], [above, above], color=INK, linewidth=1.6, clip_on=False, solid_capstyle="butt")
    text = f"{length_px:g} px, magnified {magnification:g} times"
    axes.text(left - 8, above, text, ha="right", va="center", fontsize=8.5)


def _running_rms(axes: Axes, radius: Array, lengths: Array) -> None:
    order = np.argsort(radius, kind="stable")
    groups = [group for group in np.array_split(order, max(1, min(14, len(order) // 12))) if len(group)]
    middle = [float(radius[group].mean()) for group in groups]
    rms = [float(np.sqrt(np.mean(lengths[group] ** 2))) for group in groups]
    axes.plot(middle, rms, color=INK, linewidth=1.6)


def _region_map(axes: Axes, points: Array, squares: Array, image_size: tuple[int, int]) -> None:
    columns, rows = _REGIONS
    width, height = image_size[0] / columns, image_size[1] / rows
    column = np.clip((points[:, 0] / width).astype(int), 0, columns - 1)
    row = np.clip((points[:, 1] / height).astype(int), 0, rows - 1)
    whole = float(np.sqrt(squares.mean()))
    for i in range(columns):
        for j in range(rows):
            inside = squares[(column == i) & (row == j)]
            rms = float(np.sqrt(inside.mean())) if len(inside) else 0.0
            shade = mpl.colormaps["Blues"](min(0.65, 0.28 * rms / whole)) if len(inside) else "#ffffff"
            axes.add_patch(
                Rectangle(
                    (i * width - 0.5, j * height - 0.5), width, height, facecolor=shade, edgecolor="white"
                )
            )
            text = f"{rms:.3f}\n{len(inside)}" if len(inside) else "none"
            axes.text((i + 0.5) * width, (j + 0.5) * height, text, ha="center", va="center", linespacing=1.5)


def _round_down(value: float) -> float:
    """Round down to 1, 2 or 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(step for step in (1, 2, 5) if step * power <= value * (1 + 1e-9)) * power)
