"""What stands out in the residuals, as sentences; empty if nothing does."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from bench.measure.view_picture import ViewPicture
from bench.wording.numbers import number
from bench.wording.target_words import TargetWords
from calib.arrays import Array

_OUTER, _INNER = 0.8, 0.5
"""Parts of the largest distance from the principal point: beyond the first is the rim, within the second the middle."""
_LEAST_POINTS = 30  # In each part
_STANDS_OUT = 1.3
"""Ratio of the RMS residuals from which a reader sees the difference in the plot."""
_ONE_DIRECTION = 0.5  # Mean over RMS: from here on a reader sees that the lines are parallel
_SIGMAS = 4.0
"""The ratio exceeds 1 by this many standard deviations: 1 in 30,000 reports of a right model says so by chance."""


_COLUMNS, _ROWS = ("left", "middle", "right"), ("upper", "central", "lower")


def direction_text(views: Sequence[ViewPicture], image_size: Sequence[int]) -> str:
    """Return in which part of the image the residuals have one direction, with what that means; empty if none has.

    Of n independent residuals, the mean of each coordinate has the standard deviation of one over the root of n.
    """
    points, residuals = _points_and_residuals(views)
    part = np.clip((3 * points / np.asarray(image_size)).astype(int), 0, 2)
    found = []
    for column, row in np.ndindex(3, 3):
        of_part = residuals[(part == (column, row)).all(axis=1)]
        if len(of_part) < _LEAST_POINTS:
            continue
        rms = float(np.sqrt(np.mean(np.sum(of_part**2, axis=1))))
        mean = float(np.linalg.norm(of_part.mean(axis=0)))
        if mean > max(_ONE_DIRECTION * rms, _SIGMAS * rms / np.sqrt(2 * len(of_part))):
            found.append((mean, f"{_ROWS[row]} {_COLUMNS[column]}"))
    if not found:
        return ""
    mean, where = max(found)
    return (
        f"In the {where} part of the image, the residuals have one direction: {number(mean, 2)} px on the mean. The"
        f" model does not explain this part, and a direction that is measured there may be off by as much."
    )


def _points_and_residuals(views: Sequence[ViewPicture]) -> tuple[Array, Array]:
    """Return the stars of all views and their residuals, (N, 2) px each."""
    none = np.zeros((0, 2))
    return (
        np.concatenate([none, *(view.detected for view in views)]),
        np.concatenate([none, *(view.residuals for view in views)]),
    )


def rim_text(views: Sequence[ViewPicture], camera: Mapping[str, float], words: TargetWords) -> str:
    """Return whether residuals at the rim of the image are longer than those in the middle, from each pose's stars.

    The RMS of n residuals, two numbers each, has the relative standard deviation 1 / sqrt(4 n) (normal distribution).
    """
    points, residuals = _points_and_residuals(views)
    squares = np.sum(residuals**2, axis=1)
    distance = np.linalg.norm(points - [camera["cx"], camera["cy"]], axis=1)
    reach = distance.max(initial=0.0)
    outer, inner = squares[distance > _OUTER * reach], squares[distance < _INNER * reach]
    if min(len(outer), len(inner)) < _LEAST_POINTS:
        return ""
    rim, middle = float(np.sqrt(outer.mean())), float(np.sqrt(inner.mean()))
    least = max(_STANDS_OUT, 1.0 + _SIGMAS * np.sqrt(0.25 / len(outer) + 0.25 / len(inner)))
    if rim <= least * middle:
        return ""
    return (
        f"Residuals are longer at the rim: {number(rim, 2)} px RMS, and {number(middle, 2)} px in the middle. Either "
        f"the lens needs more distortion coefficients, or the {words.points} are less sharp there."
    )
