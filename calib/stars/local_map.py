"""The map from the target to the image around single stars, as linear and quadratic terms.

The module holds numbers only; it loads no image library, because planning uses maps without images.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray


class LocalMap(NamedTuple):
    """Map from the target plane to the image around each of N stars, without its centre."""

    linear: NDArray[np.float64]  # (N, 2, 2) float64, A, px per pitch
    # (N, 2, 3) float64, B, px per pitch^2, coefficients of s_x^2, s_x s_y and s_y^2.
    quadratic: NDArray[np.float64]

    def select(self, mask: Any) -> LocalMap:
        """Return the maps of some stars.

        mask: (N,) bool, or a slice.
        Returns: In the same order.
        """
        return LocalMap(self.linear[mask], self.quadratic[mask])
