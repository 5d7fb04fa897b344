"""The adjustment: minimisation of the robust cost by the Levenberg-Marquardt algorithm.

The robust loss acts on the length of each star's weighted residual (arXiv:2512.16092, eqs. 6 and 7). It enters by its
gradient and by its curvature along and across the residual, so that the search converges as fast as for least squares
(compare Triggs et al., 2000, on robust Gauss-Newton).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, Self, TypeVar

import numpy as np

from calib.adjustment.bundle import ViewEquations
from calib.adjustment.loss import Loss
from calib.arrays import Array

#: A predicted reduction below this share of the cost is far below the uncertainty of the parameters.
RELATIVE_TOLERANCE = 1e-12
#: Of points without any error, whose cost is 0.
_ABSOLUTE_TOLERANCE = 1e-16
#: Largest number of steps tried, unless told: it ends a search that goes on without an end.
MAX_ITERATIONS = 100
#: The search stops when the damping exceeds this: steps are then as small as rounding.
_MAX_DAMPING = 1e12
#: Focal length and radius lie along a curved valley, and a damped step follows its tangent only. Little damping needs
#: fewer steps, and more starts reach the bottom.
_FIRST_DAMPING = 1e-6


class Adjusted(Protocol):
    """The unknowns of an adjustment."""

    def after_step(self, names: Sequence[str], shared: Array, local: Array, /) -> Self:
        """Return the unknowns after a step: (G,) increments of the shared ones, (n, L) of those of each view."""


A = TypeVar("A", bound=Adjusted)
A_contra = TypeVar("A_contra", bound=Adjusted, contravariant=True)


class Adjustable(Protocol[A_contra]):
    """What an adjustment minimises: a bundle of views, or of the boards before a rig."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the shared unknowns."""

    def equations(self, parameters: A_contra, loss: Loss, /) -> ViewEquations:
        """Return the normal equations, with the cost of each view."""

    def rounding(self, cost: float, /) -> float:
        """Return how much rounding of the image points changes the cost."""


@dataclass(frozen=True)
class Refinement(Generic[A]):
    """The end of a refinement."""

    parameters: A
    cost: float
    converged: bool  # Whether no further step promises a reduction above the tolerance
    iterations: int


@np.errstate(all="ignore")  # a step may lead where nothing can be projected
def refine(
    bundle: Adjustable[A],
    start: A,
    loss: Loss,
    max_iterations: int = MAX_ITERATIONS,
    tolerance: float = RELATIVE_TOLERANCE,
) -> Refinement[A]:
    """Minimise the robust cost (Marquardt, 1963; damping by the rule of Nielsen, 1999).

    It ends when the predicted reduction is below the share ``tolerance`` of the cost. ``converged`` is False if the
    number of steps was reached, or if a star cannot be projected at the start.
    """
    parameters, equations = start, bundle.equations(start, loss)
    cost = equations.costs.sum()
    if not np.isfinite(cost):
        return Refinement(start, math.inf, False, 0)
    damping, growth, iteration = _FIRST_DAMPING, 2.0, 0
    while iteration < max_iterations and damping < _MAX_DAMPING:
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
        there = bundle.equations(moved, loss)
        gain = 2.0 * (cost - there.costs.sum()) / predicted
        if gain > 0.0:
            parameters, cost, equations = moved, there.costs.sum(), there
            # Nielsen takes a third as the least factor; with a tenth, damping is little again after fewer steps.
            damping, growth = damping * max(0.1, 1.0 - (2.0 * gain - 1.0) ** 3), 2.0
        elif predicted * (1.0 + damping) <= bundle.rounding(cost):
            return Refinement(parameters, float(cost), True, iteration)
        else:
            damping, growth = damping * growth, growth * 2.0
    return Refinement(parameters, float(cost), False, iteration)
