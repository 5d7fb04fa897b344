"""Plots of residuals, coverage and deviations, as SVG that is the same for the same data.

If there are many stars, a part of them is drawn (`thinned`); every number and line in a plot is computed from all of
them. Depends on Matplotlib and arrays, on no results file. Text in a plot stays text, so that a reader can search it
and it takes the page's typeface. The output depends neither on the date nor on Matplotlib's global state.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from textwrap import shorten

import cv2
import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, PathPatch, Polygon, Rectangle
from matplotlib.path import Path as Outline
from numpy.typing import NDArray

from bench.report.drawing import INK, LINE, MUTED, STYLE, hide_frame, to_svg
from bench.report.view_picture import ViewPicture, thinned
from calib.uncertainty.projection_uncertainty import CameraDifference, ProjectionMap

Array = NDArray[np.float64]

POSE_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
"""Colours of the poses, repeated after six: the palette of Okabe and Ito (2008), safe for colour-blind readers."""
_REGIONS = (4, 3)
_LEVELS = 8
_MESH = 4
"""Distance between two arrows, in grid points of the map."""
_CLOUD_PERCENTILE = 99.5


def uncertainty_contours(found: ProjectionMap, k: float, halves: CameraDifference | None = None) -> str:
    """Draw the expanded projection uncertainty over the sensor, in px and in arc seconds.

    If calibrations of two halves of the poses are given, a third panel shows the difference between their projections.

    Parameters
    ----------
    found
        Standard uncertainty of the projection on a grid over the sensor.
    k
        Coverage factor.
    halves
        Difference between the cameras of two halves of the poses.

    Returns
    -------
    str
        SVG.
    """
    maps = [(k * found.sigma_px, "U, px"), (k * found.sigma_arcsec, "U, arc seconds")]
    if halves:
        maps.append((np.linalg.norm(halves.offset_px, axis=2), "Difference of the halves, px"))
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(10.2, 3.5 if len(maps) == 2 else 2.75), layout="constrained")
        panels = figure.subplots(1, len(maps))
        for axes, (values, name) in zip(panels, maps, strict=True):
            _contours(axes, found.grid_px, values, name)
        if halves:
            _arrows(panels[-1], halves)
            for axes in panels[1:]:
                axes.set_ylabel("")
        return to_svg(figure, "uncertainty", "Projection uncertainty over the sensor")


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
        figure = Figure(figsize=(10.2, 10.2 * image_size[1] / image_size[0] + 0.45), layout="constrained")
        axes = figure.add_subplot()
        for colour, detected, residuals in _by_colour(thinned(views)):
            _strokes(axes, detected, detected, colour, 2.6)
            _strokes(axes, detected, detected + magnification * residuals, colour, 1.0)
        _sensor(axes, image_size)
        _legend(axes, views)
        _scale_bar(axes, image_size, magnification)
        return to_svg(figure, "vectors", "Residual vectors on the sensor")


def residual_cloud(views: Sequence[ViewPicture], principal_point: tuple[float, float]) -> str:
    """Draw the residuals around zero, and their lengths against the distance from the principal point.

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
    residuals = np.concatenate([view.residuals for view in views])
    lengths = np.linalg.norm(residuals, axis=1)
    limit = 1.15 * max(float(np.percentile(lengths, _CLOUD_PERCENTILE)), 1e-6)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(10.2, 3.9), layout="constrained")
        cloud, radial = figure.subplots(1, 2, width_ratios=(1, 1.55))
        for colour, detected, shown in _by_colour(thinned(views)):
            within = np.linalg.norm(shown, axis=1) <= limit
            _strokes(cloud, shown[within], shown[within], colour, 2.2, alpha=0.6)
            radius = np.linalg.norm(detected - principal_point, axis=1)
            points = np.column_stack([radius, np.linalg.norm(shown, axis=1)])[within]
            _strokes(radial, points, points, colour, 2.2, alpha=0.6)
        rms = float(np.sqrt(np.mean(lengths**2)))
        cloud.add_patch(Circle((0, 0), rms, fill=False, edgecolor=INK, linewidth=1.0))
        cloud.set(
            xlim=(-limit, limit), ylim=(limit, -limit), aspect="equal", xlabel="column, px", ylabel="row, px"
        )
        cloud.set_title("Residuals; the circle is their RMS length")
        radius = np.concatenate([np.linalg.norm(view.detected - principal_point, axis=1) for view in views])
        _running_rms(radial, radius, lengths)
        radial.set(
            xlim=(0, radius.max() * 1.03), ylim=(0, limit), xlabel="distance from the principal point, px"
        )
        radial.set_ylabel("length, px")
        radial.set_title("Length of the residuals; the line is their RMS at each distance")
        hide_frame(cloud)
        hide_frame(radial)
        return to_svg(
            figure, "cloud", "Residuals around zero, and against the distance from the principal point"
        )


