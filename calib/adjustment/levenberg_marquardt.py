"""The adjustment: minimisation of the robust cost by the Levenberg-Marquardt algorithm.

The robust loss acts on the length of each star's weighted residual (arXiv:2512.16092, eqs. 6 and 7). It enters by its
gradient and by its curvature along and across the residual, so that the search converges as fast as for least squares
(compare Triggs et al., 2000, on robust Gauss-Newton).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.adjustment import search_kernel
from calib.adjustment.bundle import Bundle
from calib.adjustment.loss import Loss
from calib.adjustment.parameters import AdjustmentParameters
from calib.adjustment.state import packed, state_places, unpacked

__all__ = [
    "MAX_ITERATIONS",
    "RELATIVE_TOLERANCE",
    "Loss",
    "Refinement",
    "refine",
    "tolerances",
]

Array = NDArray[np.float64]

#: A predicted reduction below this share of the cost is far below the uncertainty of the parameters.
RELATIVE_TOLERANCE = 1e-12
_ABSOLUTE_TOLERANCE = 1e-16
#: Largest number of steps tried, unless told.
MAX_ITERATIONS = 100
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
    views: Sequence[int] | None = None,
) -> Refinement:
    """Minimise the robust cost (Marquardt, 1963; damping by the rule of Nielsen, 1999).

    loss: Cost of a weighted residual.
    tolerance: The refinement ends when the predicted reduction is below this share of the cost.
    views: Indices of the views that take part; None for all. The starting values are those of these views.
    Returns: ``converged`` is False if the number of steps was reached, or if a star cannot be projected at
      the start.
    """
    obs, state = bundle.observations, packed(start)
    rotations, offsets = start.rotations.copy(), start.offsets.copy()
    cost, converged, iterations = search_kernel.search(
        obs.target_rows,
        obs.point_rows,
        obs.factors,
        obs.bounds if views is None else obs.bounds[list(views)],
        start.camera.is_fisheye,
        state_places(bundle.names),
        state,
        rotations,
        offsets,
        bundle.free_centres,
        loss.number,
        float(loss.limit),
        max_iterations,
        tolerances(bundle, tolerance),
    )
    camera, collimator = unpacked(start, state)
    end = AdjustmentParameters(camera, collimator, rotations, offsets, start.gimbal)
    return Refinement(end, cost, converged, iterations)


def tolerances(bundle: Bundle, tolerance: float) -> Array:
    """Return the tolerances of `calib.adjustment.search_kernel.search`.

    Returns: (3,) relative and absolute tolerance, and how much rounding changes the root of twice the cost.
    """
    return np.array([tolerance, _ABSOLUTE_TOLERANCE, _rounding(bundle, 0.5)])


def _rounding(bundle: Bundle, cost: float) -> float:
    """Return how much rounding of the image points changes the cost.

    A smaller predicted reduction cannot be verified. For stars known to thousandths of a pixel, this limit exceeds
    `RELATIVE_TOLERANCE`. Each residual has a random error of the machine's epsilon times its coordinates. Own estimate:
    independent errors d of the residuals e change sum e^2 / 2 by about d (sum e^2)^(1/2) = d (2 cost)^(1/2).
    """
    obs = bundle.observations
    return _ROUNDED_OPERATIONS * _EPSILON * obs.farthest_px * obs.sigmas_per_px * math.sqrt(2.0 * cost)
