"""Centre of a star by point symmetry: half a turn about the centre leaves the printed star unchanged.

The module uses the neighbourhood of a single star. It does not use other stars or ids.

Let q(s) = c + A s + B(s, s) be the local map from the target plane to the image, with s in pitches from the star and
q in px. The centre c minimises

    sum over s of (I(q(s)) - I(q(-s)))^2 .

This is the symmetry cost of Schöps et al. (2020), arXiv:1912.02908, with two additions. Light that falls off across
the star, as at the rim of the disc, is not symmetric. So a relative slope g and an absolute slope b are fitted
together with c:

    I(q(s)) - I(q(-s)) = g.s (I(q(s)) + I(q(-s))) + b.s .

And the curvature B of perspective and distortion, which moves the middle of each pair, is taken from the neighbours.
An error of A moves the two points of a pair in opposite directions and leaves their middle in place.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from calib.compiled import INNER, INNER_WITH_ARRAYS, KERNEL
from calib.stars.local_map import LocalMap
from calib.stars.symmetry_kernels import SYMMETRY_UNKNOWNS, normal_equations

#: Half the side of the square in which symmetry is measured, pitches: the star's own cell and no more, so that
#: neighbours share no pixels.
SYMMETRY_REACH = 0.49
#: A step that is shorter is the last one, px. Each step is about a hundredth of the one before.
LAST_STEP_PX = 1e-3
_MAX_STEPS = 12
_MAX_SWEEPS = 30


class SymmetryFit(NamedTuple):
    """Centres of N stars by symmetry."""

    centres: NDArray[np.float64]  # (N, 2) float64, px
    # (N, 2, 2) float64, (brightness / px)^2, J^T J of the centre after elimination of the slopes.
    information: NDArray[np.float64]
    mean_square: NDArray[np.float64]  # (N,) float64, brightness^2, mean square of the residuals
    # (N,) float64, 1/pitch, length of g: relative slope of the light across the star.
    light_slope: NDArray[np.float64]
    converged: NDArray[np.bool_]  # (N,) bool, whether the last step was shorter than `LAST_STEP_PX`

    def select(self, mask: NDArray[np.bool_]) -> SymmetryFit:
        """Return the fits of some stars.

        mask: (N,) bool.
        Returns: In the same order.
        """
        return SymmetryFit(
            self.centres[mask],
            self.information[mask],
            self.mean_square[mask],
            self.light_slope[mask],
            self.converged[mask],
        )


def smooth(image: NDArray[np.float32], sigma_px: float) -> NDArray[np.float32]:
    """Blur an image by a Gaussian. It reduces the noise of single pixels and the effect of the pixel grid.

    image: (H, W) float32.
    sigma_px: Standard deviation of the Gaussian, px.
    Returns: (H, W) float32.
    """
    return np.ascontiguousarray(cv2.GaussianBlur(image, (0, 0), sigma_px), np.float32)


def symmetry_samples(pitch_px: float) -> NDArray[np.float64]:
    """Return the places at which symmetry is measured, about a pixel apart.

    pitch_px: Distance of neighbouring stars, px.
    Returns: (M, 2) float64, pitches, offsets s from the centre, one of each pair (s, -s).
    """
    side = int(np.clip(np.ceil(2 * SYMMETRY_REACH * pitch_px), 16, 64))
    steps = (np.arange(side) + 0.5) / side * 2.0 - 1.0
    u, v = np.meshgrid(steps * SYMMETRY_REACH, steps * SYMMETRY_REACH)
    upper = (v > 0) | ((v == 0) & (u > 0))
    return np.column_stack([u[upper], v[upper]])


@njit(**INNER_WITH_ARRAYS)
def _find_step(normal: Any, right: Any, factor: Any, step: Any) -> bool:
    """Solve the normal equations in place; return whether the image determines every unknown; a flat one does not.

    The matrix is scaled to a unit diagonal first, because the unit of some unknowns is the grey value. The scaling is
    that of van der Sluis (1969).
    """
    scale, scaled = np.empty(SYMMETRY_UNKNOWNS), np.empty((SYMMETRY_UNKNOWNS, SYMMETRY_UNKNOWNS))
    for k in range(SYMMETRY_UNKNOWNS):
        if not normal[k, k] > 0.0:
            return False
        scale[k] = np.sqrt(normal[k, k])
    for k in range(SYMMETRY_UNKNOWNS):
        for m in range(SYMMETRY_UNKNOWNS):
            scaled[k, m] = normal[k, m] / scale[k] / scale[m]
    for k in range(SYMMETRY_UNKNOWNS):
        right[k] /= scale[k]
    if _clearly_regular(scaled, factor):
        _substitute(factor, right, step)
    elif not _solve_by_eigenvalues(scaled, right, step):
        return False
    for k in range(SYMMETRY_UNKNOWNS):
        step[k] /= scale[k]
    return True


@njit(**INNER)
def _substitute(factor: Any, right: Any, step: Any) -> None:
    """Solve a system by its Cholesky factor: forward, then back substitution (Golub and Van Loan, 2013)."""
    for k in range(SYMMETRY_UNKNOWNS):
        step[k] = right[k]
        for m in range(k):
            step[k] -= factor[k, m] * step[m]
        step[k] /= factor[k, k]
    for k in range(SYMMETRY_UNKNOWNS - 1, -1, -1):
        for m in range(k + 1, SYMMETRY_UNKNOWNS):
            step[k] -= factor[m, k] * step[m]
        step[k] /= factor[k, k]


@njit(**INNER)
def _clearly_regular(scaled: Any, factor: Any) -> bool:
    """Return whether the condition of a symmetric matrix with unit diagonal is below 1e10 for sure.

    Its Cholesky factor (Golub and Van Loan, 2013) is computed in place. It takes a twentieth of the time of the
    condition itself. With the determinant d, from the factor, and the trace n, the smallest eigenvalue is at least d
    ((n - 1) / n)^(n - 1), because the mean of the other ones is at most n / (n - 1); the largest is at most n.
    """
    n = len(scaled)
    determinant = 1.0
    for k in range(n):
        for m in range(k + 1):
            rest = scaled[k, m]
            for i in range(m):
                rest -= factor[k, i] * factor[m, i]
            if m < k:
                factor[k, m] = rest / factor[m, m]
            elif not rest > 0.0:
                return False
            else:
                factor[k, k] = np.sqrt(rest)
                determinant *= rest
    smallest = determinant * ((n - 1.0) / n) ** (n - 1)
    return bool(smallest > n * 1e-10)


@njit(**INNER_WITH_ARRAYS)
def _solve_by_eigenvalues(matrix: Any, right: Any, solution: Any) -> bool:
    """Solve a symmetric system by Jacobi's rotations (Golub and Van Loan, 2013); the matrix is overwritten.

    Rare systems come here. LAPACK in a compiled loop would take ten seconds of every first compilation.

    Returns: False if the condition is not below 1e12.
    """
    n = len(matrix)
    vectors = np.zeros((n, n))
    for k in range(n):
        vectors[k, k] = 1.0
    for _ in range(_MAX_SWEEPS):
        most = 0.0
        for p in range(n):
            for q in range(p + 1, n):
                most = max(most, abs(matrix[p, q]))
                _rotate(matrix, vectors, p, q)
        if most < 1e-17:
            break
    smallest, largest = np.inf, 0.0
    for k in range(n):
        smallest, largest = min(smallest, abs(matrix[k, k])), max(largest, abs(matrix[k, k]))
        solution[k] = 0.0
    if not smallest * 1e12 > largest > 0.0:
        return False
    for i in range(n):
        along = 0.0
        for k in range(n):
            along += vectors[k, i] * right[k]
        for k in range(n):
            solution[k] += vectors[k, i] * along / matrix[i, i]
    return True


@njit(**INNER)
def _rotate(matrix: Any, vectors: Any, p: int, q: int) -> None:
    """Make element (p, q) of a symmetric matrix zero by a rotation, which the columns of ``vectors`` follow."""
    if matrix[p, q] == 0.0:
        return
    theta = 0.5 * (matrix[q, q] - matrix[p, p]) / matrix[p, q]
    tangent = (1.0 if theta >= 0.0 else -1.0) / (abs(theta) + np.sqrt(theta * theta + 1.0))
    cosine = 1.0 / np.sqrt(tangent * tangent + 1.0)
    sine = tangent * cosine
    for k in range(len(matrix)):
        one, other = matrix[k, p], matrix[k, q]
        matrix[k, p], matrix[k, q] = cosine * one - sine * other, sine * one + cosine * other
        one, other = vectors[k, p], vectors[k, q]
        vectors[k, p], vectors[k, q] = cosine * one - sine * other, sine * one + cosine * other
    for k in range(len(matrix)):
        one, other = matrix[p, k], matrix[q, k]
        matrix[p, k], matrix[q, k] = cosine * one - sine * other, sine * one + cosine * other


@njit(**INNER_WITH_ARRAYS)
def _store_information(normal: Any, information: Any) -> None:
    """Store the (2, 2) information of the centre after elimination of the slopes, the last unknown first (Gauss)."""
    left = np.empty((SYMMETRY_UNKNOWNS, SYMMETRY_UNKNOWNS))
    for q in range(SYMMETRY_UNKNOWNS):
        for m in range(SYMMETRY_UNKNOWNS):
            left[q, m] = normal[q, m]
    for p in range(SYMMETRY_UNKNOWNS - 1, 1, -1):
        for q in range(p):
            share = left[q, p] / left[p, p]
            for m in range(p):
                left[q, m] -= share * left[p, m]
    for q in range(2):
        for m in range(2):
            information[q, m] = left[q, m]


@njit(**INNER_WITH_ARRAYS)
def _used_samples(samples: Any, used_to: Any) -> Any:
    """Return the samples, (2, M) float32, that lie in the used part of a star's cell."""
    return samples[:, (np.abs(samples[0]) <= used_to[0]) & (np.abs(samples[1]) <= used_to[1])]


