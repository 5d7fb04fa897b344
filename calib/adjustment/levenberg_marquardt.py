"""Refinement: the state of least robust cost, by Levenberg-Marquardt.

Knows cost functions and steps; what is minimised is a `Bundle`. The robust loss acts on the length
of each star's residual vector, through its gradient and its own curvature along and across the residual,
so that the search converges as fast as it does for least squares.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.adjustment.bundle import Bundle
from calib.adjustment.normal_equations import NormalEquations
from calib.adjustment.parameters import AdjustmentParameters
from calib.errors import InputMismatch

Array = NDArray[np.float64]

#: A promised reduction below this share of the cost a star has is far below the parameters' own uncertainty.
RELATIVE_TOLERANCE = 1e-12
_ABSOLUTE_TOLERANCE = 1e-16
#: Focal length and radius lie along a bent valley, of which the damped step follows the tangent only: the less damping,
#: the fewer steps, and the more starts reach its bottom.
_FIRST_DAMPING = 1e-6
_MAX_DAMPING = 1e12
#: A projection is a few operations, each of them rounded.
_ROUNDED_OPERATIONS = 10.0


@dataclass(frozen=True)
class Loss:
    """A cost rho of the residual's length e, quadratic near zero.

    Parameters
    ----------
    name
        ``l2``: e^2 / 2. ``huber``: linear beyond the limit. ``cauchy``: logarithmic beyond it.
    limit
        The length where it leaves the parabola, in units of the residual.
    """

    name: str
    limit: float = float("inf")

    def __post_init__(self) -> None:
        if self.name not in ("l2", "huber", "cauchy"):
            raise InputMismatch(f"Unknown loss {self.name!r}.", remedy="Known: l2, huber, cauchy.")

    def cost(self, lengths: Array) -> float:
        """Return the sum of rho(e)."""
        if self.name == "huber" and np.isfinite(self.limit):
            inside = np.minimum(lengths, self.limit)
            return float((inside * (lengths - 0.5 * inside)).sum())
        if self.name == "cauchy" and np.isfinite(self.limit):
            return float(0.5 * self.limit**2 * np.log1p((lengths / self.limit) ** 2).sum())
        return float(0.5 * (lengths**2).sum())

    def weights(self, lengths: Array) -> Array:
        """Return rho'(e) / e for each star."""
        if self.name == "huber" and np.isfinite(self.limit):
            return np.asarray(self.limit / np.maximum(lengths, self.limit))
        if self.name == "cauchy" and np.isfinite(self.limit):
            return np.asarray(1.0 / (1.0 + (lengths / self.limit) ** 2))
        return np.ones_like(lengths)

    def second_derivatives(self, lengths: Array) -> Array:
        """Return rho''(e) for each star: how fast its pull grows along the residual."""
        if self.name == "huber" and np.isfinite(self.limit):
            return np.where(lengths <= self.limit, 1.0, 0.0)
        if self.name == "cauchy" and np.isfinite(self.limit):
            return np.asarray((1.0 - (lengths / self.limit) ** 2) * self.weights(lengths) ** 2)
        return np.ones_like(lengths)

    def curvature_root(self, residuals: Array) -> Array | None:
        """Return (N, 2, 2) symmetric roots of rho's second derivatives in the plane; None: all unity.

        rho'' along the residual (not below zero, so that a step descends), rho' / e across it.
        """
        if not np.isfinite(self.limit):
            return None
        lengths = np.linalg.norm(residuals, axis=1)
        unit = residuals / np.maximum(lengths, np.finfo(float).tiny)[:, None]
        along = np.sqrt(np.maximum(self.second_derivatives(lengths), 0.0))
        across = np.sqrt(self.weights(lengths))
        outer = unit[:, :, None] * unit[:, None, :]
        return np.asarray(across[:, None, None] * np.eye(2) + (along - across)[:, None, None] * outer)


