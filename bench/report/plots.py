"""Plots of residuals, coverage and deviations, and images of the poses, as SVG that is the same for the same data.

Only some of many stars are drawn (`thinned`); every number and line is computed from all of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from textwrap import shorten
from typing import Any

import numpy as np

from bench.measure.view_picture import ViewPicture
from bench.record.coverage import coverage_factor
from bench.record.results import Results
from bench.record.stored_calibration import camera_covariance, camera_of
from bench.report.distortion_plot import distortion_curve, field_angles_deg, outermost_deg
from bench.report.maps import GROUND, change_maps, sensor_axes, sensor_map, shade_unsupported, supported_share
from bench.report.pictured_poses import PLOTS, thinned
from bench.report.pose_scene import pose_scene
from bench.report.svg_plot import (
    INK,
    MUTED,
    PANEL,
    POSE_COLOURS,
    WIDE,
    Axes,
    Key,
    Picture,
    Words,
    axes_in,
    painted,
    shade,
)
from bench.report.svg_scale import Scale
from bench.wording.numbers import exact, number
from bench.wording.target_words import STARS, TargetWords, words_of
from calib.arrays import RAYLEIGH_MEDIAN, Array
from calib.model.result_parts import WORST_CORNER
from calib.uncertainty.projection_uncertainty import (
    URAD_PER_ARCSEC,
    camera_difference,
    projection_uncertainty,
)

_CLOUD_PERCENTILE = 99.5  # A few gross residuals must not make all others a dot
#: The joint adjustment halves the weight of a star at so many sigma of its residual (`calib.joint.equations`).
_FAR_SIGMAS = 3.5
_FAR = "beyond 3.5 sigma"  # a method of comparison may give all stars one weight
_REGIONS = (4, 3)  # Columns and rows, near the shape of sensors; each has stars enough for a mean
_WIDE_ANGLE_DEG = 25.0  # From here a pixel at the rim is a fifth less angle than in the middle: cos^2


def residual_vectors(
    views: Sequence[ViewPicture], image_size: tuple[int, int], words: TargetWords = STARS
) -> str:
    """Draw the residual vector of each star at its place on the sensor, magnified by the factor that is stated."""
    lengths = np.concatenate([np.linalg.norm(view.residuals, axis=1) for view in views])
    magnification = _round_down(image_size[0] / 28 / max(float(np.percentile(lengths, 95)), 1e-6))
    most = number(np.percentile(lengths, 95), 2)
    about = f"{len(lengths)} {words.points}; residuals of {most} px or less for 95 % of them."
    longest = _FAR_SIGMAS * float(np.median(lengths)) / RAYLEIGH_MEDIAN
    keys = [*_pose_keys(views), *([Key(_FAR, MUTED)] if (lengths > longest).any() else [])]
    axes = sensor_axes(
        image_size, (), "vectors", "Residual vectors on the sensor", about, width=WIDE, keys=keys
    )
    for colour, detected, residuals in _by_colour(thinned(views)):
        far = np.linalg.norm(residuals, axis=1) > longest
        ends = detected + magnification * residuals
        for shade_of, chosen in ((colour, ~far), (MUTED, far)):
            if chosen.any():
                axes.dots(detected[chosen], shade_of, 2.6)
                axes.strokes(detected[chosen], ends[chosen], shade_of, 1.0)
    _scale_bar(axes, image_size, magnification)
    return axes.picture.svg()


def residual_cloud(views: Sequence[ViewPicture]) -> str:
    """Draw the residuals around zero, a colour a pose (Fig. 3 of arXiv:2512.16092); the circle is their RMS length."""
    lengths = np.linalg.norm(np.concatenate([view.residuals for view in views]), axis=1)
    rms = float(np.sqrt(np.mean(lengths**2)))
    reach = 1.15 * max(float(np.percentile(lengths, _CLOUD_PERCENTILE)), 1e-6)
    words = Words(("Residuals around zero; circle: their RMS length",), "column, px", "row, px")
    about = f"Root mean square of the length: {number(rms, 3)} px."
    picture = Picture(PANEL[0], 1.1 * PANEL[0], "cloud", "Residuals around zero", about)
    axes = axes_in(picture, Scale(-reach, reach), Scale(reach, -reach), words, equal=True)
    for colour, _, residuals in _by_colour(thinned(views)):
        axes.dots(residuals[np.linalg.norm(residuals, axis=1) <= reach], colour, 2.2, 0.6)
    turn = np.radians(np.arange(0.0, 365.0, 5.0))
    axes.line(rms * np.column_stack([np.cos(turn), np.sin(turn)]), INK)
    return picture.svg()


def coverage(
    views: Sequence[ViewPicture],
    image_size: tuple[int, int],
    principal_point: tuple[float, float],
    words: TargetWords = STARS,
) -> str:
    """Draw the stars on the sensor, and the part of it that they support."""
    distance, share = supported_share(np.concatenate([view.detected for view in views]), image_size)
    title = f"{words.capital}; they are near {100 * share:.0f} % of the sensor (blue)"
    about = (
        f"{sum(len(view.detected) for view in views)} {words.points}, near {100 * share:.0f} % of the sensor."
    )
    label = f"{words.capital} on the sensor, and the part that they support"
    axes = sensor_axes(image_size, (title,), "coverage", label, about)
    axes.shapes([_whole(image_size)], GROUND)
    for colour, detected, _ in _by_colour(thinned(views)):
        axes.dots(detected, colour, 2.2)
    shade_unsupported(axes, distance, image_size)
    x, y = axes.at([principal_point])[0].tolist()
    axes.picture.add(
        f'<path d="M{x - 6.5:g} {y:g}h13M{x:g} {y - 6.5:g}v13" fill="none" stroke="{INK}" stroke-width="1.6"/>'
    )
    return axes.picture.svg()


def regions(views: Sequence[ViewPicture], image_size: tuple[int, int], words: TargetWords = STARS) -> str:
    """Draw the RMS residual and the number of stars for each region of the sensor."""
    points = np.concatenate([view.detected for view in views])
    squares = np.sum(np.concatenate([view.residuals for view in views]) ** 2, axis=1)
    whole = f"RMS residual of all {words.points} {number(np.sqrt(squares.mean()), 3)} px"
    about = f"{_REGIONS[0]} by {_REGIONS[1]} regions; {whole}."
    axes = sensor_axes(
        image_size, (f"RMS residual, px, and number of {words.points}",), "regions",
        f"Residuals and number of {words.points} by region", about,
    )  # fmt: skip
    _region_map(axes, points, squares, image_size)
    return axes.picture.svg()


def _by_colour(views: Sequence[ViewPicture]) -> Iterator[tuple[str, Array, Array]]:
    """Yield each colour with the stars and the residuals of all poses that have this colour."""
    for first, colour in enumerate(POSE_COLOURS):
        if alike := views[first :: len(POSE_COLOURS)]:
            yield (
                colour,
                np.concatenate([view.detected for view in alike]),
                np.concatenate([view.residuals for view in alike]),
            )


def _pose_keys(views: Sequence[ViewPicture]) -> list[Key]:
    """Return the legend of the poses, if each has a colour of its own."""
    if len(views) > len(POSE_COLOURS):
        return []
    names = (shorten(view.name, 28, placeholder="\N{HORIZONTAL ELLIPSIS}") for view in views)
    return [Key(name, colour) for name, colour in zip(names, POSE_COLOURS, strict=False)]


def _scale_bar(axes: Axes, image_size: tuple[int, int], magnification: float) -> None:
    """Draw a residual of a round length below the plot, at its right end."""
    length_px = _round_down(image_size[0] / 14 / magnification)
    right, y = axes.left + axes.width, axes.picture.height - 5.0
    left = right - axes.width * length_px * magnification / image_size[0]
    axes.picture.add(
        f'<path d="M{left:.2f} {y:g}H{right:g}" fill="none" {painted("stroke", INK)} stroke-width="1.6"/>'
    )
    text = f"{exact(length_px)} px, magnified {exact(magnification)} times"
    axes.picture.text(left - 5.0, y + 3.0, text, colour=INK, anchor="end")


def _whole(size: Sequence[float]) -> Array:
    """Return the corners of a sensor, or of a part of it at its upper left, with pixel centres at integers."""
    right, bottom = size[0] - 0.5, size[1] - 0.5
    return np.array([(-0.5, -0.5), (right, -0.5), (right, bottom), (-0.5, bottom)])


def _region_map(axes: Axes, points: Array, squares: Array, image_size: tuple[int, int]) -> None:
    columns, rows = _REGIONS
    width, height = image_size[0] / columns, image_size[1] / rows
    column = np.clip((points[:, 0] / width).astype(int), 0, columns - 1)
    row = np.clip((points[:, 1] / height).astype(int), 0, rows - 1)
    whole = float(np.sqrt(squares.mean()))
    for i, j in np.ndindex(columns, rows):
        inside = squares[(column == i) & (row == j)]
        rms = float(np.sqrt(inside.mean())) if len(inside) else 0.0
        colour = shade(0.55 * rms / max(whole, 1e-12)) if len(inside) else "#ffffff"
        cell = _whole((width, height)) + np.array([i * width, j * height])
        axes.shapes([cell], colour, edge="#ffffff")
        words = (f"{rms:.3f}", f"{len(inside)}") if len(inside) else ("none",)
        for line, text in enumerate(words):
            down = 3.2 + 12.0 * (line - (len(words) - 1) / 2)
            centre = ((i + 0.5) * width - 0.5, (j + 0.5) * height - 0.5)
            axes.text(centre, text, by=(0.0, down), anchor="middle", size=9.0, themed=False)


def _round_down(value: float) -> float:
    """Round down to 1, 2 or 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(step for step in (1, 2, 5) if step * power <= value * (1 + 1e-9)) * power)


