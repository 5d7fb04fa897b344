"""The camera: pinhole projection, lens distortion, and their derivatives.

Image coordinates are OpenCV's: x right, y down, pixel centres at integers. This module depends on the lens only, not on
targets, collimators or views.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from calib.errors import InputMismatch
from calib.model.lens import BROWN, FISHEYE, distort, distort_with_jacobians, is_fisheye

__all__ = ["BROWN", "DISTORTION_SETS", "FISHEYE", "PINHOLE", "SKEW", "CameraModel", "distortion_names"]

Array = NDArray[np.float64]

PINHOLE = ("fx", "fy", "cx", "cy")
#: Name of the skew: the element K[0, 1] of the camera matrix, px. MATLAB can estimate it; OpenCV's model has none. It
#: is estimated beside coefficients of Brown's model.
SKEW = "skew"
#: Sets of distortion coefficients, by the names that the command line accepts.
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


#: Coefficients that can be estimated together.
_FAMILIES = ((*BROWN, SKEW), FISHEYE)
_ONE_NAME = re.compile(r"k[1-6]|p[12]|kb[1-4]|skew")


def distortion_names(chosen: str | Sequence[str]) -> tuple[str, ...]:
    """Return the coefficients of a named set, or check a sequence of coefficients; in the order of their lens family.

    Beside a set of `DISTORTION_SETS`: names of one family, and `SKEW` beside those of Brown's model; also in one word.

    Examples
    --------
    >>> distortion_names("k1k2")
    ('k1', 'k2')
    >>> distortion_names("k1k2skew")
    ('k1', 'k2', 'skew')
    """
    if isinstance(chosen, str):
        if chosen in DISTORTION_SETS:
            return DISTORTION_SETS[chosen]
        names = _ONE_NAME.findall(chosen)
        if not names or "".join(names) != chosen or len(set(names)) != len(names):
            known = ", ".join(DISTORTION_SETS)
            raise InputMismatch(
                f"Unknown distortion {chosen!r}.",
                remedy=f"Known: {known}; or coefficients in one word, such as k1k2skew.",
            )
        chosen = names
    for family in _FAMILIES:
        if set(chosen) <= set(family):
            return tuple(name for name in family if name in chosen)
    known = " or ".join(" ".join(family) for family in _FAMILIES)
    raise InputMismatch(f"No lens model has the coefficients {' '.join(chosen)}.", remedy=f"Known: {known}.")


@dataclass(frozen=True)
class CameraModel:
    """A camera: pinhole projection and lens distortion (`calib.model.lens`).

    Parameters
    ----------
    fx, fy
        Focal lengths, px.
    cx, cy
        Principal point, px.
    image_size
        Width and height, px.
    distortion
        Distortion coefficients by name, dimensionless, and the skew (`SKEW`), px. Those that are not named are zero.
        The named ones are estimated in a calibration.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    image_size: tuple[int, int]
    distortion: Mapping[str, float] = field(default_factory=dict)

    @property
    def matrix(self) -> Array:
        """(3, 3) float64 camera matrix K, px."""
        return np.array([[self.fx, self.skew, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @property
    def skew(self) -> float:
        """Element K[0, 1] of the camera matrix, px; 0 unless `distortion` names it."""
        return self.distortion.get(SKEW, 0.0)

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the parameters, in the order of `values`."""
        return (*PINHOLE, *self.distortion)

    @property
    def values(self) -> Array:
        """(4 + K,) float64 values of the parameters: fx, fy, cx, cy in px, then `distortion`."""
        return np.array([self.fx, self.fy, self.cx, self.cy, *self.distortion.values()])

    @property
    def coefficients(self) -> Array:
        """(8,) float64 coefficients of Brown's model in OpenCV's order k1 k2 p1 p2 k3 k4 k5 k6.

        Raises
        ------
        InputMismatch
            If the lens is a fisheye lens, which has none of them.
        """
        if is_fisheye(self.distortion):
            raise InputMismatch("A fisheye lens has no coefficients k1 to k6, p1, p2.")
        return np.array([self.distortion.get(name, 0.0) for name in BROWN])

    @property
    def is_fisheye(self) -> bool:
        """Whether the lens follows the fisheye model (Kannala and Brandt)."""
        return is_fisheye(self.distortion)

    @property
    def fisheye_coefficients(self) -> Array:
        """(4,) float64 coefficients of the fisheye model, in the order of OpenCV's fisheye functions.

        Raises
        ------
        InputMismatch
            If the lens follows Brown's model, which has none of them.
        """
        if not is_fisheye(self.distortion):
            raise InputMismatch("A lens of Brown's model has no coefficients kb1 to kb4.")
        return np.array([self.distortion.get(name, 0.0) for name in FISHEYE])

    def with_values(self, values: Array) -> CameraModel:
        """Return the same model with other parameter values.

        Parameters
        ----------
        values
            (4 + K,) values in the order of `parameter_names`; px for the first four.

        Returns
        -------
        CameraModel
            Camera with these values, the same image size and the same coefficient names.
        """
        fx, fy, cx, cy, *coefficients = (float(v) for v in values)
        distortion = dict(zip(self.distortion, coefficients, strict=True))
        return CameraModel(fx, fy, cx, cy, self.image_size, distortion)

    def project(self, points: Array) -> Array:
        """Project points to the image.

        Pinhole projection: Hartley and Zisserman (2004), section 6.1. Distortion: `calib.model.lens`.

        Parameters
        ----------
        points
            (N, 3) points in the camera frame, any length unit.

        Returns
        -------
        Array
            (N, 2) image points, px. NaN for points that are not in front of the camera (Z <= 0).
        """
        x, y, z = np.ascontiguousarray(points.T)
        inverse_z = 1.0 / np.where(z > 0, z, np.nan)
        distorted = distort(np.array([x * inverse_z, y * inverse_z]).T, self.distortion)
        pixels = np.asarray(distorted * [self.fx, self.fy] + [self.cx, self.cy])
        if self.skew:
            pixels[:, 0] += self.skew * distorted[:, 1]
        return pixels

    def project_with_jacobians(self, points: Array) -> tuple[Array, Array, Array]:
        """Project points to the image and return the derivatives.

        Projection: Hartley and Zisserman (2004), section 6.1, as in `project`. The derivatives are this project's own,
        by the chain rule; the derivative along a ray is zero.

        Parameters
        ----------
        points
            (N, 3) points in the camera frame with Z > 0, any length unit.

        Returns
        -------
        tuple of Array
            (N, 2) image points, px; (N, 2, 3) derivatives by the points, px per length unit; (N, 2, 4 + K) derivatives
            by the parameters in the order of `parameter_names`.
        """
        x, y, z = np.ascontiguousarray(points.T)
        inverse_z = 1.0 / z
        normalised = np.array([x * inverse_z, y * inverse_z])
        distorted, by_normalised, by_coefficients = distort_with_jacobians(normalised.T, self.distortion)
        focal = np.array([self.fx, self.fy])
        pixels = distorted * focal + [self.cx, self.cy]
        skew = self.skew
        if skew:
            pixels[:, 0] += skew * distorted[:, 1]

        # One contiguous row over the points for each derivative: several times faster than one small matrix a point.
        by_points = np.empty((2, 3, len(x)))
        by_points[:, :2] = by_normalised.transpose(1, 2, 0) * (focal[:, None, None] * inverse_z)
        if skew:
            by_points[0, :2] += by_normalised.transpose(1, 2, 0)[1] * (skew * inverse_z)
        by_points[:, 2] = -(by_points[:, 0] * normalised[0] + by_points[:, 1] * normalised[1])

        by_parameters = np.zeros((4 + len(self.distortion), 2, len(x)))
        by_parameters[0, 0], by_parameters[1, 1] = distorted.T
        by_parameters[2, 0] = by_parameters[3, 1] = 1.0
        lens = by_coefficients.transpose(2, 1, 0)
        by_parameters[4:] = lens * focal[:, None]
        if SKEW in self.distortion:
            by_parameters[4:, 0] += lens[:, 1] * skew
            by_parameters[4 + list(self.distortion).index(SKEW), 0] = distorted[:, 1]
        return pixels, by_points.transpose(2, 0, 1), by_parameters.transpose(2, 1, 0)

    def rays(self, points_px: Array) -> Array:
        """Return the unit rays that are seen at image points: the inverse of `project`.

        The distortion is inverted by Newton's method. Own derivation: the step is J^-1 (wanted - distorted), with the
        inverse of the 2 x 2 Jacobian written out.

        Parameters
        ----------
        points_px
            (N, 2) image points, px.

        Returns
        -------
        Array
            (N, 3) unit vectors in the camera frame. NaN where the distortion cannot be inverted (beyond the radius at
            which it folds back).
        """
        wanted = (np.asarray(points_px, float) - [self.cx, self.cy]) / [self.fx, self.fy]
        wanted[:, 0] -= self.skew / self.fx * wanted[:, 1]
        normalised = wanted.copy()
        for _ in range(30):
            distorted, slope, _ = distort_with_jacobians(normalised, self.distortion)
            determinant = slope[:, 0, 0] * slope[:, 1, 1] - slope[:, 0, 1] * slope[:, 1, 0]
            # The distortion has folded back if the determinant is not positive.
            error = (wanted - distorted) / np.where(determinant > 0, determinant, np.nan)[:, None]
            step = np.column_stack(
                [
                    slope[:, 1, 1] * error[:, 0] - slope[:, 0, 1] * error[:, 1],
                    slope[:, 0, 0] * error[:, 1] - slope[:, 1, 0] * error[:, 0],
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
        """Return the parameters by name.

        Returns
        -------
        dict of str to float
            Focal lengths and principal point, px, and the distortion coefficients.
        """
        return dict(zip(self.parameter_names, self.values.tolist(), strict=True))
