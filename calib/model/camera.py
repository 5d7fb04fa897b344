"""The camera: pinhole projection, lens distortion, and their derivatives.

Knows one camera and points in its frame; no target, no collimator, no view. Image coordinates as OpenCV has
them: x right, y down, pixel centres at integers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from calib.errors import InputMismatch
from calib.model.lens import BROWN, FISHEYE, distort, distort_with_jacobians, is_fisheye

__all__ = ["BROWN", "DISTORTION_SETS", "FISHEYE", "PINHOLE", "CameraModel", "distortion_names"]

Array = NDArray[np.float64]

PINHOLE = ("fx", "fy", "cx", "cy")
#: Sets of coefficients by the names the command line takes.
DISTORTION_SETS: Mapping[str, tuple[str, ...]] = {
    "none": (),
    "k1": ("k1",),
    "k1k2": ("k1", "k2"),
    "k1k2k3": ("k1", "k2", "k3"),
    "k1k2p1p2": ("k1", "k2", "p1", "p2"),
    "k1k2k3p1p2": ("k1", "k2", "p1", "p2", "k3"),
    "rational": BROWN,
    "fisheye": FISHEYE,
}


def distortion_names(chosen: str | Sequence[str]) -> tuple[str, ...]:
    """Return the coefficients of a named set, or check a sequence of coefficients.

    Raises
    ------
    InputMismatch
        When the set or a coefficient is unknown.

    Examples
    --------
    >>> distortion_names("k1k2")
    ('k1', 'k2')
    """
    if isinstance(chosen, str):
        if chosen not in DISTORTION_SETS:
            known = ", ".join(DISTORTION_SETS)
            raise InputMismatch(f"Unknown distortion {chosen!r}.", remedy=f"Known are: {known}.")
        return DISTORTION_SETS[chosen]
    families = (BROWN, FISHEYE)
    for family in families:
        if set(chosen) <= set(family):
            return tuple(name for name in family if name in chosen)
    known = " or ".join(" ".join(family) for family in families)
    raise InputMismatch(f"No lens has the coefficients {' '.join(chosen)}.", remedy=f"Known are: {known}.")


@dataclass(frozen=True)
class CameraModel:
    """A camera: pinhole projection and the distortion of its lens (`calib.model.lens`).

    Parameters
    ----------
    fx, fy
        Focal lengths, px.
    cx, cy
        Principal point, px.
    image_size
        Width and height, px.
    distortion
        Coefficients by name; those not named are zero. A camera is calibrated in the named ones.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    image_size: tuple[int, int]
    distortion: Mapping[str, float] = field(default_factory=dict)

    @property
    def matrix(self) -> Array:
        """(3, 3) matrix K."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the parameters, as `values` orders them."""
        return (*PINHOLE, *self.distortion)

    @property
    def values(self) -> Array:
        """(4 + number of coefficients,) values of the parameters."""
        return np.array([self.fx, self.fy, self.cx, self.cy, *self.distortion.values()])

    @property
    def coefficients(self) -> Array:
        """(8,) all of Brown's coefficients in OpenCV's order k1 k2 p1 p2 k3 k4 k5 k6.

        Raises
        ------
        InputMismatch
            For a fisheye lens, which has none of them.
        """
        if is_fisheye(self.distortion):
            raise InputMismatch("A fisheye lens has no coefficients k1 to k6, p1, p2.")
        return np.array([self.distortion.get(name, 0.0) for name in BROWN])

    @property
    def is_fisheye(self) -> bool:
        """Whether the lens is described by its angle's polynomial."""
        return is_fisheye(self.distortion)

    @property
    def fisheye_coefficients(self) -> Array:
        """(4,) coefficients of the angle's polynomial, as OpenCV's fisheye functions take them.

        Raises
        ------
        InputMismatch
            For a lens of Brown's model, which has none of them.
        """
        if not is_fisheye(self.distortion):
            raise InputMismatch("A lens of Brown's model has no coefficients kb1 to kb4.")
        return np.array([self.distortion.get(name, 0.0) for name in FISHEYE])

    def with_values(self, values: Array) -> CameraModel:
        """Return the same model with other values, in the order of `parameter_names`."""
        fx, fy, cx, cy, *coefficients = (float(v) for v in values)
        distortion = dict(zip(self.distortion, coefficients, strict=True))
        return CameraModel(fx, fy, cx, cy, self.image_size, distortion)

    def project(self, points: Array) -> Array:
        """Return the image points, (N, 2) px, of points (N, 3) of the camera frame.

        A ray that does not point forward (Z > 0) has no image: NaN.
        """
        forward = np.where(points[:, 2:] > 0, points, np.nan)
        distorted = distort(forward[:, :2] / forward[:, 2:], self.distortion)
        return np.asarray(distorted * [self.fx, self.fy] + [self.cx, self.cy])

    def project_with_jacobians(self, points: Array) -> tuple[Array, Array, Array]:
        """Return image points and their derivatives.

        Parameters
        ----------
        points
            (N, 3) points of the camera frame, Z > 0.

        Returns
        -------
        tuple
            (N, 2) image points, px; (N, 2, 3) derivative by the points; (N, 2, k) derivative by the
            parameters in the order of `parameter_names`.
        """
        inverse_z = 1.0 / points[:, 2]
        normalised = points[:, :2] * inverse_z[:, None]
        distorted, by_normalised, by_coefficients = distort_with_jacobians(normalised, self.distortion)
        focal = np.array([self.fx, self.fy])
        pixels = distorted * focal + [self.cx, self.cy]

        by_pixel = by_normalised * focal[:, None] * inverse_z[:, None, None]
        along_ray = -(by_pixel @ normalised[:, :, None])
        by_points = np.concatenate([by_pixel, along_ray], axis=2)

        by_parameters = np.zeros((len(points), 2, 4 + len(self.distortion)))
        by_parameters[:, 0, 0], by_parameters[:, 1, 1] = distorted[:, 0], distorted[:, 1]
        by_parameters[:, 0, 2] = by_parameters[:, 1, 3] = 1.0
        by_parameters[:, :, 4:] = by_coefficients * focal[:, None]
        return pixels, by_points, by_parameters

    def rays(self, points_px: Array) -> Array:
        """Return the unit rays, (N, 3), seen at image points (N, 2) px; the inverse of `project`.

        Newton's method on the distortion; NaN where the distortion cannot be inverted (beyond the radius at
        which it folds back).
        """
        wanted = (np.asarray(points_px, float) - [self.cx, self.cy]) / [self.fx, self.fy]
        normalised = wanted.copy()
        for _ in range(30):
            distorted, slope, _ = distort_with_jacobians(normalised, self.distortion)
            determinant = slope[:, 0, 0] * slope[:, 1, 1] - slope[:, 0, 1] * slope[:, 1, 0]
            # Where the determinant is not positive, the distortion has folded back.
            miss = (wanted - distorted) / np.where(determinant > 0, determinant, np.nan)[:, None]
            step = np.column_stack(
                [
                    slope[:, 1, 1] * miss[:, 0] - slope[:, 0, 1] * miss[:, 1],
                    slope[:, 0, 0] * miss[:, 1] - slope[:, 1, 0] * miss[:, 0],
                ]
            )
            normalised = normalised + step
            if not (np.abs(step) > 1e-14).any():
                break
        inverted = np.abs(distort(normalised, self.distortion) - wanted).max(axis=1) < 1e-9
        rays = np.column_stack([normalised, np.ones(len(normalised))])
        rays[~inverted] = np.nan
        return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))

    def to_dict(self) -> dict[str, float]:
        """Return the parameters by name."""
        return dict(zip(self.parameter_names, self.values.tolist(), strict=True))
