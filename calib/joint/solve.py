"""The search: from a start to the state and the amplitudes of the largest posterior.

Steps of Gauss and Newton at given amplitudes, shortened while they do not lower the cost; between them the amplitudes
are searched by Newton's method (`calib.joint.curvature`). A worse likelihood is never accepted.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calib.arrays import Array
from calib.errors import NotConverged
from calib.joint import amplitudes as amp
from calib.joint.curvature import ROUGH, best_amplitudes
from calib.joint.equations import Equations, State
from calib.joint.layout import Layout
from calib.joint.marginal import Marginal, Problem, Solution
from calib.joint.places import step_to_places
from calib.joint.prior import Faults
from calib.joint.stars import robust_sigma
from calib.progress import in_round

#: A search that has not ended after so many rounds is said not to have converged: most end within ten.
ROUNDS = 100
#: Stars begin as noisy as this share of their residuals there, but not better than stated.
_FIRST_NOISE = 0.03
#: Stars are weighed again in so many rounds with a short step, and then no more: a k-step M-estimator (Bickel, 1975).
#: Where the errors at the rim are no smooth field, the weights would go on to fall for 20 rounds.
_REWEIGHTED = 7
#: A step is small if it moves camera and centre by less than this share of their sigmas.
_SMALL_SHARE = 0.04
#: From this round on a larger share is small: the result holds the last step, so that it lacks only where that bends.
#: The amplitudes stay as they are: with a lens of the wrong family they would change for 100 rounds.
_LATE, _LATE_SHARE = 20, 0.25
#: A round that takes back what the last one did shortens all steps; others make them longer again.
_SLOWER, _FASTER = 0.5, 1.5
_HALVINGS = 6
#: A step is taken if it lowers the cost by this share of what it would if all were linear (Armijo, 1966); else half.
_LEAST_GAIN = 0.1
#: Largest number of steps of a search of amplitudes in a round.
_QUICK = 3
#: Before the state is found, a round changes no logarithm of an amplitude by more than this.
_FARTHEST = 1.0
#: No step moves a focal length or the radius by more than this share.
_LONGEST = 0.3
#: The equations hold for steps of this share of focal length and radius: amplitudes are taken if their step is shorter.
TRUSTED = 0.01
#: Beyond this share the rotations are found again after a step; below the second, all that a pose has for itself.
CURVED, _CORRECTED = 1e-3, 0.05
_CORRECTIONS = 3
#: A step is corrected whole, and after so many halvings: where it bends, a quarter of it can be, and not the whole.
_CORRECTED_AT = (0, 2)


@dataclass(frozen=True)
class Optimum:
    """The end of the search."""

    solution: Solution
    iterations: int
    converged: bool
    # (A,) amplitudes with the faults that lead to this state (`optimum_with_faults`)
    fault_eta: Array | None = None

    @property
    def marginal(self) -> Marginal:
        """The equations."""
        return self.solution.marginal

    @property
    def eta(self) -> Array:
        """(A,) logarithms of the amplitudes."""
        return self.solution.eta

    @property
    def state(self) -> State:
        """The state of the equations."""
        return self.marginal.state

    @cached_property
    def at_best(self) -> Optimum:
        """The optimum at its best amplitudes, which a long search does not look for at its end."""
        return replace(self, solution=best_amplitudes(self.solution))

    @property
    def disagreement(self) -> float:
        """How many times more than star noise the poses differ: 1 without own fields (Birge, 1932)."""
        fields = self.state.fields + self.solution.fields
        explained = float(np.einsum("nf,nfg,ng->", fields, self.marginal.own, fields))
        return float(np.sqrt(1.0 + explained / (fields.size * self.solution.star_variance)))


def search(problem: Problem, start: State, eta: Array | None = None) -> Optimum:
    """Return the optimum after at most `ROUNDS` linearisations; `NotConverged` if the equations cannot be solved.

    The (A,) logarithms ``eta`` of the first amplitudes may be known.
    """
    eta, state = first_amplitudes(problem, start) if eta is None else eta, start
    equations, short_steps, pace = first_equations(problem, start), 0, _Pace(np.zeros(len(eta)))
    for k in range(ROUNDS):
        in_round(k)
        marginal = Marginal(problem, equations, state)
        solution, pace = _in_round(k, solved(marginal, eta), pace)
        share = _SMALL_SHARE if k < _LATE else _LATE_SHARE
        short_steps += relative_step(marginal, solution.step) < TRUSTED
        placed = problem.pupils is None or short_steps > 1
        if k > 1 and placed and small(solution, share):
            if k < _LATE and pace.size == 1.0:
                solution = searched(solution)
            if small(solution, share):
                return Optimum(solution, k + 1, converged=True)
        state, lengths = shortened(solution, pace.size)
        if short_steps and problem.pupils is not None:
            problem, state, lengths = _placed(solution, state, pace.size)
        eta, spread = solution.eta, robust_sigma(lengths)
        limit = max(spread, float(np.sqrt(solution.star_variance))) if k else 3.0 * spread
        before = equations if short_steps >= _REWEIGHTED else None
        equations = problem.bench.linearised(state, limit, before, is_near=short_steps > 0)
    return Optimum(marginal.solve(eta), ROUNDS, converged=False)


def _placed(solution: Solution, state: State, size: float) -> tuple[Problem, State, Array]:
    """Return the problem with better places of the pupils, and a state there with the lengths of its residuals.

    ``size`` is the share of the step.
    """
    problem = solution.marginal.problem
    bench = replace(problem.bench, pupils=problem.bench.pupils + size * step_to_places(solution))
    state = bench.aligned(state, solution.marginal.equations.weights)
    return replace(problem, bench=bench), state, bench.whitened(state)


@dataclass(frozen=True)
class _Pace:
    """How far a round goes: less while amplitudes swing between two ends, each better by the equations of the other."""

    change: Array  # (A,) of the logarithms of the amplitudes, as the last round would have them
    size: float = 1.0  # Share of steps that is taken

    def after(self, change: Array) -> _Pace:
        """Return the pace of the next round. It is slower if the amplitudes turn back; else it is faster."""
        swings = float(change @ self.change) < 0.0
        return _Pace(change, self.size * _SLOWER if swings else min(1.0, self.size * _FASTER))


def _in_round(k: int, solution: Solution, pace: _Pace) -> tuple[Solution, _Pace]:
    """Return the solution and the pace of a round; ``solution`` has the amplitudes of the last round.

    The first round keeps its amplitudes; its robust limits are wide.
    """
    if k == 0 or k >= _LATE:
        return solution, pace
    with _solvable():
        better = best_amplitudes(solution, _QUICK, farthest=_FARTHEST, enough=ROUGH)
    pace = pace.after(better.eta - solution.eta)
    if pace.size == 1.0:
        return better, pace
    return solved(solution.marginal, solution.eta + pace.size * pace.change), pace


def first_equations(problem: Problem, state: State, lengths: Array | None = None) -> Equations:
    """Return the equations with wide robust limits; the residuals' ``lengths`` over their sigma may be known."""
    spread = robust_sigma(problem.bench.whitened(state) if lengths is None else lengths)
    return problem.bench.linearised(state, 3.0 * spread)


