"""Plots over the sensor: their frame, and the part of the sensor that stars support. Pure; reads no file."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bench.report.contours import outlines
from bench.report.drawing import PANEL
from bench.report.plot_frame import Key, Words, axes_in, height_for
from bench.report.scales import Scale
from bench.report.support import reach_px, star_distance
from bench.report.svg_plot import Axes, Picture

Array = NDArray[np.float64]

GROUND = "#eef3f8"
"""Colour of the sensor where a plot shows what stars support."""
_COARSE = 8
"""The part that stars support is drawn from every n-th pixel."""
_UNSUPPORTED, _EDGE = "#f2dcc9", "#9a5b00"


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
    """Return the axes of a sensor in a picture of its own, whose height follows from the sensor's shape.

    image_size: Width and height of the sensor, px.
    identifier, label, about: As for `bench.report.svg_plot.Picture`.
    Returns: Axes in px, rows downwards; pixel centres are at integers.
    """
    words = Words(title, "column, px", "row, px", keys)
    picture = Picture(width, height_for(image_size, width, words), identifier, label, about)
    across, down = Scale(-0.5, image_size[0] - 0.5), Scale(image_size[1] - 0.5, -0.5)
    return axes_in(picture, across, down, words, equal="shrink", whole=True)


def shade_unsupported(axes: Axes, distance: NDArray[np.float32], image_size: Sequence[int]) -> None:
    """Shade the part of the sensor that no star supports, with a dashed line around it.

    distance: (H, W) float32, px: distance of each pixel from the nearest star.
    image_size: Width and height, px.
    """
    reach = reach_px(image_size)
    rows, columns = (np.unique([*range(0, n, _COARSE), n - 1]) for n in distance.shape)
    found = outlines(
        columns.astype(float), rows.astype(float), distance[np.ix_(rows, columns)].astype(float), reach
    )
    if not found:
        return
    axes.shapes([one.points for one in found], _UNSUPPORTED, 0.75)
    for one in found:
        for line in one.lines():
            axes.line(line, _EDGE, 0.9, dash="3.5 1.8")


def supported_share(points: Array, image_size: Sequence[int]) -> tuple[NDArray[np.float32], float]:
    """Return how far each pixel is from the nearest star, and the share of the sensor that stars support.

    points: (N, 2) float64, px: stars of all poses, N > 0.
    image_size: Width and height, px.
    Returns: (H, W) float32, px, and the share, 0 to 1.
    """
    distance = star_distance(points, image_size)
    return distance, float(np.mean(distance <= reach_px(image_size)))
