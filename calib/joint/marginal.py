"""Likelihood of the amplitudes with all other unknowns integrated out, its gradient, and the solution for given ones.

Restricted likelihood: Patterson and Thompson (1971), Harville (1977). The rotation of each view and the own field of
each pose are eliminated; S shared unknowns are left. The equations stand in docs/adjustment.md, in these letters:

b; f             `State.shared`; `State.fields`: the S shared unknowns; own fields
T                `Equations.maps`: what b does to the image of each pose
e^T W e          `Equations.cost`: weighted squares of all residuals
log a; m; Omega  `Solution.eta`; `Hyperprior.mean`; `Hyperprior.covariance`: amplitudes; their prior
U                `RandomPrior.shapes`: columns that one amplitude scales
Pi               `Solution.inside`: prior information of unknowns with amplitudes
D_i^-1           `Solution.own`: covariance of an own field
V = H^-1         `Solution.covariance`: covariance of b
-2 log L         `Solution.value`: of likelihood times prior of the amplitudes
s; Sigma_s; F    `Statement.values`; `Statement.covariance`; `Statement.free`: what is stated; covariances
z                `Innovation.normalised`: stated less expected, in sigmas
C; y; M          `Unstated.covariance`; `Unstated.away`; `Unstated.more`: of all statements
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from calib.arrays import Array
from calib.joint import amplitudes as amp
from calib.joint.equations import Bench, Equations, State
from calib.joint.knowledge import Knowledge
from calib.joint.prior import NO_FAULT, Faults, RandomPrior, Stated, inverse_root
from calib.joint.pupils import Pupils


@dataclass(frozen=True)
class Problem:
    """What the likelihood reads beside the equations."""

    bench: Bench
    knowledge: Knowledge
    hyper: amp.Hyperprior
    pupils: Pupils | None = None  # What the visible discs show, if the camera is moved by hand
    # 2 log of the odds that a hand moves the pupil, and not a gimbal, by the discs; -inf if none shows it
    wander: float = -np.inf
    faults: Faults = NO_FAULT  # Statements that are at fault unless a call names others

    @cached_property
    def random(self) -> RandomPrior:
        """The prior of all shared unknowns that have amplitudes."""
        return RandomPrior.of(self.bench.layout, self.hyper)

    @cached_property
    def _stated(self) -> dict[Faults, Stated]:
        return {}

    def stated(self, faults: Faults = NO_FAULT) -> Stated:
        """Return all statements, of which some may be at fault."""
        faults = faults or self.faults
        if faults not in self._stated:
            self._stated[faults] = Stated.of(self.knowledge.statements, faults)
        return self._stated[faults]

    @cached_property
    def pose_amplitudes(self) -> NDArray[np.int64]:
        """(F,) place of the amplitude of each coefficient of an own field."""
        return self.hyper.places(self.bench.layout.own.amplitudes)

    @cached_property
    def places_cost(self) -> float:
        """Cost of how far the pupils are from where the visible discs show them."""
        if self.pupils is None:
            return 0.0
        off = (self.bench.pupils - self.pupils.shown).reshape(-1)
        return float(off @ self.pupils.information @ off)

    def own_information(self, squares: Array) -> Array:
        """Return (F,) prior information of the coefficients of an own field."""
        return np.asarray(self.bench.layout.own.information / squares[self.pose_amplitudes])


@dataclass(frozen=True)
class Solution:
    """The posterior of the unknowns for given amplitudes, about the state of the equations."""

    marginal: Marginal
    eta: Array  # (A,) logarithms of the amplitudes
    faults: Faults  # Of the statements
    value: float  # -2 log of likelihood times hyperprior
    gain: float  # By how much the step lowers the cost, if all is linear
    step: Array  # (S,) to the posterior mean
    root: Array  # (S, S) R, covariance R^T R
    fields: Array  # (n, F) steps of the poses' own fields
    own_root: Array  # (n, F, F) R, covariance R^T R of the own fields, if the shared unknowns were known
    between: Array  # (n, F, S) R times the information between own fields and shared unknowns
    inside: Array  # (K, K) prior information of the shared unknowns with amplitudes

    @cached_property
    def squares(self) -> Array:
        """(A,) squares of the amplitudes."""
        return np.exp(2.0 * self.eta)

    @property
    def star_variance(self) -> float:
        """Variance of the stars' noise over the stated one."""
        return float(self.squares[self.marginal.problem.hyper.at(amp.STAR)])

    @cached_property
    def covariance(self) -> Array:
        """(S, S) of the shared unknowns."""
        return np.asarray(self.root.T @ self.root)

    @cached_property
    def own(self) -> Array:
        """(n, F, F) covariance of the own fields, if the shared unknowns were known."""
        return np.asarray(np.swapaxes(self.own_root, 1, 2) @ self.own_root)

    @cached_property
    def follow(self) -> Array:
        """(n, F, S) how the own fields follow the shared unknowns, with a minus sign."""
        return np.asarray(np.swapaxes(self.own_root, 1, 2) @ self.between)

    @cached_property
    def own_variances(self) -> Array:
        """(n, F) of the own fields."""
        return np.asarray((self.own_root**2).sum(axis=1) + (self.followed**2).sum(axis=2))

    @cached_property
    def followed(self) -> Array:
        """(n, F, S) `follow` times R^T: its products are the covariance of the own fields that the shared ones make."""
        size = len(self.root)
        return np.asarray((self.follow.reshape(-1, size) @ self.root.T).reshape(self.follow.shape))

    @cached_property
    def predicted(self) -> Array:
        """(m, 3, S) how what the readings predict follows the shared unknowns, in the principal axes."""
        marginal = self.marginal
        return np.asarray(marginal.rows - marginal.own_rows @ self.follow[marginal.problem.bench.poses])

    @cached_property
    def reading_spread(self) -> Array:
        """(m, 3) variances of what the readings predict, in the principal axes; zeros without readings."""
        marginal = self.marginal
        if not marginal.uses_readings:
            return np.zeros(marginal.loose.shape)
        size = len(self.root)
        spread = (self.predicted.reshape(-1, size) @ self.root.T) ** 2
        own = marginal.own_rows @ self.own[marginal.problem.bench.poses]
        return np.asarray(spread.sum(axis=1).reshape(-1, 3) + (own * marginal.own_rows).sum(axis=2))

    @cached_property
    def freedom(self) -> float:
        """Degrees of freedom of the stars' noise: coordinates, less the unknowns that they determine.

        Priors, statements and readings determine the rest.
        """
        marginal, problem, squares = self.marginal, self.marginal.problem, self.squares
        n, f, size = marginal.dimensions
        at = problem.random.places
        taken = float((self.inside * self.covariance[at[:, None], at]).sum())
        taken += float((problem.own_information(squares) * self.own_variances).sum())
        taken += float((problem.stated(self.faults).information * self.covariance).sum())
        taken += float((marginal.reading_weights(squares) * self.reading_spread).sum())
        return marginal.rows_observed - (size + n * f - taken)

    @cached_property
    def gradient(self) -> Array:
        """(A,) slopes of the value along the logarithms: number minus expected square of what each amplitude scales."""
        marginal, problem, squares = self.marginal, self.marginal.problem, self.squares
        hyper, random = problem.hyper, problem.random
        gradient = 2.0 * hyper.information @ (self.eta - hyper.mean)
        second = self.own_variances + (marginal.state.fields + self.fields) ** 2
        own = 2.0 * (len(second) - problem.own_information(squares) * second.sum(axis=0))
        gradient += np.bincount(problem.pose_amplitudes, own, len(squares))
        at = random.places
        b = (marginal.state.shared + self.step)[at]
        parts = random.gradient(self.inside, self.covariance[at[:, None], at], b)
        gradient += np.bincount(random.amplitudes, 2.0 * squares[random.amplitudes] * parts, len(squares))
        gradient[hyper.at(amp.STAR)] += 2.0 * (self.freedom - marginal.star_cost(self) / self.star_variance)
        if marginal.uses_readings:
            weights, spread = marginal.reading_weights(squares), self.reading_spread
            inside = weights / marginal.repeats - weights**2 * (spread + marginal.readings_left(self) ** 2)
            gradient[hyper.at(amp.STAR)] += 2.0 * self.star_variance * float((inside * marginal.loose).sum())
            gradient[hyper.at(amp.READING)] += 2.0 * float(
                (inside * marginal.reading_variance(squares)).sum()
            )
        return gradient


