"""The Gaussian posterior for given amplitudes, and their restricted likelihood with its gradient.

Shared unknowns b and those of each pose are an arrow matrix, as in bundle adjustment. The amplitudes maximise the
likelihood times their prior (Patterson and Thompson, 1971), by L-BFGS, since all unknowns are independent beforehand:
the gradient of each family is 2 (number - sum of (b^2 + V) / variance).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from calib.arrays import Array

from .equations import Bent, Equations
from .problem import Problem
from .table import slopes

#: Other 1-sigmas of some shared unknowns, by their places: a hypothesis.
Wide = Mapping[int, float]
AS_STATED: Wide = {}
#: An update that makes a determinant smaller by more than the exponential of this loses digits.
_FEW_DIGITS = -16.0
#: Damping of places of the pupil, in units of what is known of them.
_PLACES = 1e-2


@dataclass(frozen=True)
class Prior:
    """The information of what is known beside the stars, for given amplitudes."""

    star: float  # Of the stars, over the stated one
    reading: float  # Of a component of a reading, rad^-2; 0 without readings
    shared: Array  # (S,)
    own: Array  # (F,)

    @classmethod
    def of(cls, problem: Problem, eta: Array, wide: Wide) -> Prior:
        """Return that of (A,) logarithms of the amplitudes."""
        readings, reading = problem.readings, 0.0
        if readings is not None:
            reading = float(np.exp(-2.0 * eta[problem.reading])) / readings.sigma_rad**2
        shared = 1.0 / problem.variances(eta, dict(wide))
        return cls(float(np.exp(-2.0 * eta[problem.star])), reading, shared, 1.0 / problem.own_variances(eta))


@dataclass(frozen=True)
class Solution:
    """The posterior at linear equations."""

    equations: Equations
    eta: Array  # (A,) logarithms of the amplitudes
    wide: Wide
    prior: Prior
    covariance: Array  # (S, S)
    root_logarithm: float  # log det of the shared information, and of those of the poses
    own: Array  # (n, L, L) covariance of the unknowns of a pose, the shared ones known
    follow: Array  # (n, L, S) how they fall with the shared ones
    step: Array  # (S,) from the state
    local: Array  # (n, L) the same of the poses
    _parts: dict[str, float] = field(default_factory=dict)

    @property
    def problem(self) -> Problem:
        """What is solved."""
        return self.equations.problem

    @property
    def mean(self) -> Array:
        """(S,) the shared unknowns."""
        return np.asarray(self.equations.state.b + self.step)

    @cached_property
    def _b(self) -> Array:
        return self.mean - self.problem.unknowns.mean

    @cached_property
    def _f(self) -> Array:
        return self.equations.state.own + self.local[:, : self.equations.own_size]

    @cached_property
    def turned(self) -> Array:
        """(m, 3) rotations from the readings' predictions after the step, rad."""
        q, readings = self.equations, self.problem.readings
        if readings is None:
            return np.zeros((0, 3))
        return np.asarray(q.off + q.turns(self.local) - q.by_gimbal @ self.step[readings.at])

    @cached_property
    def star_squares(self) -> float:
        """Weighted squares of the stars after the step, over their noise."""
        return self.prior.star * self.equations.left(self.step, self.local)

    @cached_property
    def reading_squares(self) -> float:
        """Squares of the readings after the step, over their noise; views of one pose count as one."""
        if self.problem.readings is None:
            return 0.0
        weights = reading_weights(self.equations, self.prior)
        return float((weights[:, None] * self.turned**2).sum())

    @cached_property
    def value(self) -> float:
        """-2 log of likelihood times prior of the amplitudes."""
        q, p, prior = self.equations, self.problem, self.prior
        known = float(self._b**2 @ prior.shared) + float((self._f**2 @ prior.own).sum())
        volume = self.root_logarithm - np.log(prior.shared).sum() - p.n * np.log(prior.own).sum()
        value = self.star_squares + self.reading_squares + known + volume
        value += 2.0 * q.observed * self.eta[p.star] - q.logarithm
        if p.readings is not None:
            value += 6.0 * p.n * self.eta[p.reading]
        away = self.eta - p.expected.mean
        return float(value + away @ p.expected.information @ away)

    @cached_property
    def own_variances(self) -> Array:
        """(n, F) posterior variances of the own coefficients."""
        f = self.equations.own_size
        spread = np.einsum("nfs,nfs->nf", self.with_shared, self.follow[:, :f])
        return np.asarray(np.einsum("nff->nf", self.own[:, :f, :f]) + spread)

    @cached_property
    def with_shared(self) -> Array:
        """(n, F, S) covariance of the own coefficients, as they fall, with the shared unknowns."""
        follow = self.follow[:, : self.equations.own_size]
        return np.asarray((follow.reshape(-1, follow.shape[2]) @ self.covariance).reshape(follow.shape))

    @cached_property
    def _slopes(self) -> tuple[Array, Array]:
        """(A,) gradient of `value`, and (A,) its expected curvature along each amplitude alone (Harville, 1977)."""
        q, p, prior = self.equations, self.problem, self.prior
        size = len(self.eta)
        shared, own = np.diag(self.covariance) * prior.shared, self.own_variances * prior.own
        has = p.at >= 0
        gradient, curvature = np.zeros(size), np.zeros(size)
        np.add.at(gradient, p.at[has], 2.0 * (1.0 - shared - self._b**2 * prior.shared)[has])
        np.add.at(gradient, p.own_at, 2.0 * (1.0 - own - self._f**2 * prior.own).sum(axis=0))
        np.add.at(curvature, p.at[has], 4.0 * (1.0 - shared[has]) ** 2)
        np.add.at(curvature, p.own_at, 4.0 * ((1.0 - own) ** 2).sum(axis=0))
        by_prior = float(shared.sum() + own.sum())
        if p.readings is not None:
            trace = self._reading_trace()
            by_prior += trace
            gradient[p.reading] += 6.0 * p.n - 2.0 * (self.reading_squares + trace)
            curvature[p.reading] += 4.0 * max(3.0 * p.n - trace, 1.0)
        freedom = len(self.step) + own.size + 3 * len(p.poses) - by_prior
        gradient[p.star] += 2.0 * q.observed - 2.0 * (self.star_squares + freedom)
        curvature[p.star] += 4.0 * max(q.observed - freedom, 1.0)
        away = self.eta - p.expected.mean
        gradient += 2.0 * p.expected.information @ away
        curvature += 2.0 * np.diag(p.expected.information)
        self._parts["determined"] = freedom
        return gradient, curvature

    def _reading_trace(self) -> float:
        """Return the expected squares of the readings by the covariance alone, over their noise."""
        q, readings = self.equations, self.problem.readings
        assert readings is not None
        total, weights = 0.0, reading_weights(q, self.prior)
        for v, (pose, slot) in enumerate(zip(self.problem.poses, q.slots, strict=True)):
            slope = -self.follow[pose, slot]
            slope[:, readings.at] -= q.by_gimbal[v]
            spread = self.own[pose, slot, slot] + slope @ self.covariance @ slope.T
            total += float(weights[v] * np.trace(spread))
        return total

    def pulled(self, rows: Array) -> tuple[Array, Array, Array]:
        """Return how all unknowns vary with quantities of (p, S) gradients.

        (S, p) the shared ones, (n, L, p) those of the poses, and (m, 3, p) rotations from the readings' predictions.
        """
        q, p = self.equations, self.problem
        shared = self.covariance @ rows.T
        local = -self.follow @ shared
        if p.readings is None:
            return shared, local, np.zeros((0, 3, len(rows)))
        turned = np.array([local[pose, slot] for pose, slot in zip(p.poses, q.slots, strict=True)])
        return shared, local, turned - q.by_gimbal @ shared[p.readings.at]

    def by_amplitudes(self, rows: Array) -> tuple[Array, Array]:
        """Return how quantities with (p, S) gradients follow the logarithms of the amplitudes.

        (p, A) the change of their means over their 1-sigma, and that of the logarithms of these. An amplitude loosens
        what is known of its unknowns. If all become larger together, stars too, no mean changes, and each 1-sigma does
        in proportion.
        """
        p, prior = self.problem, self.prior
        shared, local, turned = self.pulled(rows)
        local = local[:, : self.equations.own_size]
        variances = np.einsum("ps,sp->p", rows, shared)
        loose, own = prior.shared[:, None] * shared, prior.own[:, None] * local
        of_shared = np.array([self._b[:, None] * loose, shared * loose])
        of_own = np.array([(self._f[:, :, None] * own).sum(axis=0), (local * own).sum(axis=0)])
        slopes, has = np.zeros((2, len(self.eta), len(rows))), p.at >= 0
        for slope, of_all, of_poses in zip(slopes, of_shared, of_own, strict=True):
            np.add.at(slope, p.at[has], of_all[has])
            np.add.at(slope, p.own_at, of_poses)
        rest = np.array([np.zeros_like(variances), variances]) - of_shared.sum(axis=1) - of_own.sum(axis=1)
        if p.readings is not None:
            weighed = reading_weights(self.equations, prior)[:, None, None] * turned
            of_readings = [
                (self.turned[:, :, None] * weighed).sum(axis=(0, 1)),
                (turned * weighed).sum(axis=(0, 1)),
            ]
            slopes[:, p.reading] = of_readings
            rest -= of_readings
        slopes[:, p.star] = rest
        return (2.0 * slopes[0] / np.sqrt(variances)).T, (slopes[1] / variances).T

    @property
    def gradient(self) -> Array:
        """(A,) of `value` by the logarithms of the amplitudes."""
        return self._slopes[0]

    @property
    def scale(self) -> Array:
        """(A,) 1-sigma of the logarithm of each amplitude, all others held."""
        return np.asarray(np.sqrt(2.0 / self._slopes[1]))

    @property
    def determined(self) -> float:
        """Number of unknowns that the stars determine, each as far as they do."""
        _ = self._slopes
        return self._parts["determined"]

    @property
    def moved(self) -> float:
        """How far the step moves focal length, foot and radius, as a share of these."""
        wide = self.problem.wide[[0, 3, 4, 5]]
        return float(np.abs(wide @ self.step).max())

    def there(self, share: float = 1.0) -> tuple[Array, Array, Array]:
        """Return a share of the step, for `State.moved`."""
        return (
            share * self.step,
            share * self.local[:, : self.equations.own_size],
            share * self.equations.turns(self.local),
        )


