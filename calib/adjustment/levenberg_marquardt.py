"""The adjustment: minimisation of the robust cost by the Levenberg-Marquardt algorithm.

The robust loss acts on the length of each star's weighted residual (arXiv:2512.16092, eqs. 6 and 7). It enters by its
gradient and by its curvature along and across the residual, so that the search converges as fast as for least squares
(compare Triggs et al., 2000, on robust Gauss-Newton).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from calib.adjustment.bundle import Bundle
from calib.adjustment.loss import Loss
from calib.adjustment.parameters import AdjustmentParameters

#: A predicted reduction below this share of the cost is far below the uncertainty of the parameters.
RELATIVE_TOLERANCE = 1e-12
_ABSOLUTE_TOLERANCE = 1e-16
#: Largest number of steps tried, unless told.
MAX_ITERATIONS = 100
#: The search stops when the damping exceeds this.
_MAX_DAMPING = 1e12
#: Focal length and radius lie along a curved valley, and a damped step follows its tangent only. Little damping needs
#: fewer steps, and more starts reach the bottom.
_FIRST_DAMPING = 1e-6
#: Number of rounded operations in a projection.
_ROUNDED_OPERATIONS = 10.0
_EPSILON = float(np.finfo(float).eps)


@dataclass(frozen=True)
class Refinement:
    """The end of a refinement."""

    parameters: AdjustmentParameters
    cost: float
    converged: bool  # Whether no further step promises a reduction above the tolerance
    iterations: int


def refine(
    bundle: Bundle,
    start: AdjustmentParameters,
    loss: Loss,
    max_iterations: int = MAX_ITERATIONS,
    tolerance: float = RELATIVE_TOLERANCE,
) -> Refinement:
    """Minimise the robust cost (Marquardt, 1963; damping by the rule of Nielsen, 1999).

    It ends when the predicted reduction is below the share ``tolerance`` of the cost. ``converged`` is False if the
    number of steps was reached, or if a star cannot be projected at the start.
    """
    with np.errstate(all="ignore"):  # a step may lead where nothing can be projected
        return _search(bundle, start, loss, max_iterations, tolerance)


def _search(
    bundle: Bundle, start: AdjustmentParameters, loss: Loss, max_iterations: int, tolerance: float
) -> Refinement:
    parameters, cost = start, bundle.costs(start, loss).sum()
    if not np.isfinite(cost):
        return Refinement(start, math.inf, False, 0)
    damping, growth, iteration, equations = _FIRST_DAMPING, 2.0, 0, None
    while iteration < max_iterations and damping < _MAX_DAMPING:
        equations = equations or bundle.equations(parameters, loss)
        iteration += 1
        try:
            shared, local = equations.step(damping)
        except np.linalg.LinAlgError:
            damping, growth = damping * growth, growth * 2.0
            continue
        # Gradient times step: twice the predicted reduction of the cost.
        predicted = equations.right[:, : len(shared)].sum(axis=0) @ shared
        predicted += (equations.right[:, len(shared) :] * local).sum()
        if predicted * (1.0 + damping) <= tolerance * cost + _ABSOLUTE_TOLERANCE:
            return Refinement(parameters, float(cost), True, iteration)
        moved = parameters.after_step(bundle.names, shared, local)
        new_cost = bundle.costs(moved, loss).sum()
        gain = 2.0 * (cost - new_cost) / predicted
        if gain > 0.0:
            parameters, cost, equations = moved, new_cost, None
            damping, growth = damping * max(0.1, 1.0 - (2.0 * gain - 1.0) ** 3), 2.0
        elif predicted * (1.0 + damping) <= _rounding(bundle, cost):
            return Refinement(parameters, float(cost), True, iteration)
        else:
            damping, growth = damping * growth, growth * 2.0
    return Refinement(parameters, float(cost), False, iteration)


def _rounding(bundle: Bundle, cost: float) -> float:
    """Return how much rounding of the image points changes the cost.

    A smaller predicted reduction cannot be verified. For stars known to thousandths of a pixel, this limit exceeds
    `RELATIVE_TOLERANCE`. Each residual has a random error of the machine's epsilon times its coordinates. Own estimate:
    independent errors d of the residuals e change sum e^2 / 2 by about d (sum e^2)^(1/2) = d (2 cost)^(1/2).
    """
    obs = bundle.observations
    return _ROUNDED_OPERATIONS * _EPSILON * obs.farthest_px * obs.sigmas_per_px * math.sqrt(2.0 * cost)