@dataclass(frozen=True)
class _Normal:
    """The normal equations for given amplitudes: shared unknowns, own fields of the poses, and what is between."""

    information: Array  # (S, S)
    pull: Array  # (S,)
    own: Array  # (n, F, F)
    own_pull: Array  # (n, F)
    between: Array  # (n, F, S)
    inside: Array  # (K, K) prior information of the shared unknowns with amplitudes
    constant: float  # Of the value


class Marginal:
    """The linearised problem: likelihood and solution as functions of the amplitudes.

    Readings are turned into the principal axes of each view's rotation, so that each has three independent parts.
    """

    def __init__(self, problem: Problem, equations: Equations, state: State) -> None:
        self.problem, self.equations, self.state = problem, equations, state
        bench, places = problem.bench, problem.bench.layout.own.places
        self._poses, maps = bench.poses, equations.maps
        size = maps.shape[2]
        self.own = equations.squares[:, places[:, None], places]
        self.own_pull = equations.right[:, places]
        self._sigma2 = bench.readings.sigma_rad**2 if bench.readings else 0.0
        # repeats: (m, 1) number of views of the same pose.
        self.repeats = np.bincount(bench.poses)[bench.poses][:, None].astype(float)
        self.uses_readings = len(equations.off) > 0
        # (m, 3) variances of the stars' rotations, unit amplitude.
        self.loose, columns = np.linalg.eigh(np.linalg.inv(equations.turns))
        self.axes = np.swapaxes(columns, 1, 2)  # (m, 3, 3) axes of these rotations, in rows
        # What the readings say in these axes: (m, 3, S) of what is shared, (m, 3, F) of the fields, (m, 3) how far off.
        self.rows, self.own_rows = np.zeros((0, 3, size)), np.zeros((0, 3, len(places)))
        self.off = np.zeros((0, 3))
        if self.uses_readings:
            rows = equations.coupling @ maps[bench.poses]
            rows[:, :, bench.gimbal_places] += equations.gimbal
            self.rows, self.own_rows = self.axes @ rows, self.axes @ equations.coupling[:, :, places]
            self.off = (self.axes @ equations.off[:, :, None])[:, :, 0]

    @cached_property
    def dimensions(self) -> tuple[int, int, int]:
        """Numbers of poses, of coefficients of an own field, of shared unknowns."""
        return (*self.own_pull.shape, self.equations.maps.shape[2])

    @cached_property
    def _mapped(self) -> Array:
        """(n, B, S) what the stars say of each pose's basis together with the shared unknowns."""
        return np.asarray(self.equations.squares @ self.equations.maps)

    @cached_property
    def shared(self) -> Array:
        """(S, S) star information of the shared unknowns."""
        size = self.dimensions[2]
        return np.asarray(self.equations.maps.reshape(-1, size).T @ self._mapped.reshape(-1, size))

    @cached_property
    def pull(self) -> Array:
        """(S,) right-hand side of `shared`."""
        return np.asarray(
            self.equations.maps.reshape(-1, self.dimensions[2]).T @ self.equations.right.reshape(-1)
        )

    @cached_property
    def between(self) -> Array:
        """(n, F, S) star information between the own fields and the shared unknowns."""
        return self._mapped[:, self.problem.bench.layout.own.places]

    # -- priors
    @cached_property
    def rows_observed(self) -> float:
        """Number of star coordinates that are left when the rotations are found."""
        return self.equations.observed - 3.0 * float(self.equations.shares.sum())

    def prior_cost(self, squares: Array, state: State) -> float:
        """Return the cost of all priors at a state."""
        random = self.problem.random
        b = state.shared[random.places]
        inside, _ = random.information(squares)
        total = self.problem.stated().off(state.shared)[1] + float(b @ inside @ b)
        return total + float((self.problem.own_information(squares) * state.fields**2).sum())

    def reading_variance(self, squares: Array) -> Array:
        """Return the (m, 1) variances of a component of each reading's rotation, rad^2.

        The n readings of one pose together count as one: each has n times the variance.
        """
        return np.asarray(float(squares[self.problem.hyper.at(amp.READING)]) * self._sigma2 * self.repeats)

    def reading_weights(self, squares: Array) -> Array:
        """Return the (m, 3) weights of the readings relative to the stars' rotations, in the principal axes."""
        star = squares[self.problem.hyper.at(amp.STAR)]
        return np.asarray(1.0 / (star * self.loose + self.reading_variance(squares)))

    # -- solution
    def solve(self, eta: Array, faults: Faults = NO_FAULT) -> Solution:
        """Return the posterior for given logarithms of the amplitudes and faults of statements, by name.

        The equations are singular if nothing determines an unknown.
        """
        n, f, size = self.dimensions
        squares = np.exp(2.0 * eta)
        normal = self._normal(squares, faults)
        own_root, logs = inverse_root(normal.own)
        between = own_root @ normal.between
        alone = own_root @ normal.own_pull[:, :, None]
        flat = between.reshape(n * f, size)
        root, last = inverse_root(normal.information - flat.T @ flat)
        along = root @ (normal.pull - alone.reshape(-1) @ flat)
        step = along @ root
        from_mean = eta - self.problem.hyper.mean
        gain = float(along @ along) + float((alone**2).sum())
        value = normal.constant + logs + last - gain
        value += float(from_mean @ self.problem.hyper.information @ from_mean)
        fields = (np.swapaxes(own_root, 1, 2) @ (alone - (between @ step)[:, :, None]))[:, :, 0]
        inside = normal.inside
        return Solution(self, eta, faults, value, gain, step, root, fields, own_root, between, inside)

    def own_steps(self, squares: Array) -> Array:
        """Return the (n, F) steps of the own fields if all shared unknowns stay."""
        own, pull = self._own_normal(squares)
        root, _ = inverse_root(own)
        return np.asarray((np.swapaxes(root, 1, 2) @ (root @ pull[:, :, None]))[:, :, 0])

    def _own_normal(self, squares: Array) -> tuple[Array, Array]:
        """Return the (n, F, F) normal equations of the own fields alone, and their (n, F) right-hand sides."""
        w = 1.0 / squares[self.problem.hyper.at(amp.STAR)]
        expected, places = self.problem.own_information(squares), range(self.dimensions[1])
        own, pull = w * self.own, w * self.own_pull - expected * self.state.fields
        own[:, places, places] += expected
        if self.uses_readings:
            across = np.swapaxes(self.reading_weights(squares)[:, :, None] * self.own_rows, 1, 2)
            own += self.problem.bench.by_pose(across @ self.own_rows)
            pull += self.problem.bench.by_pose((across @ self.off[:, :, None])[:, :, 0])
        return own, pull

    def _normal(self, squares: Array, faults: Faults) -> _Normal:
        """Return the normal equations."""
        hyper, random, stated = self.problem.hyper, self.problem.random, self.problem.stated(faults)
        stated_pull, stated_cost = stated.off(self.state.shared)
        star = squares[hyper.at(amp.STAR)]
        w = 1.0 / star
        inside, logarithm = random.information(squares)
        b, fields = self.state.shared[random.places], self.state.fields
        information, pull = stated.information + w * self.shared, stated_pull + w * self.pull
        information[random.places[:, None], random.places] += inside
        pull[random.places] -= inside @ b
        expected = self.problem.own_information(squares)
        constant = stated_cost + w * self.equations.cost + float(b @ inside @ b)
        constant += stated.logarithm + logarithm + self.rows_observed * float(np.log(star))
        constant += self.problem.places_cost - self.equations.logarithm
        constant += float((expected * fields**2).sum()) - len(fields) * float(np.log(expected).sum())
        own, own_pull = self._own_normal(squares)
        normal = _Normal(information, pull, own, own_pull, w * self.between, inside, constant)
        return self._with_readings(normal, squares) if self.uses_readings else normal

    def _with_readings(self, normal: _Normal, squares: Array) -> _Normal:
        """Return the normal equations with the readings, which those of the own fields have already."""
        weights = self.reading_weights(squares)
        size = self.rows.shape[2]
        rows = (weights[:, :, None] * self.rows).reshape(-1, size)
        across = np.swapaxes(weights[:, :, None] * self.own_rows, 1, 2)
        return replace(
            normal,
            information=normal.information + self.rows.reshape(-1, size).T @ rows,
            pull=normal.pull + self.off.reshape(-1) @ rows,
            between=normal.between + self.problem.bench.by_pose(across @ self.rows),
            constant=normal.constant
            + float((weights * self.off**2).sum())
            - float((np.log(weights) / self.repeats).sum()),
        )

    # -- what a solution leaves
    def star_cost(self, solution: Solution) -> float:
        """Return the weighted square sum of the stars' residuals at the mean of a solution, if all is linear."""
        step, fields = solution.step, solution.fields
        cost = (
            self.equations.cost - 2.0 * float(self.pull @ step) - 2.0 * float((self.own_pull * fields).sum())
        )
        cost += float(step @ self.shared @ step) + 2.0 * float((fields * (self.between @ step)).sum())
        return cost + float((fields * (self.own @ fields[:, :, None])[:, :, 0]).sum())

    def readings_left(self, solution: Solution) -> Array:
        """Return the (m, 3) residuals of the readings at a solution, in the principal axes."""
        own = (self.own_rows @ solution.fields[self._poses][:, :, None])[:, :, 0]
        return np.asarray(self.off - self.rows @ solution.step - own)

    def rotation_steps(self, squares: Array, step: Array, fields: Array) -> Array:
        """Return (m, 3) the rotation vectors of the views, rad, that belong to (S,) and (n, F) steps of all else."""
        basis = self.equations.maps @ step
        basis[:, self.problem.bench.layout.own.places] += fields
        by_stars = self.equations.turned - (self.equations.coupling @ basis[self._poses][:, :, None])[:, :, 0]
        if not self.uses_readings:
            return np.asarray(by_stars)
        predicted = self.equations.gimbal @ step[self.problem.bench.gimbal_places]
        already = self.equations.off - self.equations.turned  # readings to the present rotation
        to_readings = (self.axes @ (predicted - already - by_stars)[:, :, None])[:, :, 0]
        share = squares[self.problem.hyper.at(amp.STAR)] * self.loose * self.reading_weights(squares)
        return np.asarray(
            by_stars + (np.swapaxes(self.axes, 1, 2) @ (share * to_readings)[:, :, None])[:, :, 0]
        )