def reading_weights(equations: Equations, prior: Prior) -> Array:
    """Return (m,) the information of each reading: views of one pose count as one."""
    views = np.bincount(equations.problem.poses)
    return np.asarray(prior.reading / views[equations.problem.poses])


def solve(equations: Equations, eta: Array, wide: Wide = AS_STATED, damping: float = 0.0) -> Solution:
    """Return the posterior; ``damping`` holds what steps bend (Levenberg, 1944): camera, foot and radius.

    Places of a pupil are held, too: they multiply fields.
    Raises `numpy.linalg.LinAlgError` if these amplitudes do not determine all unknowns.
    """
    p, state, f = equations.problem, equations.state, equations.own_size
    prior = Prior.of(p, eta, wide)
    between, alone, right = equations.local
    h, rs = prior.star * equations.shared, prior.star * equations.shared_right
    h[np.diag_indices(len(h))] += prior.shared
    rs += (p.unknowns.mean - state.b) * prior.shared
    if equations.bent is not None:
        at = equations.bent.at
        h[np.ix_(at, at)] += equations.bent.curvature
        rs[at] -= equations.bent.gradient
    if damping:
        h += damping * p.wide.T @ p.wide
        at = p.unknowns.places("place")
        h[at, at] += _PLACES * damping * prior.shared[at]
    c, d, rl = prior.star * between, prior.star * alone, prior.star * right
    d[:, range(d.shape[1]), range(d.shape[1])] += equations.empty
    d[:, range(f), range(f)] += prior.own
    rl[:, :f] -= state.own * prior.own
    if p.readings is not None:
        _add_readings(equations, prior, (h, rs), (c, d, rl))
    lower = np.linalg.cholesky(d)
    root = np.asarray(np.linalg.inv(lower), np.float64)
    own, seen = np.swapaxes(root, 1, 2) @ root, (root @ c).reshape(-1, len(h))
    follow = own @ c
    covariance, shared_logarithm = _inverse(h - seen.T @ seen)
    step = covariance @ (rs - rl.reshape(-1) @ follow.reshape(-1, len(h)))
    local = (own @ rl[:, :, None])[:, :, 0] - follow @ step
    logarithm = shared_logarithm + 2.0 * float(np.log(np.diagonal(lower, axis1=1, axis2=2)).sum())
    return Solution(equations, eta, wide, prior, covariance, logarithm, own, follow, step, local)


