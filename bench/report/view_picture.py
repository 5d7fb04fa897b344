"""One pose as the report shows it, and which of its stars the plots show. Data only; loads no NumPy for its types."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

MOST_STARS = 12_000
"""Approximate largest number of stars in a plot."""
_GOLDEN = 0.6180339887498949


@dataclass(frozen=True)
class ViewPicture:
    """One pose as the report shows it."""

    name: str
    image: NDArray[np.uint8] | None  # (H, W) uint8, the event image; None if the pose appears in plots only
    detected: NDArray[np.float64]  # (N, 2) float64, px: detected stars
    reprojected: NDArray[np.float64]  # (N, 2) float64, px: the same stars as the calibration projects them
    ids: NDArray[np.int64]  # (N,) int64, ids of the stars

    @property
    def residuals(self) -> NDArray[np.float64]:
        """(N, 2) float64, px: detected position minus projected position of each star."""
        return self.detected - self.reprojected


def thinned(views: Sequence[ViewPicture], most: int = MOST_STARS) -> Sequence[ViewPicture]:
    """Reduce the stars to about ``most``, evenly over all views; fewer stars stay as they are.

    Star number n is kept if the fractional part of n times the golden ratio is small. This additive recurrence has a
    low discrepancy: the kept stars are evenly spread, they do not coincide with the rows of the target, and each view
    keeps different stars.

    Returns: The same views with fewer stars; the argument itself if it has no more than ``most`` stars.
    """
    total = sum(len(view.ids) for view in views)
    if total <= most:
        return views
    import numpy as np

    kept = np.arange(total) * _GOLDEN % 1.0 < most / total
    ends = np.cumsum([len(view.ids) for view in views])
    return [
        replace(view, detected=view.detected[k], reprojected=view.reprojected[k], ids=view.ids[k])
        for view, k in zip(views, np.split(kept, ends[:-1]), strict=True)
    ]
