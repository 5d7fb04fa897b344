"""A view: the stars found in one pose, where they lie in the image and on the target."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.errors import InputMismatch


@dataclass(frozen=True)
class View:
    """Stars of one pose.

    Attributes
    ----------
    name
        The pose's name.
    image_size
        Width and height of the sensor, px.
    ids
        (N,) int64, ids of the stars on the target, all different.
    points_px
        (N, 2) float64, image points; pixel centres at integers, as OpenCV has them.
    target_mm
        (N, 2) float64, positions on the target plane (Z = 0).
    covariances_px2
        (N, 2, 2) float64, covariance of each image point, px^2.

    Raises
    ------
    InputMismatch
        When shapes disagree, a number is not finite, or an id stands twice.
    """

    name: str
    image_size: tuple[int, int]
    ids: NDArray[np.int64]
    points_px: NDArray[np.float64]
    target_mm: NDArray[np.float64]
    covariances_px2: NDArray[np.float64]

    def __post_init__(self) -> None:
        n = len(self.ids)
        shapes = (self.points_px.shape, self.target_mm.shape, self.covariances_px2.shape)
        if shapes != ((n, 2), (n, 2), (n, 2, 2)):
            raise InputMismatch(f"{n} ids, but arrays of shapes {shapes}.", where=f"view {self.name}")
        if len(np.unique(self.ids)) != n:
            raise InputMismatch("A star stands twice in it.", where=f"view {self.name}")
        if not all(np.isfinite(a).all() for a in (self.points_px, self.target_mm, self.covariances_px2)):
            raise InputMismatch("It holds numbers that are not finite.", where=f"view {self.name}")

    def __len__(self) -> int:
        """Number of stars."""
        return len(self.ids)