@dataclass(frozen=True)
class Refinement:
    """Where a refinement ended.

    Attributes
    ----------
    state
        The state of least cost found.
    cost
        Its robust cost.
    converged
        Whether no step promises a reduction worth taking.
    iterations
        Steps tried.
    """

    parameters: AdjustmentParameters
    cost: float
    converged: bool
    iterations: int


def refine(
    bundle: Bundle,
    start: AdjustmentParameters,
    loss: Loss,
    max_iterations: int = 100,
    tolerance: float = RELATIVE_TOLERANCE,
) -> Refinement:
    """Minimise the robust cost from a start (Levenberg-Marquardt, Nielsen's rule for the damping).

    Parameters
    ----------
    bundle
        Stars and free parameters.
    start
        Where to begin.
    loss
        The cost of a residual's length.
    max_iterations
        Bound on the steps tried.
    tolerance
        A step that promises to lower the cost by less than this share of it is not worth taking.

    Returns
    -------
    Refined
        ``converged`` is False when the bound was met or the start cannot be projected.
    """
    parameters, (cost, equations) = start, _linearised(bundle, start, loss)
    damping, growth, iteration = _FIRST_DAMPING, 2.0, 0
    while equations is not None and iteration < max_iterations and damping < _MAX_DAMPING:
        iteration += 1
        try:
            shared, local = equations.damped(damping).step()
        except np.linalg.LinAlgError:
            damping, growth = damping * growth, growth * 2.0
            continue
        promised = equations.decrement(shared, local)
        if promised * (1.0 + damping) <= tolerance * cost + _ABSOLUTE_TOLERANCE:
            return Refinement(parameters, cost, converged=True, iterations=iteration)
        candidate = parameters.after_step(bundle.names, shared, local)
        candidate_cost = loss.cost(_lengths(_residuals(bundle, candidate))) + bundle.prior_cost(candidate)
        gain = 2.0 * (cost - candidate_cost) / promised
        if gain > 0.0:
            parameters, (cost, equations) = candidate, _linearised(bundle, candidate, loss)
            damping, growth = damping * max(0.1, 1.0 - (2.0 * gain - 1.0) ** 3), 2.0
        elif promised * (1.0 + damping) <= _rounding(bundle, cost):
            return Refinement(parameters, cost, converged=True, iterations=iteration)
        else:
            damping, growth = damping * growth, growth * 2.0
    return Refinement(parameters, cost, converged=False, iterations=iteration)


def _rounding(bundle: Bundle, cost: float) -> float:
    """Return how far rounding of the image points moves the cost: a step that promised less cannot be judged by it.

    Where stars are known to thousandths of a pixel this exceeds `RELATIVE_TOLERANCE`. Each residual is off by the
    machine's epsilon of its coordinates, at random.
    """
    obs = bundle.observations
    each = np.finfo(float).eps * float(np.abs(obs.points_px).max()) * obs.sigmas_per_px
    return float(_ROUNDED_OPERATIONS * each * np.sqrt(2.0 * cost))


def _linearised(
    bundle: Bundle, parameters: AdjustmentParameters, loss: Loss
) -> tuple[float, NormalEquations | None]:
    """Return the cost at a state and the normal equations there; none where a star cannot be projected."""
    residuals = _residuals(bundle, parameters)
    lengths = _lengths(residuals)
    cost = loss.cost(lengths) + bundle.prior_cost(parameters)
    if not np.isfinite(cost):
        return float("inf"), None
    influence = residuals * loss.weights(lengths)[:, None]
    return cost, bundle.normal_equations(parameters, influence, loss.curvature_root(residuals))


def _residuals(bundle: Bundle, parameters: AdjustmentParameters) -> Array:
    """Return (N, 2) residuals; infinite where a star cannot be projected."""
    with np.errstate(invalid="ignore", over="ignore"):
        residuals = bundle.weighted_residuals(parameters)
    return np.where(np.isfinite(residuals), residuals, np.inf)


def _lengths(residuals: Array) -> Array:
    """Return (N,) lengths of residuals."""
    return np.asarray(np.linalg.norm(residuals, axis=1))
