"""The collimator: where the camera's centre of rotation lies in front of the star target.

Knows the collimator only. Behind a collimator the target stands at infinity, and a camera that turns sees it
as if it turned about one fixed point (x, y, -r) of the target frame (the spherical motion model).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

PARAMETERS = ("x", "y", "r")


@dataclass(frozen=True)
class Collimator:
    """The centre of the spherical motion, mm of the target.

    Parameters
    ----------
    x, y
        Foot of the perpendicular from the centre to the target plane.
    r
        Distance of the centre from the target plane: the collimator's focal length on the target's scale.
    """

    x: float
    y: float
    r: float

    @property
    def centre(self) -> Array:
        """(3,) the centre (x, y, -r) in the target frame."""
        return np.array([self.x, self.y, -self.r])

    @property
    def values(self) -> Array:
        """(3,) x, y, r."""
        return np.array([self.x, self.y, self.r])

    def to_dict(self) -> dict[str, float]:
        """Return the parameters by name."""
        return {"x": self.x, "y": self.y, "r": self.r}