@njit(**KERNEL)
def refine_by_symmetry(
    image: Any,
    guesses: Any,
    local_map: LocalMap,
    samples: Any,
    used_to: Any,
    reach_px: float,
) -> SymmetryFit:
    """Find the centre of each star by symmetry, with Gauss-Newton steps.

    The cost is that of Schöps et al. (2020), arXiv:1912.02908, with this project's own additions; the head of the
    module gives the equations.

    image: (H, W) float32, from `smooth`.
    guesses: (N, 2) float64, px.
    samples: (M, 2) float64, pitches, from `symmetry_samples`.
    used_to: (N, 2) float64, pitches, how far from its centre each star's cell is used, along the columns and
      along the rows.
    reach_px: A centre that moves further than this from its guess is given up, px.
    Returns: Centres that were given up, or whose cell lies too far outside of the image, are nan and not
      converged.
    """
    n = len(guesses)
    centres, information = np.full((n, 2), np.nan), np.full((n, 2, 2), np.nan)
    mean_square, light_slope, converged = np.full(n, np.nan), np.full(n, np.nan), np.zeros(n, np.bool_)
    normal, factor = np.empty((2, SYMMETRY_UNKNOWNS, SYMMETRY_UNKNOWNS))
    right, step = np.empty((2, SYMMETRY_UNKNOWNS))
    every = np.ascontiguousarray(samples.T).astype(np.float32)
    reach = np.float32(0.0)
    for i in range(len(samples)):
        reach = max(reach, abs(every[0, i]), abs(every[1, i]))
    space = np.empty((2, len(samples)), np.float32)
    pixels, width = image.ravel(), image.shape[1]
    for k in range(n):
        x, y = guesses[k, 0], guesses[k, 1]
        slopes, centre = np.zeros(SYMMETRY_UNKNOWNS - 2), np.empty(2)
        places = every if min(used_to[k, 0], used_to[k, 1]) >= reach else _used_samples(every, used_to[k])
        for _ in range(_MAX_STEPS):
            centre[0], centre[1] = x, y
            squares = normal_equations(
                pixels,
                width,
                centre,
                local_map.linear[k],
                local_map.quadratic[k],
                places,
                slopes,
                space,
                normal,
                right,
            )
            if np.isnan(squares) or not _find_step(normal, right, factor, step):
                break
            length = np.hypot(step[0], step[1])
            shorter = min(1.0, 1.5 / length) if length > 0.0 else 1.0
            x, y = x - shorter * step[0], y - shorter * step[1]
            slopes -= shorter * step[2:]
            if np.hypot(x - guesses[k, 0], y - guesses[k, 1]) > reach_px:
                break
            if length < LAST_STEP_PX:
                converged[k] = True
                centres[k, 0], centres[k, 1] = x, y
                mean_square[k], light_slope[k] = squares, np.hypot(slopes[0], slopes[1])
                _store_information(normal, information[k])
                break
    return SymmetryFit(centres, information, mean_square, light_slope, converged)
