"""What stands out in the residuals, as a sentence; empty if nothing does."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from bench.measure.view_picture import ViewPicture
from bench.wording.target_words import TargetWords

_OUTER, _INNER = 0.8, 0.5
"""Parts of the largest distance from the principal point: beyond the first is the rim, within the second the middle."""
_LEAST_POINTS = 30  # In each part
_STANDS_OUT = 1.3
"""Ratio of the RMS residuals from which a reader sees the difference in the plot."""
_SIGMAS = 4.0
"""The ratio exceeds 1 by this many standard deviations: 1 in 30,000 reports of a right model says so by chance."""


def rim_text(views: Sequence[ViewPicture], camera: Mapping[str, float], words: TargetWords) -> str:
    """Return whether residuals at the rim of the image are longer than those in the middle, from each pose's stars.

    The RMS of n residuals, two numbers each, has the relative standard deviation 1 / sqrt(4 n) (normal distribution).
    """
    import numpy as np

    seen = [view for view in views if len(view.detected)]
    if not seen:
        return ""
    points = np.concatenate([view.detected for view in seen])
    squares = np.sum(np.concatenate([view.residuals for view in seen]) ** 2, axis=1)
    distance = np.linalg.norm(points - [camera["cx"], camera["cy"]], axis=1) / max(
        1e-9, float(np.linalg.norm(points - [camera["cx"], camera["cy"]], axis=1).max())
    )
    outer, inner = squares[distance > _OUTER], squares[distance < _INNER]
    if min(len(outer), len(inner)) < _LEAST_POINTS:
        return ""
    rim, middle = float(np.sqrt(outer.mean())), float(np.sqrt(inner.mean()))
    least = max(_STANDS_OUT, 1.0 + _SIGMAS * np.sqrt(0.25 / len(outer) + 0.25 / len(inner)))
    if rim <= least * middle:
        return ""
    return (
        f"Residuals are longer at the rim: {rim:.2g} px RMS, and {middle:.2g} px in the middle. Either the lens needs "
        f"more distortion coefficients, or the {words.points} are less sharp there."
    )
