"""The expected curvature of the likelihood of the amplitudes, and the search of the best ones with it.

The expected information of variance components, 2 a_j^2 a_k^2 |U_j^T P U_k|^2, with P = Q - Q V Q for the prior
information Q and the posterior covariance V of the unknowns (Harville, 1977, section 5). It is positive definite.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from calib.arrays import Array
from calib.joint import amplitudes as amp
from calib.joint.marginal import Solution

#: No step of the search changes a logarithm by more than this.
_LONGEST = 1.5
_HALVINGS = 5
#: Largest number of steps of a search.
_MOST_STEPS = 30
#: A search ends where a step promises less than this of -2 log: 0.01 is a tenth of a sigma.
ROUGH, FINE = 0.02, 1e-3
#: The curvature is found again after a step that changes a logarithm by more than this.
_CURVED = 0.3


def expected_curvature(solution: Solution) -> Array:
    """Return (A, A) the expected second derivatives of the value by the logarithms of the amplitudes."""
    marginal, problem, squares = solution.marginal, solution.marginal.problem, solution.squares
    n, f, size = marginal.dimensions
    random = problem.random
    at = random.places
    scale = np.sqrt(problem.own_information(squares))
    fields = scale[:, None] * solution.followed
    alone = np.eye(f) - scale[:, None] * solution.own * scale
    pulled = random.pulled(squares, solution.inside)
    spread = random.times_pulled(solution.root.T[at].T, pulled)
    shared = -(spread.T @ spread)
    for rows, columns in random.blocks:
        shapes = random.shapes[rows, columns] * np.sqrt(squares[random.amplitudes[columns]])
        shared[columns, columns] += shapes.T @ pulled[rows, columns]
    parts = np.zeros((f + len(shared), f + len(shared)))
    parts[:f, :f] = (alone * (alone - 2.0 * fields @ np.swapaxes(fields, 1, 2))).sum(axis=0)
    flat = fields.reshape(n * f, size)
    both = (flat @ spread).reshape(n, f, -1)
    parts[:f, f:] = (both * both).sum(axis=0)
    parts[f:, :f] = parts[:f, f:].T
    parts[f:, f:] = shared * shared
    belongs = np.zeros((len(parts), len(squares)))
    belongs[range(len(parts)), np.concatenate([problem.pose_amplitudes, random.amplitudes])] = 1.0
    whole = 4.0 * (belongs.T @ parts @ belongs + _of_products(flat, np.tile(belongs[:f], (n, 1))))
    star = problem.hyper.at(amp.STAR)
    whole[star, star] += 4.0 * solution.freedom
    whole += 2.0 * problem.hyper.information
    return _with_readings(solution, spread, whole) if marginal.uses_readings else whole


def _of_products(rows: Array, belongs: Array) -> Array:
    """Return (A, A) the sums of the squares of the products of (N, S) rows that belong to (N, A) amplitudes, 0 or 1.

    By the products of the columns: |A B^T|^2 = tr (A^T A) (B^T B).
    """
    sums = np.zeros((belongs.shape[1], belongs.shape[1]))
    places = np.flatnonzero(belongs.any(axis=0))
    columns = [rows[belongs[:, at] > 0.0] for at in places]
    products = [column.T @ column for column in columns]
    sums[places[:, None], places] = [[np.vdot(product, other) for other in products] for product in products]
    return sums


def _with_readings(solution: Solution, spread: Array, whole: Array) -> Array:
    """Return the curvature with that by the readings' noise; ``spread`` (S, Q) is that of the columns, times R."""
    marginal, squares = solution.marginal, solution.squares
    problem, poses = marginal.problem, marginal.problem.bench.poses
    n_rows = 3 * len(poses)
    weights = marginal.reading_weights(squares)
    scaled = np.sqrt(marginal.reading_variance(squares)) * weights
    seen = (scaled[:, :, None] * solution.predicted).reshape(n_rows, -1) @ solution.root.T
    parts = np.diag((scaled**2 / weights).reshape(-1)) - seen @ seen.T
    own = scaled[:, :, None] * marginal.own_rows
    local = own @ solution.own[poses] @ np.swapaxes(own, 1, 2)
    for v in range(len(poses)):
        parts[3 * v : 3 * v + 3, 3 * v : 3 * v + 3] -= local[v]
    reading = problem.hyper.at(amp.READING)
    row = 4.0 * np.bincount(problem.random.amplitudes, ((seen @ spread) ** 2).sum(axis=0), len(squares))
    whole[reading] += row
    whole[:, reading] += row
    twice = (1.0 - 1.0 / marginal.repeats) * (scaled**2 / weights) ** 2  # readings of one pose count as one
    whole[reading, reading] += 4.0 * float((parts**2).sum() - twice.sum())
    return whole


def best_amplitudes(
    solution: Solution,
    steps: int = _MOST_STEPS,
    farthest: float = np.inf,
    enough: float = FINE,
    curvature: Array | None = None,
    until: Callable[[Solution], bool] | None = None,
) -> Solution:
    """Return the solution for the amplitudes of the largest posterior, from a start.

    Steps of Newton with the expected curvature, halved while the value does not fall; each changes a logarithm by at
    most ``farthest``, and promises at least ``enough``. The (A, A) curvature at the start may be known. The search ends
    where ``until`` is true.
    """
    bounds = np.array(solution.marginal.problem.hyper.bounds).T
    low, high = np.maximum(bounds[0], solution.eta - farthest), np.minimum(bounds[1], solution.eta + farthest)
    if curvature is None:
        curvature = expected_curvature(solution)
    for _ in range(steps):
        step = _newton(curvature, solution.gradient, solution.eta <= low, solution.eta >= high)
        if -float(solution.gradient @ step) < enough:
            break
        step *= min(1.0, _LONGEST / float(np.abs(step).max()))
        for _ in range(_HALVINGS):
            tried = _tried(solution, np.clip(solution.eta + step, low, high))
            if tried is not None and tried.value < solution.value:
                break
            step = 0.5 * step
        else:
            break
        assert tried is not None
        if float(np.abs(tried.eta - solution.eta).max()) > _CURVED:
            curvature = expected_curvature(tried)
        solution = tried
        if until is not None and until(solution):
            break
    return solution


def _tried(solution: Solution, eta: Array) -> Solution | None:
    """Return the solution for other amplitudes; None if the equations cannot be solved."""
    try:
        return solution.marginal.solve(eta, solution.faults)
    except np.linalg.LinAlgError:
        return None


def _newton(
    curvature: Array, gradient: Array, lowest: NDArray[np.bool_], highest: NDArray[np.bool_]
) -> Array:
    """Return the step to the minimum of a quadratic; what would leave its bounds stays."""
    held = (lowest & (gradient > 0)) | (highest & (gradient < 0))
    free = np.flatnonzero(~held)
    step = np.zeros(len(gradient))
    step[free] = -np.linalg.solve(curvature[free[:, None], free], gradient[free])
    return step
