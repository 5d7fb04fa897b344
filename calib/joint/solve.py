"""The search: from a start to the state and the amplitudes of the largest posterior.

Steps of Gauss and Newton at given amplitudes, shortened while they do not lower the cost; between them the amplitudes
are searched by L-BFGS-B with the exact gradient. A worse likelihood is never accepted.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.errors import NotConverged
from calib.joint import amplitudes as amp
from calib.joint.equations import Equations, State, robust_sigma
from calib.joint.marginal import NO_FAULT, Faults, Marginal, Problem, Solution

Array = NDArray[np.float64]

#: Rounds with large robust limits, before the first search of amplitudes.
_FIRST_ROUNDS = 1
#: A step is small if it moves the camera by less than this, px, and less than this share of its sigma.
_SMALL_PX, _SMALL_SHARE = 1e-3, 0.02
#: A start is near if a step moves no focal length by more than this share.
_NEAR = 0.003
_HALVINGS = 6
_QUICK, _LONG = 12, 60
#: Before the state is found, a round changes no logarithm of an amplitude by more than this.
_FARTHEST = 1.0
#: No step moves a focal length or the radius by more than this share.
_LONGEST = 0.3
#: Amplitudes are taken if their step moves focal length and centre by less than this share.
_TRUSTED = 0.01
#: Beyond this share the rotations are found again after a step.
_CURVED = 1e-3


@dataclass(frozen=True)
class Optimum:
    """The end of the search."""

    marginal: Marginal
    eta: Array  # (A,) logarithms of the amplitudes
    solution: Solution
    iterations: int
    converged: bool

    @property
    def state(self) -> State:
        """The state of the equations."""
        return self.marginal.state


def search(problem: Problem, start: State, rounds: int) -> Optimum:
    """Return the optimum.

    rounds: Largest number of linearisations.
    Raises NotConverged: If the equations cannot be solved.
    """
    eta, state = problem.hyper.mean, start
    bench = problem.bench
    limit = 3.0 * robust_sigma(bench.whitened(state))
    found = None
    for k in range(rounds):
        equations = bench.linearised(state, limit)
        marginal = Marginal(problem, equations, state)
        if k >= _FIRST_ROUNDS:
            eta = trusted_amplitudes(marginal, eta)
        found = solved(marginal, eta)
        if k > _FIRST_ROUNDS and small(marginal, found):
            eta = better_amplitudes(marginal, eta)
            found = marginal.solve(eta)
            if small(marginal, found):
                return Optimum(marginal, eta, found, k + 1, converged=True)
        state = shortened(marginal, eta, found)
        spread = robust_sigma(bench.whitened(state))
        limit = spread if k else 3.0 * spread
        if k >= _FIRST_ROUNDS:
            limit = max(limit, float(np.exp(eta[problem.hyper.at(amp.STAR)])))
    assert found is not None
    return Optimum(marginal, eta, marginal.solve(eta), rounds, converged=False)


def approached(problem: Problem, start: State, rounds: int) -> State:
    """Return a state near the optimum: steps at the expected amplitudes, with wide robust limits.

    rounds: Largest number of linearisations.
    Raises NotConverged: If the equations cannot be solved.
    """
    state, bench, eta = start, problem.bench, problem.hyper.mean
    for _ in range(rounds):
        limit = 3.0 * robust_sigma(bench.whitened(state))
        marginal = Marginal(problem, bench.linearised(state, limit), state)
        before, found = state, solved(marginal, eta)
        state = shortened(marginal, eta, found)
        if np.abs(state.shared / np.where(before.shared == 0.0, 1.0, before.shared) - 1.0)[:2].max() < _NEAR:
            break
    return state


def solved(marginal: Marginal, eta: Array) -> Solution:
    """Return the solution for given amplitudes.

    Raises NotConverged: If the equations cannot be solved.
    """
    try:
        return marginal.solve(eta, slope=False)
    except np.linalg.LinAlgError as error:
        raise NotConverged("The joint adjustment cannot be solved.") from error


def small(marginal: Marginal, found: Solution) -> bool:
    """Tell whether a step no longer matters: of camera and centre, in px or in their sigmas."""
    layout = marginal.problem.bench.layout
    at = layout.places((*layout.camera, "x", "y", "r"))
    steps, sigmas = np.abs(found.step[at]), np.sqrt(np.diag(found.covariance)[at])
    return bool((steps < _SMALL_SHARE * sigmas).all() or (steps[:4] < _SMALL_PX).all())


def trusted_amplitudes(marginal: Marginal, eta: Array) -> Array:
    """Return better amplitudes whose step stays where the equations hold: half way back until it does."""
    better = best_amplitudes(marginal, eta, _QUICK, farthest=_FARTHEST)
    for _ in range(_HALVINGS):
        if relative_step(marginal, solved(marginal, better).step) < _TRUSTED:
            return better
        better = 0.5 * (better + eta)
    return eta


def relative_step(marginal: Marginal, step: Array) -> float:
    """Return the largest (S,) step of focal lengths and centre, as a share of the focal length and of the radius."""
    layout, b = marginal.problem.bench.layout, marginal.state.shared
    focal, centre = (np.abs(step[layout.places(names)]).max() for names in (("fx", "fy"), ("x", "y", "r")))
    return float(max(focal / abs(b[0]), centre / abs(b[layout.index["r"]])))


def better_amplitudes(marginal: Marginal, eta: Array) -> Array:
    """Return the best end of two searches, from a start and from the expected ones, where the equations hold."""
    ends = [best_amplitudes(marginal, start, steps=_LONG) for start in (eta, marginal.problem.hyper.mean)]
    found = [(solved(marginal, one), one) for one in (eta, *ends)]
    held = [
        (one.value, k) for k, (one, _) in enumerate(found) if relative_step(marginal, one.step) < _TRUSTED
    ]
    return found[min(held)[1]][1] if held else eta


def best_amplitudes(
    marginal: Marginal, eta: Array, steps: int, faults: Faults = NO_FAULT, farthest: float = np.inf
) -> Array:
    """Return the logarithms of the amplitudes of the largest posterior, from a start.

    farthest: Largest change of each.
    """
    from scipy.optimize import minimize

    scale = 1.0 / np.sqrt(marginal.curvature)

    def target(at: Array) -> tuple[float, Array]:
        try:
            found = marginal.solve(scale * at, faults)
        except np.linalg.LinAlgError:
            return 1e12, np.zeros(len(at))
        return found.value, scale * found.gradient

    bounds = [
        (max(low, own - farthest) / s, min(high, own + farthest) / s)
        for (low, high), own, s in zip(marginal.problem.hyper.bounds, eta, scale, strict=True)
    ]
    ended = minimize(
        target,
        eta / scale,
        jac=True,
        method="L-BFGS-B",
        bounds=bounds,
        options={"maxiter": steps, "ftol": 1e-7, "gtol": 1e-2},
    )
    return np.asarray(scale * ended.x if ended.fun <= target(eta / scale)[0] else eta)


def shortened(marginal: Marginal, eta: Array, found: Solution) -> State:
    """Return the state after a step, which is halved while the cost rises."""
    bench = marginal.problem.bench
    turns = marginal.rotation_steps(eta, found)
    share = relative_step(marginal, found.step)
    size = min(1.0, _LONGEST / share) if share > 0 else 1.0
    before = cost(marginal, eta, marginal.state, marginal.equations)
    for _ in range(_HALVINGS):
        state = bench.moved(marginal.state, size * found.step, size * found.fields, size * turns)
        if size * share > _CURVED:  # a large step turns the views by more than its linear part
            state = bench.aligned(state, marginal.equations.weights)
        after = cost(marginal, eta, state, marginal.equations)
        if after <= before * (1.0 + 1e-9):
            return state
        size *= 0.5
    return state


def cost(marginal: Marginal, eta: Array, state: State, equations: Equations) -> float:
    """Return the cost of a state: stars as the equations weigh them, readings, priors; infinite behind the camera."""
    bench, hyper = marginal.problem.bench, marginal.problem.hyper
    squares = np.exp(2.0 * eta)
    lengths = bench.whitened(state)
    if not all(np.isfinite(one).all() for one in lengths):
        return float("inf")
    stars = sum(float(w @ one**2) for w, one in zip(equations.weights, lengths, strict=True))
    total = stars / squares[hyper.at(amp.STAR)]
    total += marginal.prior_cost(squares, state)
    if marginal.uses_readings and bench.readings is not None:
        variance = squares[hyper.at(amp.READING)] * bench.readings.sigma_rad**2
        total += float((bench.readings_off(state) ** 2).sum()) / variance
    return total