def otherwise(first: Solution, wide: Wide) -> Solution:
    """Return the posterior with other 1-sigmas of some shared unknowns, all else the same.

    It differs by a matrix of low rank (Golub and Van Loan, 2013, 2.1.4); is solved where that would lose its digits.
    """
    prior = replace(first.prior, shared=1.0 / first.problem.variances(first.eta, dict(wide)))
    more = prior.shared - first.prior.shared
    at = np.flatnonzero(more)
    more, known = more[at], first.covariance[:, at]
    away = (first.problem.unknowns.mean - first.equations.state.b)[at]
    inner = np.eye(len(at)) + more[:, None] * known[at]
    sign, logarithm = np.linalg.slogdet(inner)
    if sign <= 0.0 or logarithm < _FEW_DIGITS:
        return solve(first.equations, first.eta, wide)
    taken = np.linalg.solve(inner, more[:, None] * np.column_stack([known.T, first.step[at]]))
    covariance = first.covariance - known @ taken[:, :-1]
    step = first.step - known @ taken[:, -1] - covariance[:, at] @ (more * -away)
    return replace(
        first,
        wide=wide,
        prior=prior,
        covariance=covariance,
        root_logarithm=first.root_logarithm + float(logarithm),
        step=step,
        local=first.local - first.follow @ (step - first.step),
        _parts={},
    )


