"""The compiled Levenberg-Marquardt search over camera, collimator and poses.

The steps are those of `calib.adjustment.levenberg_marquardt`, which calls it, and the equations those of
`calib.adjustment.normal_equations`. This module is arithmetic only.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from calib.adjustment.equation_kernels import view_equations
from calib.adjustment.star_kernels import residuals_px, robust_cost, robust_curvature, whiten
from calib.compiled import INNER, INNER_WITH_ARRAYS, KERNEL

#: The search stops when the damping exceeds this.
MAX_DAMPING = 1e12
#: Focal length and radius lie along a curved valley, and a damped step follows its tangent only. Little damping needs
#: fewer steps, and more starts reach the bottom.
FIRST_DAMPING = 1e-6

_TINY = float(np.finfo(float).tiny)


@njit(**INNER)
def _pivot(matrix: Any, i: int) -> int:
    """Return the row from ``i`` on with the largest element in column ``i``."""
    best = i
    for j in range(i + 1, len(matrix)):
        if abs(matrix[j, i]) > abs(matrix[best, i]):
            best = j
    return best


@njit(**INNER)
def solve_in_place(matrix: Any, right: Any) -> bool:
    """Solve matrix x = right in place, by Gaussian elimination with partial pivoting (Golub and Van Loan, 2013).

    matrix: (L, L) float64; overwritten.
    right: (L, M) float64 right sides; overwritten by the solutions.
    Returns: False if a pivot is zero.
    """
    n, m = right.shape
    for i in range(n):
        best = _pivot(matrix, i)
        if not abs(matrix[best, i]) > 0.0:
            return False
        if best != i:
            for j in range(i, n):
                matrix[i, j], matrix[best, j] = matrix[best, j], matrix[i, j]
            for j in range(m):
                right[i, j], right[best, j] = right[best, j], right[i, j]
        for j in range(i + 1, n):
            factor = matrix[j, i] / matrix[i, i]
            for k in range(i + 1, n):
                matrix[j, k] -= factor * matrix[i, k]
            for k in range(m):
                right[j, k] -= factor * right[i, k]
    for i in range(n - 1, -1, -1):
        for k in range(m):
            total = right[i, k]
            for j in range(i + 1, n):
                total -= matrix[i, j] * right[j, k]
            right[i, k] = total / matrix[i, i]
    return True


@njit(**INNER)
def _turn(rotation: Any, vector: Any, out: Any) -> None:
    """Write exp([t]x) R for a rotation vector t (Rodrigues' formula; Diebel, 2006)."""
    x, y, z = vector[0], vector[1], vector[2]
    square = x * x + y * y + z * z
    angle = np.sqrt(square)
    if angle > 1e-4:
        a, b = np.sin(angle) / angle, 2.0 * (np.sin(0.5 * angle) / angle) ** 2
    else:
        a, b = 1.0 - square / 6.0, 0.5 - square / 24.0
    for j in range(3):
        u, v, w = rotation[0, j], rotation[1, j], rotation[2, j]
        along = x * u + y * v + z * w
        out[0, j] = u + a * (y * w - z * v) + b * (x * along - square * u)
        out[1, j] = v + a * (z * u - x * w) + b * (y * along - square * v)
        out[2, j] = w + a * (x * v - y * u) + b * (z * along - square * w)


@njit(**INNER)
def _eliminate(
    normal: Any, right: Any, damping: float, block: Any, solved: Any, information: Any, score: Any
) -> bool:
    """Eliminate the local parameters of a view, and add what is left to the equations of the shared ones.

    Schur complement (Triggs et al., 2000, section 6.1). ``solved`` (L, G + 1) becomes the damped local block's solution
    for the coupling and the local gradient; ``block`` (L, L) is overwritten. False if that block is singular.
    """
    count, own = len(score), len(solved)
    for a in range(own):
        for b in range(own):
            block[a, b] = normal[count + a, count + b]
        block[a, a] *= 1.0 + damping
        for g in range(count):
            solved[a, g] = normal[count + a, g]
        solved[a, count] = right[count + a]
    if not solve_in_place(block, solved):
        return False
    for g in range(count):
        score[g, 0] += right[g]
        for h in range(count):
            information[g, h] += normal[g, h]
        for a in range(own):
            score[g, 0] -= normal[g, count + a] * solved[a, count]
            for h in range(count):
                information[g, h] -= normal[g, count + a] * solved[a, h]
    return True


@njit(**INNER_WITH_ARRAYS)
def _step(normal: Any, right: Any, damping: float, shared: Any, local: Any) -> bool:
    """Compute the damped step of all parameters; False if the equations are singular.

    Marquardt (1963); Schur complement onto the shared parameters (Triggs et al., 2000, section 6.1; Brown, 1976),
    scaled to a unit diagonal (van der Sluis, 1969).
    """
    count, views = len(shared), len(local)
    information, score = np.zeros((count, count)), np.zeros((count, 1))
    solved = np.empty((views, local.shape[1], count + 1))
    block = np.empty((local.shape[1], local.shape[1]))
    for i in range(views):
        if not _eliminate(normal[i], right[i], damping, block, solved[i], information, score):
            return False
    for g in range(count):
        for i in range(views):
            information[g, g] += damping * normal[i, g, g]
    scale = np.empty(count)
    for g in range(count):
        scale[g] = 1.0 / np.sqrt(max(information[g, g], _TINY))
    for g in range(count):
        score[g, 0] *= scale[g]
        for h in range(count):
            information[g, h] *= scale[g] * scale[h]
    if not solve_in_place(information, score):
        return False
    for g in range(count):
        shared[g] = scale[g] * score[g, 0]
    for i in range(views):
        for a in range(local.shape[1]):
            local[i, a] = solved[i, a, count]
            for g in range(count):
                local[i, a] -= solved[i, a, g] * shared[g]
    return True


@njit(**INNER)
def _decrement(right: Any, shared: Any, local: Any) -> float:
    """Return gradient times step, which is twice the predicted reduction of the cost."""
    total, count = 0.0, len(shared)
    for i in range(len(local)):
        for g in range(count):
            total += right[i, g] * shared[g]
        for a in range(local.shape[1]):
            total += right[i, count + a] * local[i, a]
    return total


@njit(**INNER)
def _move(
    state: Any,
    rotations: Any,
    offsets: Any,
    places: Any,
    shared: Any,
    local: Any,
    new_state: Any,
    new_rotations: Any,
    new_offsets: Any,
) -> None:
    """Write the parameters after a step, as `AdjustmentParameters.after_step`."""
    for g in range(len(state)):
        new_state[g] = state[g]
    for g in range(len(places)):
        new_state[places[g]] += shared[g]
    for i in range(len(local)):
        _turn(rotations[i], local[i], new_rotations[i])
        for a in range(3, local.shape[1]):
            new_offsets[i, a - 3] = offsets[i, a - 3] + local[i, a]


@njit(**INNER)
def _keep(
    state: Any, rotations: Any, offsets: Any, new_state: Any, new_rotations: Any, new_offsets: Any
) -> None:
    """Copy parameters. Loops: numba compiles an assignment to a slice with a message about shapes, in seconds."""
    for g in range(len(state)):
        state[g] = new_state[g]
    for i in range(len(rotations)):
        for j in range(3):
            offsets[i, j] = new_offsets[i, j]
            for k in range(3):
                rotations[i, j, k] = new_rotations[i, j, k]


@njit(**KERNEL)
def search(
    target: Any,
    points: Any,
    factors: Any,
    bounds: Any,
    fisheye: bool,
    places: Any,
    state: Any,
    rotations: Any,
    offsets: Any,
    free_centres: bool,
    loss: int,
    limit: float,
    max_iterations: int,
    tolerances: Any,
) -> tuple[float, bool, int]:
    """Minimise the robust cost (Marquardt, 1963; damping by the rule of Nielsen, 1999), in place.

    target, points, bounds, fisheye: As for `calib.adjustment.star_kernels.residuals_px`.
    factors: (3, N) float64 elements 00, 10 and 11 of the whitening of each star, 1 / px.
    places: (G,) int64 places of the free shared parameters in the state.
    free_centres: Whether the centre of each view is free.
    loss, limit: As for `calib.adjustment.star_kernels.robust_cost`.
    tolerances: (3,) float64 relative and absolute tolerance of the predicted reduction, and how much rounding
      changes the root of twice the cost.
    Returns: Cost at the end, whether no further step promises a reduction, and the number of steps tried.
    """
    shared, views, stars = len(places), len(rotations), (bounds[:, 1] - bounds[:, 0]).sum()
    width = shared + (6 if free_centres else 3)
    normal, right = np.empty((views, width, width)), np.empty((views, width))
    residuals, gradient, curvature = np.empty((2, stars)), np.empty((2, stars)), np.empty((3, stars))
    step, local = np.empty(shared), np.empty((views, width - shared))
    new_state, new_rotations, new_offsets = state.copy(), rotations.copy(), offsets.copy()
    damping, growth, iteration = FIRST_DAMPING, 2.0, 0

    residuals_px(target, points, bounds, state, fisheye, rotations, offsets, residuals)
    whiten(residuals, factors, bounds)
    cost = robust_cost(residuals, 0, stars, loss, limit)
    if not np.isfinite(cost):
        return np.inf, False, 0
    fresh = True
    while iteration < max_iterations and damping < MAX_DAMPING:
        if fresh:
            robust_curvature(residuals, factors, bounds, loss, limit, gradient, curvature)
            view_equations(
                target, bounds, state, fisheye, rotations, offsets, places, gradient,
                curvature, normal, right,
            )  # fmt: skip
            fresh = False
        iteration += 1
        if not _step(normal, right, damping, step, local):
            damping, growth = damping * growth, growth * 2.0
            continue
        predicted = _decrement(right, step, local)
        if predicted * (1.0 + damping) <= tolerances[0] * cost + tolerances[1]:
            return cost, True, iteration
        _move(state, rotations, offsets, places, step, local, new_state, new_rotations, new_offsets)
        residuals_px(target, points, bounds, new_state, fisheye, new_rotations, new_offsets, residuals)
        whiten(residuals, factors, bounds)
        new_cost = robust_cost(residuals, 0, stars, loss, limit)
        gain = 2.0 * (cost - new_cost) / predicted
        if gain > 0.0:
            _keep(state, rotations, offsets, new_state, new_rotations, new_offsets)
            cost, fresh = new_cost, True
            damping, growth = damping * max(0.1, 1.0 - (2.0 * gain - 1.0) ** 3), 2.0
        elif predicted * (1.0 + damping) <= tolerances[2] * np.sqrt(2.0 * cost):
            return cost, True, iteration
        else:
            damping, growth = damping * growth, growth * 2.0
    return cost, False, iteration
