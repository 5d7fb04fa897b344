"""The search: best amplitudes at given equations, and a robust Gauss-Newton search of the state."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from calib.arrays import Array
from calib.progress import in_round

from .equations import Equations
from .problem import Problem, State
from .solution import AS_STATED, Solution, Wide, bent, expected_curvature, reading_weights, solve
from .weights import Weights, spread, weights

#: A step may move focal length, foot and radius by this share; below the second number, weights begin to rest.
_LONGEST, _SETTLED = 0.3, 0.01
#: New amplitudes count as far as their step is no longer than this share, or than with the old ones.
_BEND = 0.02
#: After a shorter step, as a share, rotations and own fields need not follow.
_STRAIGHT = 1e-4
#: So often are weights chosen near the end; and amplitudes move by this many at most before.
_WEIGHED, _FIRST_WEIGHED, _FARTHEST = 7, 3, 1.5
#: A search ends if nothing moves by more than this share of its sigma; after so many rounds, by more than the other.
_ENDED, _LATE, _ENDED_LATE = 0.05, 20, 0.25
#: A state holds when the camera moves by no more than this share, or after so many rounds.
_NEAR, _FIRST_ROUNDS = 0.003, 10
#: Residuals of a start are so many times the noise.
_START_NOISE = 3.0
#: Steps of the amplitudes in a round, and at the end. They end if -2 log of the likelihood falls by no more than the
#: third number; the shortest is this share of one.
_STEPS, FINAL_STEPS, _NOTHING, _SHORTEST = 5, 20, 2e-3, 0.1
_HALVINGS = 8
#: Damping begins with this information, in shares of camera and radius, and grows tenfold.
_DAMPING, _NO_DAMPING, _SHORT = 1e3, 1e2, 0.2


@dataclass(frozen=True)
class Optimum:
    """The end of a search."""

    solution: Solution
    rounds: int
    converged: bool

    @property
    def state(self) -> State:
        """The state after the last step."""
        return self.solution.equations.state.moved(*self.solution.there())


def best_amplitudes(solution: Solution, steps: int = FINAL_STEPS, farthest: float = np.inf) -> Solution:
    """Return the solution with the best amplitudes, within the reach of their prior.

    By the method of Broyden, Fletcher, Goldfarb and Shanno, from the expected curvature (Harville, 1977).
    """
    low, high = solution.problem.expected.bounds
    begin, best = np.clip(solution.eta, low, high), solution
    low, high = np.maximum(low, begin - farthest), np.minimum(high, begin + farthest)
    inverse = np.linalg.inv(expected_curvature(best))
    for _ in range(steps):
        step, share = np.clip(best.eta - inverse @ best.gradient, low, high) - best.eta, 1.0
        if -0.5 * step @ best.gradient < _NOTHING:
            break
        there = _solved(best, step)
        while there is None or there.value > best.value:
            share *= 0.5
            if share < _SHORTEST:
                return best
            there = _solved(best, share * step)
        bent, along = there.gradient - best.gradient, there.eta - best.eta
        if bent @ along > 0.0:
            left = np.eye(len(along)) - np.outer(along, bent) / (bent @ along)
            inverse = left @ inverse @ left.T + np.outer(along, along) / (bent @ along)
        best = there
    return best


def _solved(best: Solution, step: Array) -> Solution | None:
    """Return the solution with other amplitudes; None if these do not determine all unknowns."""
    with suppress(np.linalg.LinAlgError):
        return solve(best.equations, best.eta + step, best.wide)
    return None


def cost(state: State, residuals: Sequence[Array], solution: Solution) -> float:
    """Return what a step must lower: stars as weighed, what is known, readings; infinite behind the camera.

    residuals: those of the state, for each view (N, 2), over their sigma.
    """
    p, prior = solution.problem, solution.prior
    if not all(np.isfinite(off).all() for off in residuals):
        return np.inf
    whole = zip(solution.equations.weights.whole, residuals, strict=True)
    total = prior.star * sum(float(weight @ (off**2).sum(axis=1)) for weight, off in whole)
    total += float((state.b - p.unknowns.mean) ** 2 @ prior.shared) + float((state.own**2 @ prior.own).sum())
    bend = solution.equations.bent
    if bend is not None:
        away = (state.b - solution.equations.state.b)[bend.at]
        total += float(2.0 * bend.gradient @ away + away @ bend.curvature @ away)
    if p.readings is not None:
        views = np.bincount(p.poses)[p.poses]
        off = p.readings.off(state.b[p.readings.at], state.rotations)
        total += prior.reading * float((off**2 / views[:, None]).sum())
    return total


def followed(state: State, solution: Solution) -> State:
    """Return the state whose rotations and own fields fit best, all that is shared held (Golub and Pereyra, 1973)."""
    p, prior, f = solution.problem, solution.prior, solution.equations.own_size
    q = Equations.at(p, state, solution.equations.weights)
    if not np.isfinite(q.cost):
        return state
    _, alone, right = q.of_local
    d, rl = prior.star * alone, prior.star * right
    d[:, range(d.shape[1]), range(d.shape[1])] += q.empty
    d[:, range(f), range(f)] += prior.own
    rl[:, :f] -= state.own * prior.own
    if p.readings is not None:
        for v, weight in enumerate(reading_weights(q, prior)):
            pose, slot = p.poses[v], q.slots[v]
            d[pose, slot, slot] += weight * np.eye(3)
            rl[pose, slot] -= weight * q.off[v]
    local = np.asarray(np.linalg.solve(d, rl[:, :, None])[:, :, 0], np.float64)
    return state.moved(np.zeros_like(state.b), local[:, :f], q.turns(local))


@dataclass
class _Search:
    """A search at work."""

    problem: Problem
    state: State
    wide: Wide
    eta: Array
    holds: bool  # The state: amplitudes are searched
    settled: int = 0  # Rounds near the end
    rounds: int = 0  # Until it holds
    damping: float = 0.0
    weights: Weights | None = None
    bundle: bool = False  # Whether a start is brought near first

    def __post_init__(self) -> None:
        self.residuals = self.problem.whitened(self.state)
        if not all(np.isfinite(off).all() for off in self.residuals):
            raise np.linalg.LinAlgError("Stars lie behind the camera.")

    def amplitudes(self) -> Array:
        """Return the amplitudes to begin a round with: they are not searched before the state holds.

        They would grow to explain what is an error of the start.
        """
        p = self.problem
        if self.holds:
            return self.eta
        begin = (p.expected.bundle if self.bundle else self.eta).copy()
        begin[p.star] = max(begin[p.star], float(np.log(spread(self.residuals))) + np.log(0.1))
        if p.readings is not None:
            off = p.readings.off(self.state.b[p.readings.at], self.state.rotations)
            rms = float(np.sqrt(np.mean(off**2)))
            begin[p.reading] = max(begin[p.reading], np.log(rms / p.readings.sigma_rad))
        return np.asarray(begin)

    def solution(self) -> Solution:
        """Return the solution of a round."""
        eta, p, is_first = self.amplitudes(), self.problem, self.weights is None
        if self.settled < _WEIGHED or self.weights is None:
            noise = max(spread(self.residuals), float(np.exp(eta[p.star])))
            self.weights = weights(p, self.residuals, noise * (1.0 if self.holds else _START_NOISE))
        q = Equations.at(p, self.state, self.weights)
        first = solve(q, eta, self.wide, self.damping)
        if self.holds and p.places is not None:
            first = solve(replace(q, bent=bent(first)), eta, self.wide, self.damping)
        if not self.holds or self.damping or is_first:
            return first
        better = best_amplitudes(first, _STEPS, _FARTHEST if self.settled < _FIRST_WEIGHED else np.inf)
        for _ in range(3):  # amplitudes count only where the equations hold for their step
            if better.moved <= max(_BEND, first.moved):
                break
            better = solve(first.equations, 0.5 * (better.eta + first.eta), self.wide)
        return better

    def ended(self, solution: Solution, number: int) -> bool:
        """Tell whether a round moves nothing any more."""
        if not self.holds or self.damping:
            return False
        rows = np.concatenate([np.eye(4, len(solution.step)), self.problem.wide[5:]])
        sigmas = np.sqrt(((rows @ solution.covariance) * rows).sum(axis=1))
        moved = float((np.abs(rows @ solution.step) / sigmas).max())
        return moved < (_ENDED if number < _LATE else _ENDED_LATE)

    def step(self, solution: Solution) -> None:
        """Take as much of a step as lowers the cost; rotations and own fields follow it."""
        before = cost(self.state, self.residuals, solution)
        share = min(1.0, _LONGEST / max(solution.moved, 1e-9))
        for _ in range(_HALVINGS):
            there = self.state.moved(*solution.there(), share)
            if share * solution.moved > _STRAIGHT:
                there = followed(there, solution)
            residuals = self.problem.whitened(there)
            if cost(there, residuals, solution) <= before * (1.0 + 1e-9):
                self.state, self.residuals = there, residuals
                break
            share *= 0.5
        if share < _SHORT:
            self.damping = max(10.0 * self.damping, _DAMPING)
        else:
            self.damping = 0.1 * self.damping if self.damping > _NO_DAMPING else 0.0
        self.rounds += 1
        if not self.bundle:
            self.eta = solution.eta
        self.settled += self.holds and solution.moved < _SETTLED
        if (solution.moved < _NEAR and not self.damping) or self.rounds >= _FIRST_ROUNDS:
            self.holds |= not self.bundle
            self.bundle, self.rounds = False, 0


def search(
    problem: Problem,
    state: State,
    most: int,
    wide: Wide = AS_STATED,
    eta: Array | None = None,
    reach: float = np.inf,
) -> Optimum:
    """Go from a state to the optimum: as a bundle, with small amplitudes, then with the best ones in each round.

    ``eta``: amplitudes of an end that is near. ``reach``: the search ends where focal length or radius have moved by a
    larger share before amplitudes are searched.
    """
    first = problem.expected.stiff if eta is None else eta
    at = _Search(problem, state, wide, first, eta is not None, bundle=eta is None)
    solution: Solution | None = None
    for number in range(most):
        in_round(number)
        solution = at.solution()
        if at.ended(solution, number):
            return Optimum(solution, number + 1, converged=True)
        at.step(solution)
        if at.holds and np.abs(problem.wide[[0, 5]] @ at.state.b).max() > reach:
            most = number + 1
            break
    assert solution is not None
    return Optimum(solution, most, converged=False)
