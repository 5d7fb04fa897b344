"""Likelihood of the amplitudes with all other unknowns integrated out, its gradient, and the solution for given ones.

Restricted likelihood: Patterson and Thompson (1971), Harville (1977). The rotation of each view and the own field of
each pose are eliminated view by view and pose by pose; what is left are the S shared unknowns. The equations stand in
docs/adjustment.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from calib.joint import amplitudes as amp
from calib.joint.equations import Bench, Equations, State
from calib.joint.fields import DEGREES
from calib.joint.knowledge import Knowledge
from calib.joint.layout import POSE_DEGREES, POSE_PLACES, RandomBlock

Array = NDArray[np.float64]

#: Names of statements with their faults (`calib.joint.knowledge.FAULTS`).
Faults = tuple[tuple[str, str], ...]
NO_FAULT: Faults = ()
_POSE_DEGREE = np.tile(DEGREES, 2)[POSE_PLACES]


@dataclass(frozen=True)
class Problem:
    """What the likelihood reads beside the equations."""

    bench: Bench
    knowledge: Knowledge
    blocks: Sequence[RandomBlock]
    hyper: amp.Hyperprior


def _inverse_of_one(matrix: Array) -> tuple[Array, float]:
    """Return the inverse of a (K, K) positive definite matrix and the logarithm of its determinant."""
    from scipy.linalg.lapack import dpotrf, dpotri

    scale = 1.0 / np.sqrt(np.diag(matrix))
    lower, fault = dpotrf(matrix * scale[:, None] * scale, lower=1)
    if fault:
        raise np.linalg.LinAlgError("not positive definite")
    inverse = dpotri(lower, lower=1)[0]
    inverse = inverse + inverse.T  # the other triangle is zero
    np.fill_diagonal(inverse, 0.5 * np.diag(inverse))
    logarithm = 2.0 * float((np.log(np.diag(lower)) - np.log(scale)).sum())
    return np.asarray(inverse * scale[:, None] * scale), logarithm


def _inverse(matrices: Array) -> tuple[Array, Array]:
    """Return the inverses of (..., K, K) positive definite matrices and the logarithms of their determinants."""
    scale = 1.0 / np.sqrt(np.diagonal(matrices, axis1=-2, axis2=-1))
    lower = np.linalg.cholesky(matrices * scale[..., :, None] * scale[..., None, :])
    back = np.linalg.inv(lower) * scale[..., None, :]
    logarithm = 2.0 * (np.log(np.diagonal(lower, axis1=-2, axis2=-1)) - np.log(scale)).sum(axis=-1)
    return np.swapaxes(back, -1, -2) @ back, logarithm


@dataclass(frozen=True)
class Solution:
    """The posterior of the unknowns for given amplitudes, about the state of the equations."""

    value: float  # -2 log of likelihood times hyperprior
    step: Array  # (S,) to the posterior mean
    covariance: Array  # (S, S)
    fields: Array  # (n, F) steps of the poses' own fields
    own: Array  # (n, F, F) covariance of the own fields, if the shared unknowns were known
    follow: Array  # (n, F, S) how the own fields follow the shared unknowns, with a minus sign
    gradient: Array  # (A,) of the value by the logarithms of the amplitudes


class Marginal:
    """The linearised problem: likelihood and solution as functions of the amplitudes."""

    def __init__(self, problem: Problem, equations: Equations, state: State) -> None:
        self.problem, self.equations, self.state = problem, equations, state
        bench, places = problem.bench, problem.bench.layout.pose_places
        self._poses, maps = bench.poses, equations.maps
        self._statements: dict[Faults, tuple[Array, Array, float, float]] = {}
        mapped = equations.squares @ maps
        self.shared = np.einsum("nbs,nbt->st", maps, mapped, optimize=True)
        self.pull = np.einsum("nbs,nb->s", maps, equations.right)
        self.between = mapped[:, places]
        self.own = equations.squares[:, places[:, None], places]
        self.own_pull = equations.right[:, places]
        self._sigma2 = bench.readings.sigma_rad**2 if bench.readings else 0.0
        self.uses_readings = len(equations.off) > 0
        if self.uses_readings:
            self.rows = equations.coupling @ maps[bench.poses]
            self.rows[:, :, bench.gimbal_places] += equations.gimbal
            self.own_rows = equations.coupling[:, :, places]
            self.loose = np.linalg.inv(equations.turns)

    @cached_property
    def dimensions(self) -> tuple[int, int, int]:
        """Numbers of poses, of coefficients of an own field, of shared unknowns."""
        return (*self.own_pull.shape, len(self.pull))

    def _by_pose(self, values: Array) -> Array:
        """Return (n, ...) the sums over the views of each pose of (m, ...) values."""
        if len(values) == self.problem.bench.n_poses:
            return values
        return np.stack(
            [values[self._poses == pose].sum(axis=0) for pose in range(self.problem.bench.n_poses)]
        )

    # -- priors
    def prior(self, squares: Array, faults: Faults) -> tuple[Array, Array, float, float]:
        """Return information, right-hand side, cost and log-determinant of all priors of the shared unknowns.

        faults: Statements that are at fault, by name.
        """
        b = self.state.shared
        information, pull, cost, logarithm = self._stated(faults)
        information, pull = information.copy(), pull.copy()
        for block in self.problem.blocks:
            inside, own = _inverse_of_one(block.covariance(squares))
            at = block.places
            information[at[:, None], at] += inside
            pull[at] -= inside @ b[at]
            cost += float(b[at] @ inside @ b[at])
            logarithm += own
        return information, pull, cost, logarithm

    def _stated(self, faults: Faults) -> tuple[Array, Array, float, float]:
        """Return the part of `prior` that does not depend on the amplitudes; it is computed once."""
        if faults not in self._statements:
            b = self.state.shared
            information, pull = np.zeros((len(b), len(b))), np.zeros(len(b))
            cost = logarithm = 0.0
            for one in self.problem.knowledge.statements:
                inside = one.information(dict(faults).get(one.name, ""))
                off = one.values - one.rows @ b
                information += one.rows.T @ inside @ one.rows
                pull += one.rows.T @ (inside @ off)
                cost += float(off @ inside @ off)
                logarithm -= float(np.linalg.slogdet(inside)[1])
            self._statements[faults] = information, pull, cost, logarithm
        return self._statements[faults]

    @cached_property
    def curvature(self) -> Array:
        """(A,) rough curvature of the value by each amplitude: what its unknowns and the hyperprior bring."""
        hyper, (n, _, _) = self.problem.hyper, self.dimensions
        found = 2.0 * np.diag(hyper.information).copy()
        found[hyper.at(amp.STAR)] += 4.0 * self.equations.observed
        found[hyper.at(amp.READING)] += 4.0 * len(self._poses) * self.uses_readings
        for d, name in enumerate(amp.POSE, start=POSE_DEGREES[0]):
            found[hyper.at(name)] += 2.0 * n * np.count_nonzero(d == _POSE_DEGREE)
        for block in self.problem.blocks:
            for at, shape in block.parts:
                found[at] += shape.shape[1]
        return found

    def prior_cost(self, squares: Array, state: State) -> float:
        """Return the cost of all priors at a state."""
        b, cost = state.shared, 0.0
        for one in self.problem.knowledge.statements:
            off = one.values - one.rows @ b
            cost += float(off @ one.information() @ off)
        for block in self.problem.blocks:
            inside, _ = _inverse_of_one(block.covariance(squares))
            cost += float(b[block.places] @ inside @ b[block.places])
        return cost + float((self.own_information(squares) * state.fields**2).sum())

    def own_information(self, squares: Array) -> Array:
        """Return (F,) prior information of the coefficients of an own field."""
        at = self.problem.hyper.places(amp.POSE)[_POSE_DEGREE - POSE_DEGREES[0]]
        return (_POSE_DEGREE + 1.0) / squares[at]

    def reading_variance(self, squares: Array) -> float:
        """Return the variance of a component of a reading's rotation, rad^2."""
        return float(squares[self.problem.hyper.at(amp.READING)]) * self._sigma2

    def reading_weights(self, squares: Array) -> tuple[Array, float]:
        """Return (m, 3, 3) the weights of the readings against the stars' rotations, and the log-determinant."""
        hyper = self.problem.hyper
        covariance = squares[hyper.at(amp.STAR)] * self.loose
        covariance = covariance + squares[hyper.at(amp.READING)] * self._sigma2 * np.eye(3)
        weights, logarithms = _inverse(covariance)
        return weights, float(logarithms.sum())

    # -- solution
    def solve(self, eta: Array, faults: Faults = NO_FAULT, *, slope: bool = True) -> Solution:
        """Return the posterior for given logarithms of the amplitudes.

        faults: Statements that are at fault, by name.
        slope: Whether the gradient is wanted; else it is zero.
        Raises numpy.linalg.LinAlgError: If the amplitudes leave nothing that determines an unknown.
        """
        hyper, equations = self.problem.hyper, self.equations
        n, f, _ = self.dimensions
        squares = np.exp(2.0 * eta)
        w = 1.0 / squares[hyper.at(amp.STAR)]
        information, pull, cost, logarithm = self.prior(squares, faults)
        information = information + w * self.shared
        pull = pull + w * self.pull
        own, own_pull, between = w * self.own, w * self.own_pull, w * self.between
        cost += w * equations.cost
        logarithm += (equations.observed - 3.0 * len(self._poses)) * 2.0 * eta[hyper.at(amp.STAR)]
        if self.uses_readings:
            weights, extra = self.reading_weights(squares)
            logarithm += extra
            weighted, y = weights @ self.rows, equations.off
            size = self.rows.shape[2]
            information += self.rows.reshape(-1, size).T @ weighted.reshape(-1, size)
            pull += np.einsum("mas,ma->s", weighted, y)
            own_weighted = weights @ self.own_rows
            own += self._by_pose(np.swapaxes(self.own_rows, 1, 2) @ own_weighted)
            own_pull += self._by_pose(np.einsum("maf,ma->mf", own_weighted, y))
            between += self._by_pose(np.swapaxes(own_weighted, 1, 2) @ self.rows)
            cost += float(np.einsum("ma,mab,mb->", y, weights, y))
        expected = self.own_information(squares)
        own[:, range(f), range(f)] += expected
        own_pull -= expected * self.state.fields
        cost += float((expected * self.state.fields**2).sum())
        logarithm -= n * float(np.log(expected).sum())
        inverse, logs = _inverse(own)
        follow = inverse @ between
        alone = (inverse @ own_pull[:, :, None])[:, :, 0]
        flat = follow.reshape(n * f, -1)
        information = information - between.reshape(n * f, -1).T @ flat
        pull = pull - own_pull.reshape(-1) @ flat
        cost -= float((own_pull * alone).sum())
        covariance, last = _inverse_of_one(information)
        step = covariance @ pull
        cost -= float(pull @ step)
        away = eta - hyper.mean
        value = cost + logarithm + last + float(logs.sum() + away @ hyper.information @ away)
        found = Solution(value, step, covariance, alone - follow @ step, inverse, follow, np.zeros(len(eta)))
        if not slope:
            return found
        return Solution(value, step, covariance, found.fields, inverse, follow, self._gradient(eta, found))

    def _gradient(self, eta: Array, found: Solution) -> Array:
        """Return the gradient of the value: number minus expected square of what each amplitude scales."""
        hyper = self.problem.hyper
        n, _, _ = self.dimensions
        squares = np.exp(2.0 * eta)
        gradient = 2.0 * hyper.information @ (eta - hyper.mean)
        followed = found.follow @ found.covariance
        spread = np.diagonal(found.own, axis1=1, axis2=2) + (followed * found.follow).sum(axis=2)
        share = self.own_information(squares) * (spread + (self.state.fields + found.fields) ** 2).sum(axis=0)
        for d, name in enumerate(amp.POSE, start=POSE_DEGREES[0]):
            own = d == _POSE_DEGREE
            gradient[hyper.at(name)] += 2.0 * (n * np.count_nonzero(own) - share[own].sum())
        b = self.state.shared + found.step
        for block in self.problem.blocks:
            inside, _ = _inverse_of_one(block.covariance(squares))
            second = found.covariance[np.ix_(block.places, block.places)] + np.outer(
                b[block.places], b[block.places]
            )
            left = inside - inside @ second @ inside
            for at, shape in block.parts:
                gradient[at] += 2.0 * squares[at] * float(((left @ shape) * shape).sum())
        return gradient + self._noise_gradient(eta, squares, found, followed)

    def _noise_gradient(self, eta: Array, squares: Array, found: Solution, followed: Array) -> Array:
        """Return the gradient by the noise of the stars and of the readings."""
        hyper, equations = self.problem.hyper, self.equations
        gradient = np.zeros(len(eta))
        star, reading = hyper.at(amp.STAR), hyper.at(amp.READING)
        step, fields = found.step, found.fields
        left = equations.cost - 2.0 * float(self.pull @ step) - 2.0 * float((self.own_pull * fields).sum())
        left += float(step @ self.shared @ step) + 2.0 * float((fields * (self.between @ step)).sum())
        left += float(np.einsum("nf,nfg,ng->", fields, self.own, fields))
        spread = float((found.covariance * self.shared).sum()) - 2.0 * float((self.between * followed).sum())
        spread += float(((self.own @ found.follow) * followed).sum() + (self.own * found.own).sum())
        rows = equations.observed - 3.0 * len(self._poses)
        gradient[star] = 2.0 * (rows - (left + spread) / squares[star])
        if not self.uses_readings:
            return gradient
        weights, _ = self.reading_weights(squares)
        direct = self.rows - self.own_rows @ found.follow[self._poses]
        residual = (
            equations.off - self.rows @ step - np.einsum("maf,mf->ma", self.own_rows, fields[self._poses])
        )
        second = direct @ found.covariance @ np.swapaxes(direct, 1, 2)
        second = second + self.own_rows @ found.own[self._poses] @ np.swapaxes(self.own_rows, 1, 2)
        second = second + residual[:, :, None] * residual[:, None]
        inside = weights - weights @ second @ weights
        gradient[star] += 2.0 * squares[star] * float((inside * self.loose).sum())
        gradient[reading] = (
            2.0 * squares[reading] * self._sigma2 * float(np.trace(inside, axis1=1, axis2=2).sum())
        )
        return gradient

    def rotation_steps(self, eta: Array, found: Solution) -> Array:
        """Return (m, 3) the rotation vectors to the posterior mean of each view, rad."""
        basis = self.equations.maps @ found.step
        basis[:, self.problem.bench.layout.pose_places] += found.fields
        by_stars = self.equations.turned - np.einsum(
            "mab,mb->ma", self.equations.coupling, basis[self._poses]
        )
        if not self.uses_readings:
            return by_stars
        squares = np.exp(2.0 * eta)
        weights, _ = self.reading_weights(squares)
        predicted = self.equations.gimbal @ found.step[self.problem.bench.gimbal_places]
        already = self.equations.off - self.equations.turned  # readings to the present rotation
        away = predicted - already - by_stars
        share = squares[self.problem.hyper.at(amp.STAR)] * self.loose @ weights
        return np.asarray(by_stars + (share @ away[:, :, None])[:, :, 0])
