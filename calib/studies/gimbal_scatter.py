"""Fit of a gimbal with the scatter that the stated covariance of the rotations does not explain.

A collimator with errors moves each rotation a little, and so does a gimbal that wobbles. This scatter is estimated and
added to the covariance. Without it, errors that all rotations share (an uncertain focal length) would absorb the
scatter, and the scales would be absurd, far below 1. This is known as Peelle's pertinent puzzle.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, special

from calib.studies.gimbal_model import GimbalModel
from calib.studies.hand_eye_fit import GimbalFit, Metric, global_fit, mirrored_forward, refine

Array = NDArray[np.float64]

#: Probability that a consistent gimbal is reported as inconsistent.
INCONSISTENT = 1e-3
_SMALLEST_EXCESS_RAD = 1e-7


@dataclass(frozen=True, eq=False)
class Explanation:
    """A model of the readings, fitted to the poses that it keeps."""

    kept: NDArray[np.int64]  # (k,) int64 increasing indices of the poses used
    fit: GimbalFit
    metric: Metric  # Covariance of the kept rotations with the additional variance
    criterion: float  # Bayesian information criterion (Schwarz, 1978); smaller is better

    @property
    def excess_rad(self) -> float:
        """Additional scatter of each component of a rotation, 1 sigma, rad."""
        return float(np.sqrt(self.metric.excess))


@dataclass(frozen=True, eq=False)
class SeenRotations:
    """Rotations seen, with their stated covariance.

    rotations: (n, 3, 3) float64 rotations, camera <- target.
    covariance: (3 n, 3 n) float64 joint covariance of the rotation vectors, rad^2.
    """

    rotations: Array
    covariance: Array
    _metrics: dict[tuple[int, ...], Metric] = field(default_factory=dict, init=False, repr=False)

    def metric(self, kept: NDArray[np.int64]) -> Metric:
        """Return the stated metric of a part of the poses.

        kept: (k,) int64 indices of the poses.
        Returns: Without additional variance.
        """
        key = tuple(kept.tolist())
        if key not in self._metrics:
            rows = (3 * kept[:, None] + np.arange(3)).ravel()
            self._metrics[key] = Metric.of(self.covariance[np.ix_(rows, rows)])
        return self._metrics[key]

    def explain(
        self, model: GimbalModel, kept: NDArray[np.int64], near: GimbalFit, values: Array
    ) -> Explanation:
        """Fit a model, and estimate the scatter that the stated covariance does not explain.

        The additional variance makes the chi-square equal to its degrees of freedom (Paule and Mandel, 1982). It is
        zero if the chi-square is below its 99.9 % quantile without it.

        kept: (k,) int64 increasing indices of the poses used.
        values: (p,) start of the values.
        Returns: The fit with the additional variance.
        """
        seen, stated = self.rotations[kept], self.metric(kept)
        start = replace(stated, excess=1.0)
        fit = refine(seen, model, start, near.camera_from_head, near.base_from_target, values)
        fit = mirrored_forward(seen, fit, start)
        freedom = fit.degrees_of_freedom()
        scatter = float(fit.off @ fit.off) / max(freedom, 1)

        def excessive(log_excess: float) -> float:
            nonlocal fit
            metric = replace(stated, excess=float(np.exp(log_excess)))
            fit = refine(seen, model, metric, fit.camera_from_head, fit.base_from_target, fit.values)
            return float(np.log(max(fit.chi_square, 1e-9) / max(freedom, 1)))

        wide = fit
        without = refine(seen, model, stated, wide.camera_from_head, wide.base_from_target, wide.values)
        without = mirrored_forward(seen, without, stated)
        if freedom <= 0 or without.chi_square <= special.chdtri(freedom, INCONSISTENT):
            return Explanation(kept, without, stated, self.information_criterion(without, kept, 0.0))
        high = low = float(np.log(max(scatter, _SMALLEST_EXCESS_RAD**2)))
        while excessive(high) > 0 and high < 0:
            high += 1.0
        while excessive(low) < 0 and low > 2 * np.log(_SMALLEST_EXCESS_RAD):
            high, low = low, low - 2.0
        if excessive(low) > 0 > excessive(high):
            high = float(optimize.brentq(excessive, low, high, xtol=2e-3))
        excessive(high)
        metric = replace(stated, excess=float(np.exp(high)))
        return Explanation(kept, fit, metric, self.information_criterion(fit, kept, metric.excess))

    def chi_square(self, known: Explanation, excess: float) -> float:
        """Return the chi-square of an explanation with another additional variance.

        excess: Additional variance, rad^2.
        Returns: Chi-square of its fit, refined with this variance.
        """
        fit = known.fit
        return refine(
            self.rotations[known.kept],
            fit.model,
            replace(known.metric, excess=excess),
            fit.camera_from_head,
            fit.base_from_target,
            fit.values,
        ).chi_square

    def information_criterion(self, fit: GimbalFit, kept: NDArray[np.int64], excess: float) -> float:
        """Return the Bayesian information criterion (Schwarz, 1978); each left-out pose counts three parameters.

        kept: (k,) int64 indices of the poses kept.
        excess: Additional variance, rad^2.
        """
        variances = self.metric(np.arange(len(self.rotations))).eigenvalues + excess
        count = 3 * len(self.rotations)
        parameters = len(fit.off) - fit.degrees_of_freedom() + count - 3 * len(kept)
        known = variances[variances > 1e-12 * variances.max()]
        return float(np.log(known).sum() + fit.chi_square + parameters * np.log(count))


def first_explanation(seen: SeenRotations, model: GimbalModel, values: Array) -> Explanation:
    """Fit the gimbal without faults from several starts.

    values: (p,) start of the scales.
    Returns: The lowest minimum. The first search uses equal weights for all rotations.
    """
    kept = np.arange(len(seen.rotations))
    equal = replace(seen.metric(kept), excess=1.0)
    wide = global_fit(seen.rotations, model, equal, values)[0]
    return seen.explain(model, kept, wide, wide.values)
