"""The robust losses of the adjustment: costs of weighted residuals, and their derivatives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from calib.arrays import Array

LossName = Literal["l2", "huber", "cauchy"]


@dataclass(frozen=True)
class Loss:
    """A cost rho of the length e of a weighted residual, quadratic near zero.

    Above it is linear (huber) or logarithmic (cauchy); ``l2`` is e^2 / 2, as huber without a limit. Huber (1964) is the
    loss of arXiv:2512.16092, eq. 7, divided by two. The loss leaves the parabola at the length ``limit``, in standard
    deviations.
    """

    name: LossName
    limit: float = np.inf

    def costs(self, lengths: Array) -> Array:
        """Return the costs of (N,) lengths of weighted residuals.

        ``huber``: Huber (1964). ``cauchy``: Holland and Welsch (1977), limit^2 / 2 log(1 + (e / limit)^2).
        """
        if self.name == "cauchy":
            return np.asarray(0.5 * self.limit**2 * np.log1p((lengths / self.limit) ** 2))
        inside = np.minimum(lengths, self.limit)
        return np.asarray(inside * (lengths - 0.5 * inside))

    def weights(self, lengths: Array) -> Array:
        """Return (N,) weights rho'(e) / e, 0 to 1, of (N,) lengths (Huber, 1964; Holland and Welsch, 1977)."""
        if self.name == "cauchy":
            return np.asarray(1.0 / (1.0 + (lengths / self.limit) ** 2))
        return np.divide(self.limit, lengths, out=np.ones_like(lengths), where=lengths > self.limit)

    def second_derivatives(self, lengths: Array) -> Array:
        """Return (N,) rho''(e) along the residuals (losses as in `costs`); negative where Cauchy's is concave."""
        if self.name == "cauchy":
            return np.asarray((1.0 - (lengths / self.limit) ** 2) * self.weights(lengths) ** 2)
        return np.where(lengths <= self.limit, 1.0, 0.0)

    def curvature_root(self, residuals: Array) -> Array:
        """Return the (2, 2, N) square roots of the second derivatives of rho in the plane of (N, 2) residuals.

        The curvature is rho'' along the residual (zero where negative, so that every step descends) and rho' / e across
        it: Triggs et al. (2000), section 4.3, who also limit it where it is negative; the root is this project's own.
        """
        distance = lengths(residuals)
        ux, uy = residuals.T / np.maximum(distance, np.finfo(float).tiny)
        along = np.sqrt(np.maximum(self.second_derivatives(distance), 0.0))
        across = np.sqrt(self.weights(distance))
        excess = along - across
        shared = excess * ux * uy
        return np.array([[across + excess * ux * ux, shared], [shared, across + excess * uy * uy]])


def lengths(residuals: Array) -> Array:
    """Return the (N,) lengths of (N, 2) residuals."""
    x, y = residuals.T
    return np.asarray(np.sqrt(x * x + y * y))
