"""How sure the estimates are: their covariance at the optimum.

Knows residuals and normal equations. The covariance rests on what the residuals themselves show, not on what
the stars' covariances promise, and is that of an M-estimator: J^T J inverted, times the variance of the
influence function over the square of its mean slope (Huber's formula).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.bundle import Bundle, State
from calib.errors import DegenerateViews
from calib.refine import Loss

Array = NDArray[np.float64]

#: Below this, the information matrix scaled to a unit diagonal is singular to working precision.
_SINGULAR = 1e-13


@dataclass(frozen=True)
class Uncertainty:
    """Covariance of the shared parameters.

    Attributes
    ----------
    covariance
        (G, G), in the order of the bundle's names.
    variance_factor
        Estimated variance of a weighted residual component.
    degrees_of_freedom
        Measured components less estimated parameters.
    """

    covariance: Array
    variance_factor: float
    degrees_of_freedom: int


def at_optimum(bundle: Bundle, state: State, loss: Loss) -> Uncertainty:
    """Return the covariance of the shared parameters at the optimum.

    Raises
    ------
    DegenerateViews
        When there are no more measurements than parameters, or the views leave a parameter free.
    """
    residuals = bundle.residuals(state)
    lengths = np.linalg.norm(residuals, axis=1)
    equations = bundle.normal_equations(state, residuals)
    parameters = len(bundle.names) + equations.local_gradient.size
    freedom = 2 * len(lengths) - parameters
    if freedom <= 0:
        raise DegenerateViews(
            f"{2 * len(lengths)} measurements for {parameters} parameters.",
            remedy="Add views, or views with more stars.",
        )
    influence = loss.weights(lengths) * lengths
    # The mean of rho's second derivative over directions in the plane: half its trace.
    slope = 0.5 * (loss.weights(lengths) + loss.slopes(lengths)).mean()
    factor = float((influence**2).sum() / freedom / slope**2)
    return Uncertainty(factor * _inverse(equations.reduced(), bundle.names), factor, freedom)


def _inverse(information: Array, names: tuple[str, ...]) -> Array:
    """Invert the reduced information; name the parameter that it leaves free, if it does."""
    diagonal = np.diag(information)
    if not (diagonal > 0).all():
        free = names[int(np.argmin(diagonal))]
        raise DegenerateViews(f"These views say nothing about {free}.", remedy="Add views from other angles.")
    scale = 1.0 / np.sqrt(diagonal)
    eigenvalues, vectors = np.linalg.eigh(information * np.outer(scale, scale))
    if eigenvalues[0] < _SINGULAR * eigenvalues[-1]:
        worst = np.argsort(-np.abs(vectors[:, 0]))[:2]
        free = " and ".join(names[i] for i in sorted(worst))
        raise DegenerateViews(
            f"These views do not tell {free} apart.", remedy="Add views turned about other axes."
        )
    return np.asarray((vectors / eigenvalues) @ vectors.T * np.outer(scale, scale))