def coverage(
    views: Sequence[ViewPicture], image_size: tuple[int, int], principal_point: tuple[float, float]
) -> str:
    """Draw the stars on the sensor with their convex hull, and RMS residual and number of stars for each region.

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
    points = np.concatenate([view.detected for view in views])
    squares = np.sum(np.concatenate([view.residuals for view in views]) ** 2, axis=1)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(10.2, 3.35), layout="constrained")
        stars, regions = figure.subplots(1, 2)
        hull = cv2.convexHull(points.astype(np.float32))[:, 0]
        stars.add_patch(Polygon(hull, facecolor="#eef3f8", edgecolor=LINE, linewidth=0.8))
        for colour, detected, _ in _by_colour(thinned(views)):
            _strokes(stars, detected, detected, colour, 2.4)
        stars.plot(*principal_point, marker="+", markersize=13, markeredgewidth=1.6, color=INK)
        share = float(cv2.contourArea(hull)) / (image_size[0] * image_size[1])
        stars.set_title(f"Stars; their convex hull covers {100 * share:.0f} % of the sensor")
        _sensor(stars, image_size)
        _region_map(regions, points, squares, image_size)
        regions.set_title("RMS residual, px, and number of stars by region")
        _sensor(regions, image_size)
        return to_svg(figure, "coverage", "Coverage of the sensor, and residuals by region")


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
        figure = Figure(figsize=(10.2, 0.55 + 0.27 * len(names)), layout="constrained")
        axes = figure.add_subplot()
        for inner, colour in ((2.0, "#eef3f8"), (1.0, "#dbe6f0")):
            axes.axvspan(-inner, inner, color=colour, linewidth=0)
        axes.axvline(0, color=MUTED, linewidth=0.8)
        rows = np.arange(len(names))
        axes.plot(error_sigmas, rows, linestyle="none", marker="o", markersize=6, color=POSE_COLOURS[0])
        reach = max(3.2, 1.15 * float(np.abs(error_sigmas).max()))
        axes.set(xlim=(-reach, reach), ylim=(len(names) - 0.4, -0.6), yticks=rows, yticklabels=list(names))
        axes.set_xlabel("(value \N{MINUS SIGN} truth) / standard uncertainty; shaded: within 1 and 2")
        hide_frame(axes)
        axes.tick_params(axis="y", length=0, labelcolor=INK)
        return to_svg(figure, "truth", "Deviations from the truth in standard uncertainties")


def _contours(axes: Axes, grid_px: Array, values: Array, name: str) -> None:
    """Draw a quantity over the sensor; the title has its median and its largest value."""
    x, y, shown = grid_px[..., 0], grid_px[..., 1], _to_digits(values, 6)
    worst, middle = float(np.nanmax(shown)), float(np.nanmedian(shown))
    levels = np.linspace(0, worst, _LEVELS + 1)
    axes.contourf(x, y, shown, levels=levels, colors=mpl.colormaps["Blues"](np.linspace(0.04, 0.6, _LEVELS)))
    lines = axes.contour(x, y, shown, levels=levels, colors=INK, linewidths=0.6)
    axes.clabel(lines, fmt=lambda level: f"{level:.2g}", fontsize=8.5)
    axes.set_title(f"{name}\nmedian {middle:.2g}, at most {worst:.2g}")
    _sensor(axes, (int(x.max()) + 1, int(y.max()) + 1))


def _arrows(axes: Axes, halves: CameraDifference) -> None:
    """Draw how the second half's camera shifts the image points of the first half's; the longest arrow is one mesh."""
    every = (slice(_MESH // 2, None, _MESH), slice(_MESH // 2, None, _MESH))
    begins, offsets = (
        halves.grid_px[every].reshape(-1, 2),
        _to_digits(halves.offset_px[every], 6).reshape(-1, 2),
    )
    seen = np.isfinite(offsets).all(axis=1)
    begins, offsets = begins[seen], offsets[seen]
    mesh_px = _MESH * float(halves.grid_px[0, 1, 0])
    longest = max(float(np.linalg.norm(offsets, axis=1).max()), 1e-12)
    _strokes(axes, begins, begins, POSE_COLOURS[1], 2.4)
    _strokes(axes, begins, begins + mesh_px / longest * offsets, POSE_COLOURS[1], 1.0)


def _by_colour(views: Sequence[ViewPicture]) -> Iterator[tuple[str, Array, Array]]:
    """Yield each colour with the stars and the residuals of all poses that have this colour."""
    for number, colour in enumerate(POSE_COLOURS):
        if alike := views[number :: len(POSE_COLOURS)]:
            yield (
                colour,
                np.concatenate([view.detected for view in alike]),
                np.concatenate([view.residuals for view in alike]),
            )


def _strokes(axes: Axes, begins: Array, ends: Array, colour: str, width: float, alpha: float = 1.0) -> None:
    """Draw many lines as one path, which keeps the file small; a line without length is a dot."""
    if not len(begins):
        return
    vertices = np.stack([begins, ends], axis=1).reshape(-1, 2)
    codes = np.tile([Outline.MOVETO, Outline.LINETO], len(begins))
    axes.add_patch(
        PathPatch(
            Outline(vertices, codes),
            fill=False,
            edgecolor=colour,
            linewidth=width,
            capstyle="round",
            alpha=alpha,
        )
    )


def _sensor(axes: Axes, image_size: tuple[int, int]) -> None:
    axes.set(xlim=(-0.5, image_size[0] - 0.5), ylim=(image_size[1] - 0.5, -0.5), aspect="equal")
    axes.set_xlabel("column, px")
    axes.set_ylabel("row, px")


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
    axes.text(left - 8, above, text, ha="right", va="center", fontsize=9.5)


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


def _to_digits(values: Array, digits: int) -> Array:
    """Round an array relative to its largest value, because its last bits differ between processes."""
    unit = 10.0 ** (np.ceil(np.log10(max(float(np.nanmax(values)), 1e-30))) - digits)
    return np.asarray(np.round(values / unit) * unit)


def _round_down(value: float) -> float:
    """Round down to 1, 2 or 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(step for step in (1, 2, 5) if step * power <= value * (1 + 1e-9)) * power)