def approached(problem: Problem, start: State, equations: Equations) -> State:
    """Return a state near the optimum: at most `ROUNDS` steps at the first amplitudes, with wide robust limits."""
    state = start
    for _ in range(ROUNDS):
        solution = solved(Marginal(problem, equations, state), first_amplitudes(problem, state))
        before = state
        state, lengths = shortened(solution)
        if np.abs(state.shared[:2] / before.shared[:2] - 1.0).max() < TRUSTED:
            break
        equations = first_equations(problem, state, lengths)
    return state


def optimum_with_faults(optimum: Optimum, faults: Faults) -> Optimum:
    """Return an optimum whose equations are those of the state that some faults of statements lead to.

    A grossly wrong statement takes the state so far away that the equations do not hold where the others lead.
    """
    problem = optimum.marginal.problem
    there = search_with_fault(problem, optimum.state, faults, optimum.eta)
    return replace(there, iterations=optimum.iterations + there.iterations)


def search_with_fault(problem: Problem, start: State, faults: Faults, eta: Array | None = None) -> Optimum:
    """Return the optimum without faults by the equations of the state that these lead to.

    The best amplitudes are searched from ``eta``, or from those with the faults.
    """
    there = search(replace(problem, faults=faults), start)
    placed = replace(there.marginal.problem, faults=problem.faults)  # a hand's pupils are elsewhere there
    marginal = Marginal(placed, there.marginal.equations, there.state)
    solution = searched(solved(marginal, there.eta if eta is None else eta))
    return Optimum(solution, there.iterations, there.converged, there.eta)


def first_amplitudes(problem: Problem, state: State) -> Array:
    """Return (A,) logarithms of amplitudes to begin with: small errors, and readings as noisy as they are here.

    Readings that belong to other poses would otherwise take the state along. Stars whose sigmas are in another unit
    would make the fields grow.
    """
    eta = problem.hyper.stiff.copy()
    at, spread = problem.hyper.at(amp.STAR), robust_sigma(problem.bench.whitened(state))
    eta[at] = max(eta[at], np.log(_FIRST_NOISE * spread))
    readings = problem.bench.readings
    if readings is not None and state.gimbal is not None:
        rms = float(np.sqrt(np.mean(problem.bench.readings_off(state) ** 2)))
        at = problem.hyper.at(amp.READING)
        eta[at] = np.log(max(np.exp(eta[at]), rms / readings.sigma_rad))
    return eta