def report_plots(results: Results, views: Sequence[ViewPicture]) -> dict[str, str]:
    """Draw all plots of a report, SVG by name, empty without data."""
    plots = dict.fromkeys(PLOTS, "")
    if not views:
        return plots
    seen = [view for view in views if len(view.detected)]
    k = coverage_factor(results["calibration"], WORST_CORNER)
    plots |= camera_plots(results, [view.detected for view in seen], k) | _change_plots(results)
    plots["scene"] = pose_scene(results["calibration"])
    if seen:
        plots |= star_plots(results, views)
    return plots


def star_plots(results: Results, views: Sequence[ViewPicture]) -> dict[str, str]:
    """Draw the residuals, and where the stars are; at least one pose has stars."""
    width, height = results["calibration"]["image_size"]
    camera = results["calibration"]["camera"]
    centre, words = (camera["cx"], camera["cy"]), words_of(results)
    return {
        "cloud": residual_cloud(views),
        "vectors": residual_vectors(views, (width, height), words),
        "coverage": coverage(views, (width, height), centre, words),
        "regions": regions(views, (width, height), words),
    }


def camera_plots(
    results: Results, stars: Sequence[Array], k: float, *, certificate: bool = False
) -> dict[str, str]:
    """Draw for a certificate what camera and covariance give, in arcsec, without labels for those who do not see it."""
    calibration = results["calibration"]
    covariance = camera_covariance(calibration["camera"], calibration.get("covariance"))
    if covariance is None:
        return {}
    camera = camera_of(calibration["camera"], calibration["image_size"])
    uncertainty, points = projection_uncertainty(camera, covariance), np.concatenate(stars) if stars else None

    def over_sensor(grid: Array, values: Array, name: str, identifier: str, label: str, **more: Any) -> str:
        return sensor_map(grid, values, name, identifier, "" if certificate else label, **more)

    plots = {
        "uncertainty": over_sensor(
            uncertainty.grid_px, k * uncertainty.sigma_px, "U of an image point, px", "uncertainty",
            "Uncertainty of an image point over the sensor", stars=points,
        ),
        "distortion": distortion_curve(camera, covariance, k, outermost_deg(camera, stars), words_of(results)),
    }  # fmt: skip
    if max(field_angles_deg(camera).values()) > _WIDE_ANGLE_DEG:  # else it looks as that of the image points
        unit, scale = ("arcsec", k) if certificate else ("\N{MICRO SIGN}rad", k * URAD_PER_ARCSEC)
        plots["direction"] = over_sensor(
            uncertainty.grid_px, scale * uncertainty.sigma_arcsec, f"U of a direction, {unit}",
            "direction", "Uncertainty of a direction over the sensor", stars=points,
        )  # fmt: skip
    return plots


def _change_plots(results: Results) -> dict[str, str]:
    """Draw the change since the last calibration, in px and in units of its expanded uncertainty."""
    previous = results.get("previous")
    then = previous.get("calibration") if previous else None
    maps = change_maps(then, results["calibration"]) if then else None
    if maps is None or then is None:
        return {}
    grid, offset, expanded = maps
    before, now = (
        camera_of(calibration["camera"], calibration["image_size"])
        for calibration in (then, results["calibration"])
    )
    return {
        "change": sensor_map(
            grid, offset, "Change of an image point, px", "change", "Change since the last calibration",
            arrows=camera_difference(now, before),
        ),
        "change_ratio": sensor_map(
            grid, offset / expanded, "Change / U of the change", "change-ratio",
            "Change since the last calibration over its uncertainty",
        ),
    }  # fmt: skip
