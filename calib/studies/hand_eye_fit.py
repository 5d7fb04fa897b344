"""Fit of a gimbal's readings to the rotations that a camera saw: closed-form starts, refinement, global optimum.

The camera is mounted on the gimbal's head with an unknown rotation A, and the gimbal's base stands before the target
with an unknown rotation B: R = A Rz(roll) Rx(tilt) Rz(squareness) Ry(pan) B. This is the rotation part of the
robot-world and hand-eye problem (Tsai and Lenz, 1989; Zhuang, Roth and Sudhakar, 1994). The sum of squares can have
more than one minimum. So several starts are refined and the lowest minimum is used.

A collimator with errors moves each rotation a little, and so does a gimbal that wobbles. This scatter is estimated and
added to the covariance. Without it, errors that all rotations share (an uncertain focal length) would absorb the
scatter, and the scales would be absurd, far below 1. This is known as Peelle's pertinent puzzle.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, special

from calib.model.gimbal import mountings
from calib.model.rotation import exp_map, log_map
from calib.studies.gimbal_model import GimbalModel

Array = NDArray[np.float64]

#: Eigenvalues of the covariance below this share of the largest are treated as exactly known combinations.
_SINGULAR = 1e-12
#: A direction of the parameters is determined if its singular value exceeds this share of the largest.
_DETERMINED = 1e-7
_STEPS = 60
#: Diagonals of half turns about x, y and z, and the signs that they give to pan, tilt and roll.
_MIRRORS = [
    (np.array([1.0, -1.0, -1.0]), (-1, 1, -1)),
    (np.array([-1.0, 1.0, -1.0]), (1, -1, -1)),
    (np.array([-1.0, -1.0, 1.0]), (-1, -1, 1)),
]
#: Starts whose elements differ by less than this lead to the same minimum.
_SAME = 1e-3


@dataclass(frozen=True)
class Metric:
    """Covariance of the rotations, ready for weighting: eigenvalues, eigenvectors in columns, and excess, all rad^2."""

    eigenvalues: Array
    vectors: Array
    excess: float = 0.0

    @classmethod
    def of(cls, covariance: Array) -> Metric:
        """Return the metric of a (3 n, 3 n) covariance of rotation vectors, rad^2, without additional variance."""
        eigenvalues, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
        return cls(np.maximum(eigenvalues, 0.0), vectors)

    @cached_property
    def whitening(self) -> Array:
        """(3 n, 3 n) float64 W with W^T W = inverse of the covariance; 1/rad."""
        variances = self.eigenvalues + self.excess
        known = variances > _SINGULAR * variances.max()
        return np.asarray((self.vectors[:, known] / np.sqrt(variances[known])) @ self.vectors[:, known].T)

    @property
    def covariance(self) -> Array:
        """(3 n, 3 n) float64 covariance with the additional variance, rad^2."""
        return np.asarray((self.vectors * (self.eigenvalues + self.excess)) @ self.vectors.T)


@dataclass(frozen=True, eq=False)
class GimbalFit:
    """A minimum of the sum of squares."""

    model: GimbalModel
    # camera_from_head, base_from_target: (3, 3) float64 rotations A and B.
    camera_from_head: Array
    base_from_target: Array
    values: Array  # (p,) float64 scales, slips (rad), squareness (rad) and bends (rad)
    off: Array  # (3 n,) float64 seen minus read, as rotation vectors about the camera's axes, rad
    jacobian: Array  # (3 n, 6 + p) float64 derivatives of the rotations by A, B and the values
    chi_square: float

    def degrees_of_freedom(self) -> int:
        """Return the number of measured components minus the number of determined parameters."""
        return len(self.off) - int(np.linalg.matrix_rank(_unit_columns(self.jacobian)[0], tol=_DETERMINED))

    def undetermined_scales(self) -> bool:
        """Return whether different scales give the same rotations: an undetermined direction changes a scale."""
        columns, _ = _unit_columns(self.jacobian)
        _, singular, vt = np.linalg.svd(columns)
        null = vt[np.append(singular, np.zeros(len(vt) - len(singular))) <= _DETERMINED * singular[0]]
        return bool((np.abs(null[:, 6 : 6 + len(self.model.free)]) > _SAME).any())

    def estimator(self, metric: Metric) -> Array:
        """Return the (6 + p, 3 n) estimator of A, B and the values: generalised least squares (Aitken, 1936)."""
        columns, lengths = _unit_columns(metric.whitening @ self.jacobian)
        return np.asarray(np.linalg.pinv(columns, rcond=_DETERMINED) @ metric.whitening / lengths[:, None])


def seen_minus_read(
    rotations: Array, model: GimbalModel, camera_from_head: Array, base_from_target: Array, values: Array
) -> tuple[Array, Array]:
    """Return (3 n,) seen minus read rotations, rad, and (3 n, 6 + p) derivatives of the latter by A, B and values.

    Own derivation: with R = E A G B, a rotation vector a on the left of A turns R by E a, and b on the left of B turns
    it by E A G b. A motor turns the head about its own axis. The bends are small: their derivative is taken at E = 1.
    """
    bends = model.bends
    direct = model.parameter_count - bends.shape[2]
    bent = exp_map(bends @ values[direct:]) if bends.shape[2] else np.eye(3)[None]
    mounted = bent @ camera_from_head
    heads, turning = model.heads(values)
    head = mounted @ heads
    off = log_map(rotations @ np.swapaxes(head @ base_from_target, 1, 2)).reshape(-1)
    columns = [np.broadcast_to(bent, rotations.shape), head, mounted @ turning, bends]
    return off, np.concatenate(columns, axis=2).reshape(len(off), -1)


def refine(
    rotations: Array,
    model: GimbalModel,
    metric: Metric,
    camera_from_head: Array,
    base_from_target: Array,
    values: Array,
) -> GimbalFit:
    """Refine a start of A, B and the (p,) values by the method of Levenberg (1944) and Marquardt (1963)."""

    def at(a: Array, b: Array, p: Array) -> GimbalFit:
        off, jacobian = seen_minus_read(rotations, model, a, b, p)
        return GimbalFit(model, a, b, p, off, jacobian, float(((metric.whitening @ off) ** 2).sum()))

    best, damping = at(camera_from_head, base_from_target, values.copy()), 1e-6
    for _ in range(_STEPS):
        columns, lengths = _unit_columns(metric.whitening @ best.jacobian)
        weighted = metric.whitening @ best.off
        u, singular, vt = np.linalg.svd(columns, full_matrices=False)
        kept = singular > _DETERMINED * singular[0]
        gains = np.where(kept, singular / (singular**2 + damping), 0.0)
        step = (vt.T @ (gains * (u.T @ weighted))) / lengths
        tried = at(
            exp_map(step[:3]) @ best.camera_from_head,
            exp_map(step[3:6]) @ best.base_from_target,
            best.values + step[6:],
        )
        gain = best.chi_square - tried.chi_square
        if gain < 0:
            damping = max(10.0 * damping, 1e-9)
            if damping > 1e8:
                break
            continue
        best, damping = tried, damping / 10.0
        if gain <= 1e-10 * (1.0 + best.chi_square):
            break
    return best


def global_fit(rotations: Array, model: GimbalModel, metric: Metric, values: Array) -> list[GimbalFit]:
    """Refine from all mountings that fit the rotations; return the minima that were found, by increasing chi-square.

    Minima with a scale below half or above twice its start are last, because a pan-tilt head with both A and the sign
    of an axis reversed gives the same rotations.
    """
    tried: list[Array] = []
    found = []
    for a, b in zip(*mountings(rotations, model.heads(values)[0]), strict=True):
        if all(np.abs(a - other).max() > _SAME for other in tried):
            tried.append(a)
            found.append(refine(rotations, model, metric, a, b, values))
    return sorted(found, key=lambda fit: (not scales_near(fit, values), fit.chi_square))


def mirrored_forward(rotations: Array, fit: GimbalFit, metric: Metric) -> GimbalFit:
    """Return the mirror image of a fit whose scales are positive, if the fit has negative scales and there is one.

    Half a turn of A and B about x reverses pan and roll, about y tilt and roll, about z pan and tilt. The rotations of
    the camera stay the same.
    """
    model, count = fit.model, len(fit.model.free)
    negative = fit.values[:count] < 0
    if not negative.any():
        return fit
    for turn, signs in _MIRRORS:
        if not (np.array([signs[axis] < 0 for axis in model.free]) == negative).all():
            continue
        values = fit.values.copy()
        values[:count] *= [signs[axis] for axis in model.free]
        for k, (axis, _) in enumerate(model.slips):
            values[count + k] *= signs[axis]
        if model.squareness:
            values[count + len(model.slips)] *= signs[2]
        return refine(
            rotations, model, metric, fit.camera_from_head * turn, (fit.base_from_target.T * turn).T, values
        )
    return fit


def scales_near(fit: GimbalFit, values: Array) -> bool:
    """Return whether all scales, which come first, lie between half and twice their start, the (p,) values.

    False for a scale that is negative or absurd, and for axes half a turn away from a right angle.
    """
    model, count = fit.model, len(fit.model.free)
    ratio = fit.values[:count] / values[:count]
    square = fit.values[count + len(model.slips)] if model.squareness else 0.0
    return bool(((ratio > 0.5) & (ratio < 2.0)).all() and abs(square) < 1.0)


def _unit_columns(matrix: Array) -> tuple[Array, Array]:
    """Return the matrix with columns of unit length, and their lengths; zero columns stay."""
    lengths = np.linalg.norm(matrix, axis=0)
    lengths = np.where(lengths > 0, lengths, 1.0)
    return matrix / lengths, lengths


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
    """Rotations seen, (n, 3, 3), camera <- target, and the (3 n, 3 n) covariance, rad^2, of their rotation vectors."""

    rotations: Array
    covariance: Array
    _metrics: dict[tuple[int, ...], Metric] = field(default_factory=dict, init=False, repr=False)

    def metric(self, kept: NDArray[np.int64]) -> Metric:
        """Return the stated metric of (k,) poses, without additional variance."""
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
        zero if the chi-square is below its 99.9 % quantile without it. The (k,) poses used increase.
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
        """Return the chi-square of an explanation, refined with another additional variance, rad^2."""
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
        """Return the Bayesian information criterion (Schwarz, 1978); each left-out pose counts three parameters."""
        variances = self.metric(np.arange(len(self.rotations))).eigenvalues + excess
        count = 3 * len(self.rotations)
        parameters = len(fit.off) - fit.degrees_of_freedom() + count - 3 * len(kept)
        known = variances[variances > 1e-12 * variances.max()]
        return float(np.log(known).sum() + fit.chi_square + parameters * np.log(count))


def first_explanation(seen: SeenRotations, model: GimbalModel, values: Array) -> Explanation:
    """Fit the gimbal without faults from several starts; the first search weighs all rotations equally."""
    kept = np.arange(len(seen.rotations))
    equal = replace(seen.metric(kept), excess=1.0)
    wide = global_fit(seen.rotations, model, equal, values)[0]
    return seen.explain(model, kept, wide, wide.values)
