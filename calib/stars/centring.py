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

from calib.stars.local_map import LocalMap
from calib.stars.template import MIN_COVERED

#: Half the side of the square in which symmetry is measured, pitches: the star's own cell and no more, so that
#: neighbours share no pixels.
SYMMETRY_REACH = 0.49
#: Number of unknowns: centre x, y; relative slope x, y; absolute slope x, y.
SYMMETRY_UNKNOWNS = 6
_MAX_STEPS = 12
_SIXTH = 1.0 / 6.0


class SymmetryFit(NamedTuple):
    """Centres of N stars by symmetry.

    Attributes
    ----------
    centres
        (N, 2) float64, px.
    information
        (N, 2, 2) float64, (brightness / px)^2, J^T J of the centre after elimination of the slopes.
    mean_square
        (N,) float64, brightness^2, mean square of the residuals.
    light_slope
        (N,) float64, 1/pitch, length of g: relative slope of the light across the star.
    converged
        (N,) bool, whether the last step was shorter than a thousandth of a pixel.
    """

    centres: NDArray[np.float64]
    information: NDArray[np.float64]
    mean_square: NDArray[np.float64]
    light_slope: NDArray[np.float64]
    converged: NDArray[np.bool_]

    def select(self, mask: NDArray[np.bool_]) -> SymmetryFit:
        """Return the fits of some stars.

        Parameters
        ----------
        mask
            (N,) bool.

        Returns
        -------
        SymmetryFit
            In the same order.
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

    Parameters
    ----------
    image
        (H, W) float32.
    sigma_px
        Standard deviation of the Gaussian, px.

    Returns
    -------
    array
        (H, W) float32.
    """
    return np.ascontiguousarray(cv2.GaussianBlur(image, (0, 0), sigma_px), np.float32)


def symmetry_samples(pitch_px: float) -> NDArray[np.float64]:
    """Return the places at which symmetry is measured, about a pixel apart.

    Parameters
    ----------
    pitch_px
        Distance of neighbouring stars, px.

    Returns
    -------
    array
        (M, 2) float64, pitches, offsets s from the centre, one of each pair (s, -s).
    """
    side = int(np.clip(np.ceil(2 * SYMMETRY_REACH * pitch_px), 16, 64))
    steps = (np.arange(side) + 0.5) / side * 2.0 - 1.0
    u, v = np.meshgrid(steps * SYMMETRY_REACH, steps * SYMMETRY_REACH)
    upper = (v > 0) | ((v == 0) & (u > 0))
    return np.column_stack([u[upper], v[upper]])


@njit(cache=True, error_model="numpy")
def _spline_weights(a: float) -> tuple[float, float, float, float]:
    """Return the cubic B-spline at the four pixels around a point that lies ``a`` px beyond the second one.

    Cubic B-spline: Unser (1999).
    """
    b = 1.0 - a
    return (
        b * b * b * _SIXTH,
        (4.0 - 6.0 * a * a + 3.0 * a * a * a) * _SIXTH,
        (4.0 - 6.0 * b * b + 3.0 * b * b * b) * _SIXTH,
        a * a * a * _SIXTH,
    )


@njit(cache=True, error_model="numpy")
def _spline_slopes(a: float) -> tuple[float, float, float, float]:
    """Return the derivatives of `_spline_weights`, 1/px.

    Derivative of the cubic B-spline of Unser (1999).
    """
    b = 1.0 - a
    return (-0.5 * b * b, -2.0 * a + 1.5 * a * a, 2.0 * b - 1.5 * b * b, 0.5 * a * a)


@njit(cache=True, error_model="numpy", inline="always")
def _along_row(image: Any, r: Any, c: Any, weights: Any, slopes: Any) -> tuple[float, float]:
    """Return the spline along four pixels of a row, and its derivative.

    Cubic B-spline: Unser (1999).
    """
    p, q = image[r, c], image[r, c + np.uintp(1)]
    s, t = image[r, c + np.uintp(2)], image[r, c + np.uintp(3)]
    across = weights[0] * p + weights[1] * q + weights[2] * s + weights[3] * t
    slope = slopes[0] * p + slopes[1] * q + slopes[2] * s + slopes[3] * t
    return across, slope