@contextmanager
def _solvable() -> Iterator[None]:
    """Raise `NotConverged` if the equations cannot be solved."""
    try:
        yield
    except np.linalg.LinAlgError as error:
        raise NotConverged("The joint adjustment cannot be solved.") from error


def solved(marginal: Marginal, eta: Array) -> Solution:
    """Return the solution for given amplitudes; `NotConverged` if the equations cannot be solved."""
    with _solvable():
        return marginal.solve(eta)


def small(solution: Solution, share: float = _SMALL_SHARE) -> bool:
    """Tell whether a step of camera and centre no longer matters."""
    layout = solution.marginal.problem.bench.layout
    at = layout.places((*layout.pose.camera, "x", "y", "r"))
    return bool((np.abs(solution.step[at]) < share * np.sqrt(np.diag(solution.covariance)[at])).all())


def searched(solution: Solution) -> Solution:
    """Search the best amplitudes from a solution, and return theirs; `NotConverged` if there is none."""
    with _solvable():
        return best_amplitudes(solution)


def relative_step(marginal: Marginal, step: Array) -> float:
    """Return the largest (S,) step of focal lengths and centre, as a share of the focal length and of the radius."""
    return relative_change(marginal.problem.bench.layout, marginal.state, step)


def relative_change(layout: Layout, state: State, step: Array) -> float:
    """Return the same from another state."""
    b = state.shared
    focal, centre = (np.abs(step[layout.places(names)]).max() for names in (("fx", "fy"), ("x", "y", "r")))
    return float(max(focal / abs(b[0]), centre / abs(b[layout.index["r"]])))


def shortened(solution: Solution, most: float = 1.0) -> tuple[State, Array]:
    """Return the state after a step, shorter and shorter while the cost rises, and the lengths of its residuals.

    ``most`` is the share of the step that is tried first.
    Centre, rotations and the middles of the discs move along a curve, so a whole step is tried with these behind it.
    """
    marginal, squares = solution.marginal, solution.squares
    bench = marginal.problem.bench
    before = cost(marginal, squares, marginal.state, marginal.equations.lengths)
    share = relative_step(marginal, solution.step)
    size = min(most, _LONGEST / max(share, TRUSTED))
    for k in range(_HALVINGS):
        state = moved(marginal, squares, size * solution.step, size * solution.fields)
        lengths = bench.whitened(state)
        enough = before * (1.0 + 1e-9) - _LEAST_GAIN * size * (2.0 - size) * solution.gain
        if cost(marginal, squares, state, lengths) <= enough:
            break
        if k in _CORRECTED_AT and share < _CORRECTED:
            corrected, lengths = _corrected(marginal, squares, state)
            if cost(marginal, squares, corrected, lengths) <= enough:
                return corrected, lengths
        size *= 0.5
    return state, lengths


def _corrected(marginal: Marginal, squares: Array, state: State) -> tuple[State, Array]:
    """Return a state after further steps of what each pose has for itself, with the same weights and amplitudes.

    Variable projection (Golub and Pereyra, 1973).
    """
    bench = marginal.problem.bench
    own = bench.layout.own.places
    for _ in range(_CORRECTIONS):
        behind = Marginal(
            marginal.problem, bench.linearised(state, before=marginal.equations, entries=own), state
        )
        with _solvable():
            fields = behind.own_steps(squares)
        state = moved(behind, squares, np.zeros_like(state.shared), fields)
    return state, bench.whitened(state)


def moved(marginal: Marginal, squares: Array, step: Array, fields: Array) -> State:
    """Return the state after steps: (S,) of the shared unknowns, (n, F) of the own fields. The rotations follow."""
    bench = marginal.problem.bench
    state = bench.moved(marginal.state, step, fields, marginal.rotation_steps(squares, step, fields))
    if relative_step(marginal, step) > CURVED:
        return bench.aligned(state, marginal.equations.weights)
    return state


def cost(marginal: Marginal, squares: Array, state: State, lengths: Array) -> float:
    """Return the cost of a state: stars as the equations weigh them, readings, priors; infinite behind the camera.

    ``lengths`` are the (N,) lengths of the residuals over their sigma.
    """
    bench, hyper, weights = marginal.problem.bench, marginal.problem.hyper, marginal.equations.weights
    if not np.isfinite(lengths).all():
        return float("inf")
    total = float(weights @ lengths**2) / squares[hyper.at(amp.STAR)]
    total += marginal.prior_cost(squares, state)
    if marginal.uses_readings and bench.readings is not None:
        variance = marginal.reading_variance(squares)
        total += float((bench.readings_off(state) ** 2 / variance).sum())
    return total
