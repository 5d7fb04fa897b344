"""One pose as the report shows it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


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
