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

Array = NDArray[np.float64]

PINHOLE = ("fx", "fy", "cx", "cy")
#: OpenCV's order of Brown's coefficients; k4 to k6 stand in the denominator (its rational model).
BROWN = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
#: Sets of coefficients by the names the command line takes.
DISTORTION_SETS: Mapping[str, tuple[str, ...]] = {
    "none": (),
    "k1": ("k1",),
    "k1k2": ("k1", "k2"),
    "k1k2k3": ("k1", "k2", "k3"),
    "k1k2p1p2": ("k1", "k2", "p1", "p2"),
    "k1k2k3p1p2": ("k1", "k2", "p1", "p2", "k3"),
    "rational": BROWN,
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
    unknown = [name for name in chosen if name not in BROWN]
    if unknown:
        raise InputMismatch(f"Unknown distortion coefficient {unknown[0]!r}.", remedy=f"Known are: {BROWN}.")
    return tuple(name for name in BROWN if name in chosen)


@dataclass(frozen=True)
class CameraModel:
    """A pinhole camera with Brown's distortion (OpenCV's ``calibrateCamera`` model).

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
        """(8,) all coefficients in OpenCV's order k1 k2 p1 p2 k3 k4 k5 k6."""
        return np.array([self.distortion.get(name, 0.0) for name in BROWN])

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
        distorted = _brown(forward[:, :2] / forward[:, 2:], self.coefficients)
        return np.asarray(distorted * [self.fx, self.fy] + [self.cx, self.cy])

    project_rays = project

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
        distorted, by_normalised, by_coefficients = _brown_with_jacobians(normalised, self.coefficients)
        focal = np.array([self.fx, self.fy])
        pixels = distorted * focal + [self.cx, self.cy]

        by_pixel = by_normalised * focal[:, None] * inverse_z[:, None, None]
        along_ray = -(by_pixel @ normalised[:, :, None])
        by_points = np.concatenate([by_pixel, along_ray], axis=2)

        by_parameters = np.zeros((len(points), 2, 4 + len(self.distortion)))
        by_parameters[:, 0, 0], by_parameters[:, 1, 1] = distorted[:, 0], distorted[:, 1]
        by_parameters[:, 0, 2] = by_parameters[:, 1, 3] = 1.0
        columns = [BROWN.index(name) for name in self.distortion]
        by_parameters[:, :, 4:] = by_coefficients[:, :, columns] * focal[:, None]
        return pixels, by_points, by_parameters

    def rays(self, points_px: Array) -> Array:
        """Return the unit rays, (N, 3), seen at image points (N, 2) px; the inverse of `project`.

        Newton's method on the distortion; NaN where the distortion cannot be inverted (beyond the radius at
        which it folds back).
        """
        wanted = (np.asarray(points_px, float) - [self.cx, self.cy]) / [self.fx, self.fy]
        normalised = wanted.copy()
        for _ in range(30):
            distorted, slope, _ = _brown_with_jacobians(normalised, self.coefficients)
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
        inverted = np.abs(_brown(normalised, self.coefficients) - wanted).max(axis=1) < 1e-9
        rays = np.column_stack([normalised, np.ones(len(normalised))])
        rays[~inverted] = np.nan
        return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))

    def to_dict(self) -> dict[str, float]:
        """Return the parameters by name."""
        return dict(zip(self.parameter_names, self.values.tolist(), strict=True))


def _radial_terms(points: Array, k: Array) -> tuple[Array, Array, Array, Array]:
    """Return r^2, numerator, denominator and radial factor of the rational distortion."""
    r2 = points[:, 0] ** 2 + points[:, 1] ** 2
    numerator = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
    denominator = 1.0 + r2 * (k[5] + r2 * (k[6] + r2 * k[7]))
    return r2, numerator, denominator, numerator / denominator


def _brown(points: Array, k: Array) -> Array:
    """Distort normalised points (N, 2): Brown's model with OpenCV's rational radial factor."""
    x, y = points[:, 0], points[:, 1]
    r2, _, _, radial = _radial_terms(points, k)
    p1, p2 = k[2], k[3]
    return np.column_stack(
        [
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        ]
    )


def _brown_with_jacobians(points: Array, k: Array) -> tuple[Array, Array, Array]:
    """Distort points; also the derivatives by the points (N, 2, 2) and by all 8 coefficients (N, 2, 8)."""
    x, y = points[:, 0], points[:, 1]
    r2, numerator, denominator, radial = _radial_terms(points, k)
    p1, p2 = k[2], k[3]
    numerator_slope = k[0] + r2 * (2.0 * k[1] + 3.0 * k[4] * r2)
    denominator_slope = k[5] + r2 * (2.0 * k[6] + 3.0 * k[7] * r2)
    slope = (numerator_slope - radial * denominator_slope) / denominator

    by_points = np.empty((len(points), 2, 2))
    by_points[:, 0, 0] = radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x
    by_points[:, 1, 1] = radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x
    by_points[:, 0, 1] = by_points[:, 1, 0] = 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y

    by_coefficients = np.zeros((len(points), 2, 8))
    powers = np.column_stack([r2, r2**2, r2**3])
    by_coefficients[:, :, [0, 1, 4]] = points[:, :, None] * (powers / denominator[:, None])[:, None, :]
    by_denominator = -(numerator / denominator**2)[:, None] * powers
    by_coefficients[:, :, 5:8] = points[:, :, None] * by_denominator[:, None, :]
    by_coefficients[:, 0, 2] = by_coefficients[:, 1, 3] = 2.0 * x * y
    by_coefficients[:, 1, 2] = r2 + 2.0 * y * y
    by_coefficients[:, 0, 3] = r2 + 2.0 * x * x
    return _brown(points, k), by_points, by_coefficients
