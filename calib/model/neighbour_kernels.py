"""Compiled loops over the neighbours of the stars of one view.

One loop does what a chain of small array operations would do for each star. This module is arithmetic only;
`calib.model.local_consistency` says what the numbers mean.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from calib.compiled import INNER, KERNEL

#: Smallest numbers on the diagonals of the local fits: of the constant, and of all other terms (Hoerl and Kennard,
#: 1970). They matter for neighbours on one line only.
RIDGE_CONSTANT, RIDGE_OTHERS = 1e-9, 1e-3
#: Terms of a local affine map, and of a local quadratic one.
AFFINE, QUADRATIC = 3, 6


@njit(**INNER)
def _insert(which: Any, squares: Any, found: int, star: int, square: float) -> None:
    """Insert a star into the ``found`` nearest so far, nearest first; the lower index first if equally near."""
    at = min(found, len(which) - 1)
    while at > 0 and (square < squares[at - 1] or (square == squares[at - 1] and star < which[at - 1])):
        which[at], squares[at] = which[at - 1], squares[at - 1]
        at -= 1
    which[at], squares[at] = star, square


@njit(**KERNEL)
def nearest(points: Any, order: Any, which: Any, distance: Any) -> None:
    """Find the nearest other points of each point: a sweep along x, until no nearer point can follow (own).

    points: (N, 2) float64 points.
    order: (N,) int64 indices of the points in the order of x.
    which: (N, K) int64 result: the nearest points, nearest first; K < N.
    distance: (N, K) float64 result: their distances.
    """
    count, last = len(points), which.shape[1] - 1
    squares = np.empty(last + 1)
    for place in range(count):
        i = order[place]
        squares[:] = np.inf
        found, below, above = int(np.int64(0)), place - 1, place + 1
        while below >= 0 or above < count:
            left = points[i, 0] - points[order[below], 0] if below >= 0 else np.inf
            right = points[order[above], 0] - points[i, 0] if above < count else np.inf
            along = min(left, right)
            if along * along > squares[last]:
                break
            j = order[below] if left <= right else order[above]
            below, above = (below - 1, above) if left <= right else (below, above + 1)
            across = points[j, 1] - points[i, 1]
            square = along * along + across * across
            if square < squares[last] or (square == squares[last] and j < which[i, last]):
                _insert(which[i], squares, found, j, square)
                found += 1
        for k in range(last + 1):
            distance[i, k] = np.sqrt(squares[k])


@njit(**KERNEL)
def one_sidedness(points: Any, which: Any, spacing: float, out: Any) -> None:
    """Compute the distance of the neighbours' mean from each point: 0 inside of a set of points, about 1 at its rim.

    points: (N, 2) float64 points.
    which: (N, K) int64 neighbours of each.
    out: (N,) float64 result, in spacings.
    """
    count = which.shape[1]
    for i in range(len(points)):
        x, y = 0.0, 0.0
        for k in range(count):
            x += points[which[i, k], 0] - points[i, 0]
            y += points[which[i, k], 1] - points[i, 1]
        out[i] = np.sqrt(x * x + y * y) / (count * spacing)


@njit(**INNER)
def _terms(x: float, y: float, row: Any) -> None:
    """Write the terms of a local map at (x, y): 1, x, y, and x^2, x y, y^2 if there is room."""
    row[0], row[1], row[2] = 1.0, x, y
    if len(row) > AFFINE:
        row[3], row[4], row[5] = x * x, x * y, y * y


@njit(**INNER)
def _solve(matrix: Any, right: Any) -> None:
    """Solve matrix x = right in place for a positive definite matrix, by Cholesky (Golub and Van Loan, 2013)."""
    n = len(right)
    for i in range(n):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = np.sqrt(total) if i == j else total / matrix[j, j]
    for i in range(n):
        for k in range(i):
            right[i] -= matrix[i, k] * right[k]
        right[i] /= matrix[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            right[i] -= matrix[k, i] * right[k]
        right[i] /= matrix[i, i]


@njit(**KERNEL)
def plain_deviations(points: Any, which: Any, spacing: float, off: Any, terms: int, out: Any) -> None:
    """Compute the distances between values at points and least squares predictions of their neighbours.

    A local map of the neighbours' values predicts the value of a point. The prediction is w^T X^T v with the rows X of
    the terms and M w = (1 0 0 ...)^T, where M = X^T X and a small ridge; its variance is w_0.

    points: (N, 2) float64 points.
    which: (N, K) int64 neighbours of each.
    off: (N, 2) float64 values.
    terms: `AFFINE` or `QUADRATIC`.
    out: (N,) float64 result: distances, in units of equal variance.
    """
    rows, matrix = np.empty((which.shape[1], terms)), np.empty((terms, terms))
    answer = np.empty(terms)
    for i in range(len(points)):
        matrix[:] = 0.0
        answer[:] = 0.0
        answer[0] = 1.0
        for k in range(which.shape[1]):
            j = which[i, k]
            _terms((points[j, 0] - points[i, 0]) / spacing, (points[j, 1] - points[i, 1]) / spacing, rows[k])
            for a in range(terms):
                for b in range(a + 1):
                    matrix[a, b] += rows[k, a] * rows[k, b]
        for a in range(terms):
            matrix[a, a] += RIDGE_OTHERS if a else RIDGE_CONSTANT
        _solve(matrix, answer)
        x, y = off[i, 0], off[i, 1]
        for k in range(which.shape[1]):
            share = 0.0
            for a in range(terms):
                share += answer[a] * rows[k, a]
            x -= share * off[which[i, k], 0]
            y -= share * off[which[i, k], 1]
        out[i] = np.sqrt((x * x + y * y) / (1.0 + max(answer[0], 0.0)))


@njit(**INNER)
def _root(parents: Any, i: int) -> int:
    """Return the first member of a set, and shorten the way to it (Tarjan, 1975)."""
    while parents[i] != i:
        parents[i] = parents[parents[i]]
        i = parents[i]
    return i


@njit(**KERNEL)
def outside_the_largest_patch(
    mapped: Any, off: Any, which: Any, distance: Any, parents: Any, reach: float, share: float, ordered: float
) -> Any:
    """Return which stars belong to a patch beside the largest one that does not agree with it.

    Patches are the connected components of the graph of agreeing neighbours, found by union of sets (Tarjan, 1975). If
    hardly any neighbours agree, as with random ids, all stars that contradict most of their neighbours are returned
    instead. Own rule.

    mapped, off: (N, 2) float64 mapped positions, and what the stars are off them, px.
    which, distance: (N, K) int64 neighbours of each star, nearest first, and (N, K) float64 their distances.
    parents: (N,) int64, 0 to N - 1; overwritten.
    share: Neighbours agree if what they are off differs by no more than this share of their mapped distance.
    """
    count = len(which)
    pairs, agreeing = np.zeros(count, np.int64), np.zeros(count, np.int64)
    all_pairs = all_agreeing = 0
    for i in range(count):
        for k in range(which.shape[1]):
            if distance[i, k] > reach:
                break
            j = which[i, k]
            pairs[i] += 1
            all_pairs += 1
            apart = np.hypot(mapped[i, 0] - mapped[j, 0], mapped[i, 1] - mapped[j, 1])
            if np.hypot(off[i, 0] - off[j, 0], off[i, 1] - off[j, 1]) <= share * apart:
                agreeing[i] += 1
                all_agreeing += 1
                a, b = _root(parents, i), _root(parents, j)
                parents[max(a, b)] = min(a, b)
    beside = np.zeros(count, np.bool_)
    if all_agreeing < ordered * all_pairs:
        for i in range(count):
            beside[i] = 2 * agreeing[i] < pairs[i]
        return beside
    sizes = np.zeros(count, np.int64)
    for i in range(count):
        parents[i] = _root(parents, i)
        sizes[parents[i]] += 1
    largest, touched = np.argmax(sizes), np.zeros(count, np.bool_)
    for i in range(count):
        for k in range(which.shape[1]):
            if distance[i, k] > reach:
                break
            a, b = parents[i], parents[which[i, k]]
            if (a == largest) != (b == largest):
                touched[b if a == largest else a] = True
    for i in range(count):
        beside[i] = touched[parents[i]]
    return beside
