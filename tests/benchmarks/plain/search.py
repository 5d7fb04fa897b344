"""The search: best amplitudes at given equations, and a robust Gauss-Newton search of the state."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.arrays import Array
from calib.progress import in_round

from .equations import Equations
from .problem import Problem, State
from .solution import AS_STATED, Solution, Wide, solve
from .weights import Weights, spread, weights

#: A step may move focal length, foot and radius by this share; below the second number, weights begin to rest.
_LONGEST, _SETTLED = 0.3, 0.01
#: New amplitudes count as far as their step is no longer than this share, or than with the old ones.
_BEND = 0.02
#: So often are weights chosen near the end; and amplitudes move by this many at most before.
_WEIGHED, _FIRST_WEIGHED, _FARTHEST = 7, 3, 1.5
#: A search ends if nothing moves by more than this share of its sigma; after so many rounds, by more than the other.
_ENDED, _LATE, _ENDED_LATE = 0.05, 20, 0.25
#: A bundle is at its end when the camera moves by no more than this share, or after so many rounds.
_NEAR, _BUNDLE_ROUNDS = 0.003, 10
#: Residuals of a start are so many times the noise.
_START_NOISE = 3.0
#: Steps of the amplitudes in a round, and at the end.
_STEPS, FINAL_STEPS = 6, 40
_HALVINGS = 8
#: Damping begins with this information, in shares of camera and radius, and grows tenfold.
_DAMPING, _NO_DAMPING, _SHORT = 1e3, 1e2, 0.2
_BUNDLE, _SMALL, _ALL = range(3)


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
    """Return the solution with the best amplitudes: by L-BFGS, scaled, within the reach of their prior."""
    from scipy.optimize import minimize  # here: a forecast needs none, and it is slow to import

    low, high = solution.problem.expected.bounds
    begin = np.clip(solution.eta, low, high)
    low, high = np.maximum(low, begin - farthest), np.minimum(high, begin + farthest)
    best, scale = solution, solution.scale

    def value(u: Array) -> tuple[float, Array]:
        nonlocal best
        try:
            at = solve(solution.equations, begin + u * scale, solution.wide)
        except np.linalg.LinAlgError:
            return 1e12, np.zeros_like(u)
        if at.value < best.value:
            best = at
        return at.value, at.gradient * scale

    bounds = list(zip((low - begin) / scale, (high - begin) / scale, strict=True))
    options = {"maxiter": steps, "maxfun": 2 * steps, "ftol": 1e-9, "gtol": 0.05}
    minimize(  # type: ignore[call-overload]
        value, np.zeros(len(begin)), jac=True, method="L-BFGS-B", bounds=bounds, options=options
    )
    return best


def cost(state: State, solution: Solution) -> float:
    """Return what a step must lower: stars as weighed, what is known, readings; infinite behind the camera."""
    p, prior = solution.problem, solution.prior
    lengths = p.lengths(state)
    if not all(np.isfinite(length).all() for length in lengths):
        return np.inf
    whole = zip(solution.equations.weights.whole, lengths, strict=True)
    total = prior.star * sum(float(weight @ length**2) for weight, length in whole)
    total += float((state.b - p.unknowns.mean) ** 2 @ prior.shared) + float((state.own**2 @ prior.own).sum())
    if p.readings is not None:
        views = np.bincount(p.poses)[p.poses]
        off = p.readings.off(state.b[p.readings.at], state.rotations)
        total += prior.reading * float((off**2 / views[:, None]).sum())
    return total


def followed(state: State, solution: Solution) -> State:
    """Return the state whose rotations and own fields fit best, all that is shared held (Golub and Pereyra, 1973)."""
    p, prior, f = solution.problem, solution.prior, solution.equations.own_size
    for _ in range(2):
        q = Equations.at(p, state, solution.equations.weights)
        _, alone, right = q.local
        d, rl = prior.star * alone, prior.star * right
        d[:, range(d.shape[1]), range(d.shape[1])] += q.empty
        d[:, range(f), range(f)] += prior.own
        rl[:, :f] -= state.own * prior.own
        if p.readings is not None:
            views = np.bincount(p.poses)
            for v, (pose, slot) in enumerate(zip(p.poses, q.slots, strict=True)):
                weight = prior.reading / views[pose]
                d[pose, slot, slot] += weight * np.eye(3)
                rl[pose, slot] -= weight * q.off[v]
        local = np.asarray(np.linalg.solve(d, rl[:, :, None])[:, :, 0], np.float64)
        state = state.moved(np.zeros_like(state.b), local[:, :f], q.turns(local))
    return state


@dataclass
class _Search:
    """A search at work."""

    problem: Problem
    state: State
    wide: Wide
    eta: Array
    phase: int = _BUNDLE
    settled: int = 0  # Rounds near the end
    rounds: int = 0  # Of this phase
    damping: float = 0.0
    weights: Weights | None = None

    def __post_init__(self) -> None:
        self.residuals = self.problem.whitened(self.state)

    def amplitudes(self) -> Array:
        """Return the amplitudes to begin a round with: they are not searched before the state holds.

        They would grow to explain what is an error of the start.
        """
        p = self.problem
        if self.phase == _ALL:
            return self.eta
        begin = (p.expected.bundle if self.phase == _BUNDLE else p.expected.stiff).copy()
        log_spread = float(np.log(spread(self.residuals)))
        begin[p.star] = log_spread if self.phase == _BUNDLE else max(begin[p.star], log_spread + np.log(0.1))
        if p.readings is not None:
            off = p.readings.off(self.state.b[p.readings.at], self.state.rotations)
            rms = float(np.sqrt(np.mean(off**2)))
            begin[p.reading] = max(begin[p.reading], np.log(rms / p.readings.sigma_rad))
        return np.asarray(begin)

    def solution(self) -> Solution:
        """Return the solution of a round."""
        eta, p = self.amplitudes(), self.problem
        if self.settled < _WEIGHED or self.weights is None:
            noise = max(spread(self.residuals), float(np.exp(eta[p.star])))
            self.weights = weights(p, self.residuals, noise * (1.0 if self.phase == _ALL else _START_NOISE))
        q = Equations.at(p, self.state, self.weights)
        first = solve(q, eta, self.wide, self.damping)
        if self.phase < _ALL or self.damping:
            return first
        better = best_amplitudes(first, _STEPS, _FARTHEST if self.settled < _FIRST_WEIGHED else np.inf)
        for _ in range(3):  # amplitudes count only where the equations hold for their step
            if better.moved <= max(_BEND, first.moved):
                break
            better = solve(q, 0.5 * (better.eta + first.eta), self.wide)
        return better

    def ended(self, solution: Solution, number: int) -> bool:
        """Tell whether a round moves nothing any more."""
        if self.phase < _ALL or self.damping:
            return False
        rows = np.concatenate([np.eye(4, len(solution.step)), self.problem.wide[5:]])
        sigmas = np.sqrt(((rows @ solution.covariance) * rows).sum(axis=1))
        moved = float((np.abs(rows @ solution.step) / sigmas).max())
        return moved < (_ENDED if number < _LATE else _ENDED_LATE)

    def step(self, solution: Solution) -> None:
        """Take as much of a step as lowers the cost; rotations and own fields follow it."""
        before, share = cost(self.state, solution), min(1.0, _LONGEST / max(solution.moved, 1e-9))
        there = self.state
        for _ in range(_HALVINGS):
            there = self.state.moved(*solution.there(), share)
            if share * solution.moved > 1e-4 and np.isfinite(cost(there, solution)):
                there = followed(there, solution)
            if cost(there, solution) <= before * (1.0 + 1e-9):
                break
            share *= 0.5
        else:
            there = self.state
        if share < _SHORT:
            self.damping = max(10.0 * self.damping, _DAMPING)
        else:
            self.damping = 0.1 * self.damping if self.damping > _NO_DAMPING else 0.0
        self.state, self.eta, self.rounds = there, solution.eta, self.rounds + 1
        self.residuals = self.problem.whitened(self.state)
        self.settled += self.phase == _ALL and solution.moved < _SETTLED
        if self.phase < _ALL and (
            (solution.moved < _NEAR and not self.damping) or self.rounds >= _BUNDLE_ROUNDS
        ):
            self.phase, self.rounds = self.phase + 1, 0


def search(problem: Problem, state: State, most: int, wide: Wide = AS_STATED) -> Optimum:
    """Go from a state to the optimum: as a bundle, then with small amplitudes, then with amplitudes in each round."""
    at = _Search(problem, state, wide, problem.expected.bundle.copy())
    solution: Solution | None = None
    for number in range(most):
        in_round(number)
        solution = at.solution()
        if at.ended(solution, number):
            return Optimum(solution, number + 1, converged=True)
        at.step(solution)
    assert solution is not None
    return Optimum(solution, most, converged=False)