def bent(solution: Solution) -> Bent | None:
    """Return how the places of a pupil that a hand moves bend the information; None if no hand moves it.

    Only what others know of a pose bends: one that alone determines the fields has the same determinant everywhere.
    """
    q, p, prior = solution.equations, solution.problem, solution.prior
    if p.places is None:
        return None
    at = p.unknowns.places("place")
    turned = np.einsum("nka,kfs->nafs", slopes(p.pupil(q.state.b)), p.unknowns.by_place)
    stars = prior.star * q.of_poses
    between = prior.star * q.of_local[0]
    with_shared = (stars @ q.maps - np.swapaxes(between, 1, 2) @ solution.follow) @ solution.covariance
    gradient = np.einsum("nafs,nfs->na", turned, with_shared[:, p.field])
    left = stars - np.swapaxes(between, 1, 2) @ solution.own @ between
    seen = left @ q.maps
    others = (left - seen @ solution.covariance @ np.swapaxes(seen, 1, 2))[:, p.field, p.field]
    across = np.einsum("nfg,nbgs->nbfs", others, turned @ solution.covariance)
    curvature = np.einsum("nafs,nbfs->nab", turned, across)
    moved = p.places.per_mm * p.places.root
    return Bent(
        at, np.einsum("nap,na->p", moved, gradient), np.einsum("nap,nab,nbq->pq", moved, curvature, moved)
    )


def _add_readings(
    q: Equations, prior: Prior, shared: tuple[Array, Array], of_poses: tuple[Array, Array, Array]
) -> None:
    """Add the readings to the information and right-hand sides of shared unknowns and poses."""
    readings = q.problem.readings
    assert readings is not None
    (h, rs), (c, d, rl), at = shared, of_poses, readings.at
    weights = reading_weights(q, prior)
    weighed = weights[:, None, None] * q.by_gimbal
    h[np.ix_(at, at)] += np.tensordot(weighed, q.by_gimbal, ((0, 1), (0, 1)))
    rs[at] += np.tensordot(weighed, q.off, ((0, 1), (0, 1)))
    for v, (weight, pose, slot) in enumerate(zip(weights, q.problem.poses, q.slots, strict=True)):
        off = q.off[v]
        c[pose][slot, at] -= weighed[v]
        d[pose, slot, slot] += weight * np.eye(3)
        rl[pose, slot] -= weight * off


def _inverse(h: Array) -> tuple[Array, float]:
    """Return the inverse of a positive definite matrix, and the logarithm of its determinant."""
    from scipy.linalg.lapack import dpotrf, dpotri  # here: `plan` starts without it

    lower, failed = dpotrf(h, lower=1)
    if failed:
        raise np.linalg.LinAlgError("The matrix is not positive definite.")
    half = np.tril(dpotri(lower, lower=1)[0])
    inverse = half + half.T
    inverse[np.diag_indices(len(h))] *= 0.5
    return inverse, 2.0 * float(np.log(np.diag(lower)).sum())


def expected_curvature(solution: Solution) -> Array:
    """Return the (A, A) curvature that `Solution.value` is expected to have (Harville, 1977).

    With the posterior covariance V and prior variances s^2 it is the sum over the unknowns of two families of 4 times
    the squares of 1 - V / (s s'). Poses are taken apart.
    """
    p, prior, size = solution.problem, solution.prior, len(solution.eta)
    has = p.at >= 0
    member = np.zeros((len(p.at), size))
    member[np.flatnonzero(has), p.at[has]] = 1.0
    own_member = np.zeros((len(p.own_at), size))
    own_member[range(len(p.own_at)), p.own_at] = 1.0
    scale, own_scale, f = np.sqrt(prior.shared), np.sqrt(prior.own), len(prior.own)
    seen = np.eye(len(scale)) - scale[:, None] * solution.covariance * scale
    between = own_scale[:, None] * solution.with_shared * scale
    follow = np.swapaxes(solution.follow[:, :f], 1, 2)
    alone = (
        np.eye(f) - own_scale[:, None] * (solution.own[:, :f, :f] + solution.with_shared @ follow) * own_scale
    )
    across = own_member.T @ (between**2).sum(axis=0) @ member
    of_own = own_member.T @ (alone**2).sum(axis=0) @ own_member
    curvature = 4.0 * (member.T @ seen**2 @ member + of_own + across + across.T)
    noises = [p.star] if p.readings is None else [p.star, p.reading]
    own_curvature = 2.0 / solution.scale**2 - 2.0 * np.diag(p.expected.information)
    curvature[noises, noises] += own_curvature[noises]
    return np.asarray(curvature + 2.0 * p.expected.information)
