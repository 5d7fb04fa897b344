"""Smooth random fields over the target: orthonormal polynomials, and the shapes of known effects in them.

A field displaces the point P of the target by r_0 (sum_k c_k p_k(P)), with a coefficient c_k for X and another for Y.
The polynomials p_k have unit mean square over a disc. All shapes of third-order aberration theory, the bow and the
scale of a print, and a shift of the centre are such polynomials, so each of them is a vector of coefficients.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from calib.arrays import Array
from calib.view import View

#: Highest degree of a field.
DEGREE = 7
#: Degree of each polynomial.
DEGREES = np.array([d for d in range(DEGREE + 1) for _ in range(d + 1)])
#: Where a passport's conditions keep the radius of the disc of its fields, mm.
FIELD_RADIUS = "field_radius_mm"
_EXPONENTS = np.array([(d - k, k) for d in range(DEGREE + 1) for k in range(d + 1)])
#: Number of coefficients of a field: those of X, then those of Y.
COEFFICIENTS = 2 * len(DEGREES)
_GRID = 41
#: Half the base of a numerical derivative, as a share of the disc's radius: fields bend over a hundred times as much.
_STEP = 1e-3
#: Within this share of the disc's radius the scale of degree 7 is alike; at the edge it is nine times as large.
_TOLD = 0.6


def _powers(points: Array) -> Array:
    """Return (N, K) the monomials of (N, 2) points."""
    x, y = (np.cumprod(np.column_stack([np.ones(len(u)), *[u] * DEGREE]), axis=1) for u in points.T)
    return np.asarray(x[:, _EXPONENTS[:, 0]] * y[:, _EXPONENTS[:, 1]])


def _grid() -> Array:
    """Return (M, 2) points that cover the unit disc evenly."""
    line = np.linspace(-1.0, 1.0, _GRID)
    points = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    return points[(points**2).sum(axis=1) <= 1.0]


_DISC = _grid()


def _triangle() -> Array:
    """Return (K, K) the upper triangle that makes the monomials orthonormal over the disc."""
    upper = np.linalg.qr(_powers(_DISC))[1] / np.sqrt(len(_DISC))
    return np.asarray(np.linalg.inv(upper * np.sign(np.diag(upper))[:, None]))


_TO_ORTHONORMAL = _triangle()
#: (M, K) the polynomials on the grid.
_ON_DISC = _powers(_DISC) @ _TO_ORTHONORMAL


@dataclass(frozen=True)
class FieldBasis:
    """Orthonormal polynomials over a disc of the target."""

    reference: tuple[float, float, float]  # x, y, r, mm: the middle of the disc, and the unit of the fields
    radius_mm: float

    def polynomials(self, points_mm: Array) -> Array:
        """Return (N, K) the polynomials at (N, 2) points of the target."""
        return np.asarray(_powers((points_mm - self.reference[:2]) / self.radius_mm) @ _TO_ORTHONORMAL)

    def shape(self, displacement: Callable[[Array], Array]) -> Array:
        """Return (..., 2 K) the coefficients of polynomial fields, from displacements / r (..., N, 2).

        These are at the (N, 2) points (P - (x, y)) / r.
        """
        h = _DISC * self.radius_mm / self.reference[2]
        coefficients = np.swapaxes(_ON_DISC.T @ displacement(h) / len(h), -1, -2)
        return coefficients.reshape(*coefficients.shape[:-2], -1)

    def scale_at(self, point_mm: Array) -> Array:
        """Return (2 K,) the share by which a field with each coefficient alone enlarges the target about a point.

        It is half the divergence: the mean of the scales along X and Y. Of a point near the disc's edge or beyond, it
        is that of the nearest one within, where stars tell the fields.
        """
        step_mm, off = _STEP * self.radius_mm, point_mm - self.reference[:2]
        near = self.reference[:2] + off * min(
            1.0, _TOLD * self.radius_mm / max(float(np.hypot(*off)), step_mm)
        )
        x, y = near + step_mm * np.array([[[1.0], [-1.0]]]) * np.eye(2)[:, None]
        along = [np.subtract(*self.polynomials(ends)) for ends in (x, y)]
        return 0.5 * self.reference[2] * np.concatenate(along) / (2.0 * step_mm)

    @cached_property
    def radial(self) -> Array:
        """(2 K, 2) distortion of the collimator: |h|^2 h and |h|^4 h."""
        return np.column_stack(
            [self.shape(lambda h: _square(h) * h), self.shape(lambda h: _square(h) ** 2 * h)]
        )

    def about_shifted_axis(self, sizes: Sequence[float]) -> Array:
        """Return (2 K, 2 n) what radial terms, times n sizes, become about an axis shifted along X, then along Y.

        In this order: |h|^2 e and (h e) h, of third order; |h|^4 e and |h|^2 (h e) h, of fifth.
        """
        return np.column_stack([self._shifted(e, sizes) for e in np.eye(2)])

    def _shifted(self, e: Array, sizes: Sequence[float]) -> Array:
        """Return (2 K, n) the same for one direction e."""
        along = [
            lambda h: _square(h) * e,
            lambda h: (h @ e)[:, None] * h,
            lambda h: _square(h) ** 2 * e,
            lambda h: _square(h) * (h @ e)[:, None] * h,
        ]
        return np.column_stack(
            [size * self.shape(direction) for size, direction in zip(sizes, along, strict=False)]
        )


def _square(h: Array) -> Array:
    """Return (N, 1) the squared lengths."""
    return np.asarray((h * h).sum(axis=1, keepdims=True))


def basis_of(views: Sequence[View], reference: tuple[float, float, float]) -> FieldBasis:
    """Return the polynomials over the disc that the stars cover: for even cover, its radius^2 is 2 mean |P|^2."""
    stars = np.concatenate([view.target_mm for view in views]) - reference[:2]
    return FieldBasis(reference, float(np.sqrt(2.0 * (stars**2).sum(axis=1).mean())))


def both(per_axis: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the places of coefficients of X and of Y whose polynomials are wanted."""
    wanted = np.flatnonzero(per_axis)
    return np.concatenate([wanted, wanted + len(DEGREES)])


def of_degree(degrees: NDArray[np.int64], degree: int) -> Array:
    """Return the unit vectors of the coefficients of one degree, scaled so that the field's mean square is 1."""
    own = np.flatnonzero(degrees == degree)
    return np.eye(len(degrees))[:, own] / np.sqrt(degree + 1.0)
