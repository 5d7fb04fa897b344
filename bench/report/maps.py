"""Maps over the sensor as contours at round numbers: uncertainty, change since another result."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from bench.record.coverage import coverage_factor
from bench.record.results import CameraData
from bench.record.stored_calibration import camera_covariance, camera_of
from bench.report.contours import Outline, outlines
from bench.report.supported import reach_px, star_distance
from bench.report.svg_plot import (
    INK,
    PANEL,
    POSE_COLOURS,
    Axes,
    Key,
    Picture,
    Words,
    axes_in,
    height_for,
    shade,
)
from bench.report.svg_scale import Scale, decades, text_width
from bench.wording.numbers import number
from calib.arrays import Array
from calib.model.result_parts import WORST_CORNER
from calib.uncertainty.projection_uncertainty import (
    CameraDifference,
    camera_difference,
    projection_uncertainty,
)

GROUND = "#eef3f8"
"""Colour of the sensor where a plot shows what stars support."""
_COARSE = 8
"""The part that stars support is drawn from every n-th pixel: finer than its outline is seen, and the file stays
small."""
_UNSUPPORTED, _EDGE = "#f2dcc9", "#9a5b00"
_MOST_LINES = 7  # More contours leave no room for their labels
_LARGE_RANGE = 6.0
"""From this ratio of the largest to the smallest value on, contours are at 1, 2 and 5 times powers of ten."""
_CONTOUR, _HALO, _LABEL_SIZE = "#3b4b5b", "#ffffff", 8.0
_MESH = 4
"""Distance between two arrows, in grid points of the map."""


def sensor_axes(
    image_size: Sequence[int],
    title: Sequence[str],
    identifier: str,
    label: str,
    about: str,
    *,
    width: float = PANEL[0],
    keys: Sequence[Key] = (),
) -> Axes:
    """Return the axes of a sensor, px, in a picture as high as its shape asks; pixel centres at integers."""
    words = Words(title, "column, px", "row, px", keys)
    picture = Picture(width, height_for(image_size, width, words), identifier, label, about)
    across, down = Scale(-0.5, image_size[0] - 0.5), Scale(image_size[1] - 0.5, -0.5)
    return axes_in(picture, across, down, words, equal=True, whole=True)


def shade_unsupported(axes: Axes, distance: NDArray[np.float32], image_size: Sequence[int]) -> None:
    """Shade where no star is near, by (H, W) float32 distances in px, with a dashed line around it."""
    reach = reach_px(image_size)
    rows, columns = (np.unique([*range(0, n, _COARSE), n - 1]) for n in distance.shape)
    regions = outlines(
        columns.astype(float), rows.astype(float), distance[np.ix_(rows, columns)].astype(float), reach
    )
    if not regions:
        return
    axes.shapes([region.points for region in regions], _UNSUPPORTED, 0.75)
    for region in regions:
        for line in region.lines():
            axes.line(line, _EDGE, 0.9, dash="3.5 1.8")


def supported_share(points: Array, image_size: Sequence[int]) -> tuple[NDArray[np.float32], float]:
    """Return `star_distance`, and the share of the sensor, 0 to 1, that stars support."""
    distance = star_distance(points, image_size)
    return distance, float(np.mean(distance <= reach_px(image_size)))


def sensor_map(
    grid_px: Array,
    values: Array,
    name: str,
    identifier: str,
    label: str,
    *,
    stars: Array | None = None,
    arrows: CameraDifference | None = None,
) -> str:
    """Draw a quantity over the sensor as contours at round numbers.

    ``grid_px`` is (h, w, 2), ``values`` (h, w), NaN where unknown; ``stars`` (N, 2) px, to shade what they leave out,
    or None.
    """
    x, y, shown = grid_px[0, :, 0], grid_px[:, 0, 1], _to_six_digits(values)
    size = (int(x.max()) + 1, int(y.max()) + 1)
    lowest, worst, middle = (float(f(shown)) for f in (np.nanmin, np.nanmax, np.nanmedian))
    levels = round_levels(lowest, worst)
    by_level = {level: outlines(x, y, shown, level) for level in levels}
    numbers = f"median {number(middle, 2)}, at most {number(worst, 2)}"
    about = f"{name}: {numbers}. Contours at {', '.join(f'{level:g}' for level in levels) or 'no level'}."
    axes = sensor_axes(size, (name, numbers), identifier, label, about)
    _fill(axes, outlines(x, y, shown, lowest), 0.0)
    for part, level in enumerate(levels, 1):
        _fill(axes, by_level[level], part / len(levels))
    for level in levels:
        for line in (line for outline in by_level[level] for line in outline.lines()):
            axes.line(line, _CONTOUR, 0.6)
    if stars is not None and len(stars):
        shade_unsupported(axes, supported_share(stars, size)[0], size)
    if arrows is not None:
        _arrows(axes, arrows)
    _label_contours(axes, by_level)
    return axes.picture.svg()


def _fill(axes: Axes, shapes: Sequence[Outline], share: float) -> None:
    axes.shapes([outline.points for outline in shapes], shade(share))


def _label_contours(axes: Axes, by_level: Mapping[float, Sequence[Outline]]) -> None:
    """Write the level beside its longest contour, where there is room."""
    taken: list[tuple[float, float, float]] = []
    for level, parts in by_level.items():
        text = f"{level:g}"
        half = text_width(text, _LABEL_SIZE) / 2
        lines = [axes.at(line) for part in parts for line in part.lines()]
        for line in sorted(lines, key=_length, reverse=True):
            if place := _free_place(axes, line, half, taken):
                taken.append((*place, half))
                x, y = place
                halo = f'stroke="{_HALO}" stroke-width="2.2" stroke-opacity="0.8" stroke-linejoin="round"'
                style = f'text-anchor="middle" font-size="{_LABEL_SIZE:g}" paint-order="stroke"'
                axes.picture.add(f'<text x="{x:g}" y="{y + 2.8:g}" fill="{INK}" {halo} {style}>{text}</text>')
                break


def _free_place(
    axes: Axes, line: Array, half: float, taken: Sequence[tuple[float, float, float]]
) -> tuple[float, float] | None:
    """Return the point of a line nearest to its middle where a label collides with nothing; None if there is none."""
    middle = len(line) // 2
    for place in sorted(range(len(line)), key=lambda n: abs(n - middle)):
        x, y = line[place].tolist()
        inside = (
            axes.left + half + 2 <= x <= axes.left + axes.width - half - 2
            and axes.top + 6 <= y <= axes.top + axes.height - 6
        )
        if inside and all(abs(x - a) > half + b + 3 or abs(y - c) > 9 for a, c, b in taken):
            return x, y
    return None


def _length(line: Array) -> float:
    return float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())


def round_levels(lowest: float, largest: float) -> list[float]:
    """Return at most seven round numbers strictly between two values that are not negative; none if they are equal.

    They stand at equal steps, or are 1, 2, 5 times powers of ten for a large range.

    >>> round_levels(0.034, 0.0512)
    [0.035, 0.04, 0.045, 0.05]
    >>> round_levels(0.31, 8.1)
    [0.5, 1.0, 2.0, 5.0]
    >>> round_levels(0.0, 0.21)
    [0.05, 0.1, 0.15, 0.2]
    """
    if not 0 <= lowest < largest:
        return []
    if lowest > 0 and largest / lowest > _LARGE_RANGE:
        fine, coarse = (
            [level for level in decades(lowest, largest, digits) if lowest < level < largest]
            for digits in ((1, 2, 5), (1,))
        )
        return fine if len(fine) <= _MOST_LINES else coarse[-_MOST_LINES:]
    power = 10.0 ** math.floor(math.log10(largest - lowest))
    for step in (power * part for part in (0.1, 0.2, 0.5, 1.0, 2.0, 5.0)):
        multiples = range(math.floor(lowest / step), math.ceil(largest / step) + 1)
        levels = sorted({float(f"{n * step:.9g}") for n in multiples})
        levels = [level for level in levels if lowest < level < largest]
        if len(levels) <= _MOST_LINES:
            return levels
    return []


def _arrows(axes: Axes, difference: CameraDifference) -> None:
    """Draw how the image points of the first camera are shifted in the second; the longest arrow is one mesh."""
    every = (slice(_MESH // 2, None, _MESH), slice(_MESH // 2, None, _MESH))
    begins = difference.grid_px[every].reshape(-1, 2)
    offsets = _to_six_digits(difference.offset_px[every]).reshape(-1, 2)
    seen = np.isfinite(offsets).all(axis=1)
    begins, offsets = begins[seen], offsets[seen]
    mesh_px = _MESH * float(difference.grid_px[0, 1, 0])
    longest = max(float(np.linalg.norm(offsets, axis=1).max()), 1e-12)
    axes.dots(begins, POSE_COLOURS[1], 2.4)
    axes.strokes(begins, begins + mesh_px / longest * offsets, POSE_COLOURS[1], 1.0)


def _to_six_digits(values: Array) -> Array:
    """Round an array relative to its largest value, because its last bits differ between processes."""
    unit = 10.0 ** (np.ceil(np.log10(max(float(np.nanmax(np.abs(values))), 1e-30))) - 6)
    return np.asarray(np.round(values / unit) * unit)


def change_maps(then: CameraData, now: CameraData) -> tuple[Array, Array, Array] | None:
    """Return how far two calibrations project a direction apart, and its expanded uncertainty; their ratio is E_n.

    E_n: ISO 13528, independent uncertainties. (h, w, 2) points, (h, w) lengths and U, px; None without a covariance.
    """
    of_both = []
    for calibration in (then, now):
        covariance = camera_covariance(calibration["camera"], calibration.get("covariance"))
        if covariance is None:
            return None
        camera = camera_of(calibration["camera"], calibration["image_size"])
        sigma = projection_uncertainty(camera, covariance).sigma_px
        of_both.append((camera, coverage_factor(calibration, WORST_CORNER) * sigma))
    difference = camera_difference(of_both[1][0], of_both[0][0])
    expanded = np.hypot(of_both[0][1], of_both[1][1])
    return difference.grid_px, np.linalg.norm(difference.offset_px, axis=2), expanded
