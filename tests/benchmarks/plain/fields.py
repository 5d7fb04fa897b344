"""Smooth fields over the target: orthonormal polynomials on the disc that the stars cover.

Every error of glass and print is a vector of their coefficients, those of X, then those of Y, in units of r0: a field
displaces the star at P by r0 times its value.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from calib.arrays import Array, Ints
from calib.view import View

#: Name in a passport's conditions under which it keeps the radius of the disc, mm.
FIELD_RADIUS = "field_radius_mm"
DEGREE = 7
DEGREES = np.array([d for d in range(DEGREE + 1) for _ in range(d + 1)])
K = len(DEGREES)
_EXPONENTS = np.array([(d - k, k) for d in range(DEGREE + 1) for k in range(d + 1)])
_GRID = 41  # Points along a diameter of the disc, so many that sums over them are as good as integrals


def _powers(points: Array) -> Array:
    """Return (N, K) the monomials of (N, 2) points."""
    x, y = (np.cumprod(np.column_stack([np.ones(len(u)), *[u] * DEGREE]), axis=1) for u in points.T)
    return np.asarray(x[:, _EXPONENTS[:, 0]] * y[:, _EXPONENTS[:, 1]])


def _disc() -> Array:
    """Return (M, 2) points that cover the unit disc evenly."""
    line = np.linspace(-1.0, 1.0, _GRID)
    points = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    return points[(points**2).sum(axis=1) <= 1.0]


def _triangle() -> Array:
    """Return (K, K) the upper triangle that makes the monomials orthonormal over the disc."""
    upper = np.linalg.qr(_powers(_DISC))[1] / np.sqrt(len(_DISC))
    return np.asarray(np.linalg.inv(upper * np.sign(np.diag(upper))[:, None]))


_DISC = _disc()
_TO_ORTHONORMAL = _triangle()
_ON_DISC = _powers(_DISC) @ _TO_ORTHONORMAL


@dataclass(frozen=True)
class Fields:
    """The polynomials over a disc of the target."""

    reference: tuple[float, float, float]  # x, y, r0, mm: the middle of the disc, and the unit of the fields
    radius_mm: float

    @classmethod
    def of(cls, views: Sequence[View], reference: tuple[float, float, float]) -> Fields:
        """Return the polynomials over the disc that the stars cover: for even cover, its radius^2 is 2 mean |P|^2."""
        stars = np.concatenate([view.target_mm for view in views]) - reference[:2]
        return cls(reference, float(np.sqrt(2.0 * (stars**2).sum(axis=1).mean())))

    @property
    def middle(self) -> Array:
        """(2,) the middle of the disc, mm."""
        return np.array(self.reference[:2])

    @property
    def r0(self) -> float:
        """The unit, mm."""
        return self.reference[2]

    def polynomials(self, points_mm: Array) -> Array:
        """Return (N, K) the polynomials at (N, 2) points of the target."""
        return np.asarray(_powers((points_mm - self.middle) / self.radius_mm) @ _TO_ORTHONORMAL)

    def shape(self, displacement: Callable[[Array], Array]) -> Array:
        """Return (2 K,) the coefficients of a displacement over r0, a function of h = (P - middle) / r0, (N, 2)."""
        h = _DISC * self.radius_mm / self.r0
        values = np.broadcast_to(displacement(h), h.shape)
        return np.asarray(_ON_DISC.T @ values / len(h)).T.reshape(-1)

    def shapes(self, displacements: Sequence[Callable[[Array], Array]]) -> Array:
        """Return (2 K, q) the coefficients of several displacements."""
        return np.column_stack([self.shape(displacement) for displacement in displacements])


def of_degrees(degrees: Sequence[int]) -> tuple[Array, Ints]:
    """Return (2 K, q) unit coefficients of X and of Y of these degrees, and (q,) the degree of each."""
    every = np.tile(DEGREES, 2)
    at = np.flatnonzero(np.isin(every, degrees))
    return np.eye(2 * K)[:, at], every[at]


def square(h: Array) -> Array:
    """Return (N, 1) the squared lengths of (N, 2) vectors."""
    return np.asarray((h * h).sum(axis=1, keepdims=True))


def along(h: Array, e: Array) -> Array:
    """Return (N, 1) the parts of (N, 2) vectors along e."""
    return np.asarray((h @ e)[:, None])


def coma(e: Array, t: Array, h: Array) -> Array:
    """Return the field (e h) t + (e t) h + (h t) e: coma, by a turn t, for a pupil beside the axis by e. h: (N, 2)."""
    return np.asarray(along(h, e) * t + float(e @ t) * h + along(h, t) * e)