@njit(cache=True, error_model="numpy")
def _smooth_sample(image: Any, x: float, y: float) -> tuple[float, float, float]:
    """Return the image, as a cubic B-spline of its pixels, and its derivatives along x and y; nan outside.

    The spline blurs a little more than bilinear interpolation, but it has no kinks at pixels. Bilinear values would
    pull edges that run along the pixel grid towards the grid. Cubic B-spline: Unser (1999), with the pixels as
    coefficients.
    """
    if not (1.0 <= x < image.shape[1] - 2 and 1.0 <= y < image.shape[0] - 2):
        return np.nan, np.nan, np.nan
    c, r = np.uintp(int(x) - 1), np.uintp(int(y) - 1)
    wx, sx = _spline_weights(x - int(x)), _spline_slopes(x - int(x))
    wy, sy = _spline_weights(y - int(y)), _spline_slopes(y - int(y))
    # Written out, row by row: half of the time of loops over the weights, with the same roundings.
    across_0, slope_0 = _along_row(image, r, c, wx, sx)
    across_1, slope_1 = _along_row(image, r + np.uintp(1), c, wx, sx)
    across_2, slope_2 = _along_row(image, r + np.uintp(2), c, wx, sx)
    across_3, slope_3 = _along_row(image, r + np.uintp(3), c, wx, sx)
    value = wy[0] * across_0 + wy[1] * across_1 + wy[2] * across_2 + wy[3] * across_3
    along_x = wy[0] * slope_0 + wy[1] * slope_1 + wy[2] * slope_2 + wy[3] * slope_3
    along_y = sy[0] * across_0 + sy[1] * across_1 + sy[2] * across_2 + sy[3] * across_3
    return value, along_x, along_y


@njit(cache=True, error_model="numpy")
def _normal_equations(
    image: Any,
    x: float,
    y: float,
    linear: Any,
    quadratic: Any,
    samples: Any,
    used_to: Any,
    slopes: Any,
    rows: Any,
    normal: Any,
    right: Any,
) -> float:
    """Compute J^T J and J^T r of the symmetry residuals in place; return the mean of r^2, nan if too few are inside.

    The unknowns are the centre (x, y), px, and ``slopes``: the relative slope g, 1/pitch, and the absolute slope b,
    brightness/pitch. ``used_to`` is how far from the centre the cell is used along the columns and along the rows,
    pitches. ``rows`` (7, M) takes the derivatives and the residuals. Residuals: Schöps et al. (2020), with this
    project's own slopes and curvature; the head of the module gives the equations.
    """
    n = asked = 0
    for i in range(len(samples)):
        u, v = samples[i, 0], samples[i, 1]
        if abs(u) > used_to[0] or abs(v) > used_to[1]:
            continue
        asked += 1
        uu, uv, vv = u * u, u * v, v * v
        ax, ay = linear[0, 0] * u + linear[0, 1] * v, linear[1, 0] * u + linear[1, 1] * v
        mx = x + quadratic[0, 0] * uu + quadratic[0, 1] * uv + quadratic[0, 2] * vv
        my = y + quadratic[1, 0] * uu + quadratic[1, 1] * uv + quadratic[1, 2] * vv
        there, there_x, there_y = _smooth_sample(image, mx + ax, my + ay)
        here, here_x, here_y = _smooth_sample(image, mx - ax, my - ay)
        if np.isnan(there) or np.isnan(here):
            continue
        both = there + here
        gx, gy = -u * both, -v * both
        rows[0, n], rows[1, n], rows[2, n], rows[3, n] = there_x - here_x, there_y - here_y, gx, gy
        rows[4, n], rows[5, n] = -u, -v
        rows[6, n] = there - here + slopes[0] * gx + slopes[1] * gy - slopes[2] * u - slopes[3] * v
        n += 1
    squares = _sum_products(rows, n, normal, right)
    return squares / n if asked > 0 and n >= MIN_COVERED * asked else np.nan


@njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract", "nsz"})
def _sum_products(rows: Any, n: int, normal: Any, right: Any) -> float:
    """Compute J^T J and J^T r from the first ``n`` columns of ``rows``, J^T above r; return the sum of r^2."""
    r = rows[SYMMETRY_UNKNOWNS]
    for k in range(SYMMETRY_UNKNOWNS):
        j, total = rows[k], 0.0
        for i in range(n):
            total += j[i] * r[i]
        right[k] = total
        for m in range(k + 1):
            other, total = rows[m], 0.0
            for i in range(n):
                total += j[i] * other[i]
            normal[k, m] = normal[m, k] = total
    total = 0.0
    for i in range(n):
        total += r[i] * r[i]
    return total


@njit(cache=True, error_model="numpy")
def _solvable(normal: Any) -> bool:
    """Return whether the image determines every unknown; a flat image does not.

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
    return _clearly_regular(scaled) or bool(np.linalg.cond(scaled) < 1e12)


@njit(cache=True, error_model="numpy")
def _clearly_regular(scaled: Any) -> bool:
    """Return whether the condition of a symmetric matrix with unit diagonal is below 1e10 for sure.

    It takes a twentieth of the time of the condition itself. With the determinant d, from the Cholesky factor (Golub
    and Van Loan, 2013), and the trace n, the smallest eigenvalue is at least d ((n - 1) / n)^(n - 1), because the mean
    of the other ones is at most n / (n - 1); the largest is at most n.
    """
    n = len(scaled)
    factor = np.zeros((SYMMETRY_UNKNOWNS, SYMMETRY_UNKNOWNS))
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


@njit(cache=True, error_model="numpy")
def refine_by_symmetry(
    image: Any, guesses: Any, local_map: LocalMap, samples: Any, used_to: Any, reach_px: float
) -> SymmetryFit:
    """Find the centre of each star by symmetry, with Gauss-Newton steps.

    The cost is that of Schöps et al. (2020), arXiv:1912.02908, with this project's own additions; the head of the
    module gives the equations.

    Parameters
    ----------
    image
        (H, W) float32, from `smooth`.
    guesses
        (N, 2) float64, px.
    local_map
        Map around each star, from the target plane to the image.
    samples
        (M, 2) float64, pitches, from `symmetry_samples`.
    used_to
        (N, 2) float64, pitches, how far from its centre each star's cell is used, along the columns and along the rows.
    reach_px
        A centre that moves further than this from its guess is given up, px.

    Returns
    -------
    SymmetryFit
        Centres that were given up, or whose cell lies too far outside of the image, are nan and not converged.
    """
    n = len(guesses)
    centres, information = np.full((n, 2), np.nan), np.full((n, 2, 2), np.nan)
    mean_square, light_slope, converged = np.full(n, np.nan), np.full(n, np.nan), np.zeros(n, np.bool_)
    normal, right = np.empty((SYMMETRY_UNKNOWNS, SYMMETRY_UNKNOWNS)), np.empty(SYMMETRY_UNKNOWNS)
    rows = np.empty((SYMMETRY_UNKNOWNS + 1, len(samples)))
    for k in range(n):
        x, y = guesses[k, 0], guesses[k, 1]
        slopes = np.zeros(SYMMETRY_UNKNOWNS - 2)
        for _ in range(_MAX_STEPS):
            squares = _normal_equations(
                image,
                x,
                y,
                local_map.linear[k],
                local_map.quadratic[k],
                samples,
                used_to[k],
                slopes,
                rows,
                normal,
                right,
            )
            if np.isnan(squares) or not _solvable(normal):
                break
            step = np.linalg.solve(normal, right)
            length = np.hypot(step[0], step[1])
            shorter = min(1.0, 1.5 / length) if length > 0.0 else 1.0
            x, y = x - shorter * step[0], y - shorter * step[1]
            slopes -= shorter * step[2:]
            if np.hypot(x - guesses[k, 0], y - guesses[k, 1]) > reach_px:
                break
            if length < 1e-3:
                converged[k] = True
                centres[k, 0], centres[k, 1] = x, y
                mean_square[k], light_slope[k] = squares, np.hypot(slopes[0], slopes[1])
                information[k] = np.linalg.inv(np.linalg.inv(normal)[:2, :2])
                break
    return SymmetryFit(centres, information, mean_square, light_slope, converged)
