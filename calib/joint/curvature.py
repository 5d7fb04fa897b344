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
from calib.joint.marginal import Marginal, Solution
from calib.joint.prior import NO_FAULT, Faults

#: No step of the search changes a logarithm by more than this.
_LONGEST = 1.5
_HALVINGS = 5
#: A search ends where a step promises less than this of -2 log: 0.01 is a tenth of a sigma.
ROUGH, FINE = 0.02, 1e-3
#: Products of columns are faster from so many times more rows on.
_MANY = 2
#: The curvature is found again after a step that changes a logarithm by more than this.
_CURVED = 0.3


def expected_curvature(marginal: Marginal, eta: Array, found: Solution) -> Array:
    """Return (A, A) the expected second derivatives of the value by the logarithms of the amplitudes."""
    problem, squares = marginal.problem, np.exp(2.0 * eta)
    n, f, size = marginal.dimensions
    random = problem.random
    at = random.places
    scale = np.sqrt(marginal.problem.own_information(squares))
    fields = scale[:, None] * found.followed
    alone = np.eye(f) - scale[:, None] * found.own * scale
    pulled = random.pulled(squares, found.inside)
    spread = random.times_pulled(found.root.T[at].T, pulled)
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
    belongs = np.zeros((len(parts), len(eta)))
    belongs[range(len(parts)), np.concatenate([problem.pose_amplitudes, random.amplitudes])] = 1.0
    whole = 4.0 * (belongs.T @ parts @ belongs + _of_products(flat, np.tile(belongs[:f], (n, 1))))
    star = problem.hyper.at(amp.STAR)
    whole[star, star] += 4.0 * marginal.freedom(squares, found)
    whole += 2.0 * problem.hyper.information
    return _with_readings(marginal, squares, found, spread, whole) if marginal.uses_readings else whole


def _of_products(rows: Array, belongs: Array) -> Array:
    """Return (A, A) the sums of the squares of the products of (N, S) rows that belong to (N, A) amplitudes, 0 or 1.

    By the products of the columns if there are many rows: |A B^T|^2 = tr (A^T A) (B^T B).
    """
    if len(rows) < _MANY * rows.shape[1]:
        return np.asarray(belongs.T @ (rows @ rows.T) ** 2 @ belongs)
    found = np.zeros((belongs.shape[1], belongs.shape[1]))
    places = np.flatnonzero(belongs.any(axis=0))
    columns = [rows[belongs[:, at] > 0.0] for at in places]
    products = [one.T @ one for one in columns]
    found[places[:, None], places] = [[np.vdot(one, other) for other in products] for one in products]
    return found


def _with_readings(marginal: Marginal, squares: Array, found: Solution, spread: Array, whole: Array) -> Array:
    """Return the curvature with that by the readings' noise; ``spread`` (S, Q) is that of the columns, times R."""
    problem, poses = marginal.problem, marginal.problem.bench.poses
    n_rows = 3 * len(poses)
    weights = marginal.reading_weights(squares)
    scaled = np.sqrt(marginal.reading_variance(squares)) * weights
    direct = marginal.rows - marginal.own_rows @ found.follow[poses]
    seen = (scaled[:, :, None] * direct).reshape(n_rows, -1) @ found.root.T
    parts = np.diag((scaled**2 / weights).reshape(-1)) - seen @ seen.T
    own = scaled[:, :, None] * marginal.own_rows
    local = own @ found.own[poses] @ np.swapaxes(own, 1, 2)
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
    marginal: Marginal,
    eta: Array,
    steps: int,
    faults: Faults = NO_FAULT,
    farthest: float = np.inf,
    enough: float = FINE,
    found: Solution | None = None,
    curvature: Array | None = None,
    until: Callable[[Array], bool] | None = None,
) -> tuple[Array, Solution]:
    """Return the logarithms of the amplitudes of the largest posterior, from a start, and their solution.

    Steps of Newton with the expected curvature, halved while the value does not fall; each changes a logarithm by at
    most ``farthest``, and promises at least ``enough``. The equations must be solvable at the start, whose solution
    and (A, A) curvature may be known. The search ends where ``until`` is true.
    """
    bounds = np.array(marginal.problem.hyper.bounds).T
    low, high = np.maximum(bounds[0], eta - farthest), np.minimum(bounds[1], eta + farthest)
    if found is None:
        found = marginal.solve(eta, faults)
    if curvature is None:
        curvature = expected_curvature(marginal, eta, found)
    for _ in range(steps):
        step = _newton(curvature, found.gradient, eta <= low, eta >= high)
        if -float(found.gradient @ step) < enough:
            break
        step *= min(1.0, _LONGEST / float(np.abs(step).max()))
        for _ in range(_HALVINGS):
            ahead = np.clip(eta + step, low, high)
            tried = _tried(marginal, ahead, faults)
            if tried is not None and tried.value < found.value:
                break
            step = 0.5 * step
        else:
            break
        assert tried is not None
        if float(np.abs(ahead - eta).max()) > _CURVED:
            curvature = expected_curvature(marginal, ahead, tried)
        eta, found = ahead, tried
        if until is not None and until(eta):
            break
    return eta, found


def _tried(marginal: Marginal, eta: Array, faults: Faults) -> Solution | None:
    """Return the solution; None if the equations cannot be solved."""
    try:
        return marginal.solve(eta, faults)
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
