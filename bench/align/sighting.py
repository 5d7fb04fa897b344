"""Whether a picture still shows what an earlier one showed: the view has not moved since.

Pictures are compared when they are reduced to some thousand cells, which takes a millisecond. The module computes with
numbers only.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

_CELLS: Final = 320
"""Long side of the reduced picture, cells."""
_ALIKE: Final = 0.97
"""Least correlation of two pictures of the same view."""
_TURNED_DEG: Final = 0.02
"""Change of a reading from which the stage has turned, degrees."""


class Sighting(NamedTuple):
    """What a picture showed, and where the stage stood."""

    cells: NDArray[np.float32]  # (h, w) float32, the reduced picture, with mean 0 and a sum of squares of 1
    reading_deg: Mapping[str, float]  # Angles of the stage, degrees; empty if unknown

    @classmethod
    def of(cls, values: NDArray[np.float32], reading_deg: Mapping[str, float]) -> Sighting:
        """Reduce a picture.

        values: (H, W) float32, grey values.
        reading_deg: Angles of the stage, degrees; empty if unknown.
        """
        return cls(_reduced(values), dict(reading_deg))

    def differs(self, values: NDArray[np.float32], reading_deg: Mapping[str, float]) -> bool:
        """Return whether a picture shows another view.

        values: (H, W) float32, grey values.
        reading_deg: Angles of the stage, degrees; empty if unknown.
        Returns: By the angles, or by the correlation of the pictures (Pearson's coefficient).
        """
        turned = [abs(angle - self.reading_deg.get(axis, angle)) for axis, angle in reading_deg.items()]
        if max(turned, default=0.0) > _TURNED_DEG:
            return True
        cells = _reduced(values)
        return cells.shape != self.cells.shape or float((cells * self.cells).sum()) < _ALIKE


def _reduced(values: NDArray[np.float32]) -> NDArray[np.float32]:
    scale = _CELLS / max(values.shape)
    shape = max(1, round(values.shape[1] * scale)), max(1, round(values.shape[0] * scale))
    cells = np.nan_to_num(cv2.resize(values, shape, interpolation=cv2.INTER_AREA).astype(np.float32))
    cells -= cells.mean()
    norm = float(np.linalg.norm(cells))
    return np.asarray(cells / norm if norm > 0.0 else cells, np.float32)
