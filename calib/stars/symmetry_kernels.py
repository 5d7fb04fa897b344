"""Compiled loops of the symmetry of a star: the image as a spline, and the normal equations of a star's unknowns.

`calib.stars.centring` says what the numbers mean. There are two ways to the same sums. If all of a star's samples lie
in the image, one loop without a branch and without a store adds up everything, so that it runs over several samples at
once. Otherwise each sample is tested, and the rows of the equations are stored before they are multiplied.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

#: Number of unknowns: centre x, y; relative slope x, y; absolute slope x, y.
SYMMETRY_UNKNOWNS = 6
#: Least share of a cell's samples that must lie in the image.
MIN_COVERED = 0.8
#: Sums may be reordered, so that they run in parallel. Only for loops that meet no nan.
_IN_PARALLEL = {"reassoc", "contract", "nsz", "nnan", "ninf", "arcp"}
_SIXTH = 1.0 / 6.0


@njit(cache=True, error_model="numpy", fastmath=_IN_PARALLEL, inline="always")
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


@njit(cache=True, error_model="numpy", fastmath=_IN_PARALLEL, inline="always")
def _spline_slopes(a: float) -> tuple[float, float, float, float]:
    """Return the derivatives of `_spline_weights`, 1/px.

    Derivative of the cubic B-spline of Unser (1999).
    """
    b = 1.0 - a
    return (-0.5 * b * b, -2.0 * a + 1.5 * a * a, 2.0 * b - 1.5 * b * b, 0.5 * a * a)


@njit(cache=True, error_model="numpy", fastmath=_IN_PARALLEL, inline="always")
def _along_row(pixels: Any, at: Any, weights: Any, slopes: Any) -> tuple[float, float]:
    """Return the spline along four pixels of a row, from number ``at`` on, and its derivative.

    Cubic B-spline: Unser (1999).
    """
    p, q = pixels[at], pixels[at + np.uint64(1)]
    s, t = pixels[at + np.uint64(2)], pixels[at + np.uint64(3)]
    across = weights[0] * p + weights[1] * q + weights[2] * s + weights[3] * t
    slope = slopes[0] * p + slopes[1] * q + slopes[2] * s + slopes[3] * t
    return across, slope


@njit(cache=True, error_model="numpy", fastmath=_IN_PARALLEL, inline="always")
def _spline(pixels: Any, width: int, x: float, y: float) -> tuple[float, float, float]:
    """Return an image, as a cubic B-spline of its pixels, and its derivatives along x and y.

    ``pixels`` are its rows, one after the other. The point must be more than a pixel inside of the image.

    The spline blurs a little more than bilinear interpolation, but it has no kinks at pixels. Bilinear values would
    pull edges that run along the pixel grid towards the grid. Cubic B-spline: Unser (1999), with the pixels as
    coefficients.
    """
    c, r = np.int32(x), np.int32(y)
    wx, sx = _spline_weights(x - c), _spline_slopes(x - c)
    wy, sy = _spline_weights(y - r), _spline_slopes(y - r)
    at, row = np.uint64((r - 1) * width + c - 1), np.uint64(width)
    # Written out, row by row: loops over the weights would not run over several samples at once.
    across_0, slope_0 = _along_row(pixels, at, wx, sx)
    across_1, slope_1 = _along_row(pixels, at + row, wx, sx)
    across_2, slope_2 = _along_row(pixels, at + row + row, wx, sx)
    across_3, slope_3 = _along_row(pixels, at + row + row + row, wx, sx)
    value = wy[0] * across_0 + wy[1] * across_1 + wy[2] * across_2 + wy[3] * across_3
    along_x = wy[0] * slope_0 + wy[1] * slope_1 + wy[2] * slope_2 + wy[3] * slope_3
    along_y = sy[0] * across_0 + sy[1] * across_1 + sy[2] * across_2 + sy[3] * across_3
    return value, along_x, along_y


@njit(cache=True, error_model="numpy")
def _smooth_sample(pixels: Any, width: int, x: float, y: float) -> tuple[float, float, float]:
    """Return the image and its derivatives as `_spline` does (Unser, 1999); nan outside."""
    if not (1.0 <= x < width - 2 and 1.0 <= y < pixels.size // width - 2):
        return np.nan, np.nan, np.nan
    return _spline(pixels, width, x, y)


@njit(cache=True, error_model="numpy")
def normal_equations(
    pixels: Any,
    width: int,
    centre: Any,
    linear: Any,
    quadratic: Any,
    samples: Any,
    slopes: Any,
    rows: Any,
    normal: Any,
    right: Any,
) -> float:
    """Compute J^T J and J^T r of the symmetry residuals in place; return the mean of r^2, nan if too few are inside.

    Residuals: Schöps et al. (2020), with this project's own slopes and curvature; the head of `calib.stars.centring`
    gives the equations.

    Parameters
    ----------
    pixels
        (H W,) float32, rows of the smoothed image, one after the other.
    width
        Number of columns of the image.
    centre
        (2,) float64, px, current centre.
    linear, quadratic
        (2, 2) px per pitch and (2, 3) px per square pitch, local map of the star.
    samples
        (2, M) float64, pitches, offsets along the columns and along the rows, one of each pair.
    slopes
        (4,) float64, current relative slope g, 1/pitch, and absolute slope b, brightness/pitch.
    rows
        (7, M) float64, space for the derivatives and the residuals.
    normal, right
        (6, 6) and (6,) float64, filled in.

    Returns
    -------
    float
        Mean square of the residuals, brightness^2.
    """
    reach = np.abs(samples).max() if samples.size else 0.0
    inside = True
    for k, last in ((0, width - 2), (1, pixels.size // width - 2)):
        far = np.abs(linear[k]).sum() * reach + np.abs(quadratic[k]).sum() * reach * reach + 1e-6
        inside &= centre[k] - far >= 1.0 and centre[k] + far < last
    if inside:
        squares = _sums_inside(
            pixels,
            width,
            centre[0],
            centre[1],
            linear,
            quadratic,
            samples[0],
            samples[1],
            slopes,
            normal,
            right,
        )
        return squares / samples.shape[1] if samples.shape[1] > 0 else np.nan
    return _sums_anywhere(
        pixels, width, centre[0], centre[1], linear, quadratic, samples, slopes, rows, normal, right
    )


@njit(cache=True, error_model="numpy", fastmath=_IN_PARALLEL)
def _sums_inside(
    pixels: Any,
    width: int,
    x: float,
    y: float,
    linear: Any,
    quadratic: Any,
    along: Any,
    down: Any,
    slopes: Any,
    normal: Any,
    right: Any,
) -> float:
    """Compute J^T J and J^T r in place for samples that all lie in the image; return the sum of r^2.

    Residuals: Schöps et al. (2020), as in `normal_equations`. Every sum is a variable of its own, and so is every
    number of the map: arrays could share memory, and the loop would not run over several samples at once.
    """
    a00, a01, a10, a11 = linear[0, 0], linear[0, 1], linear[1, 0], linear[1, 1]
    x_uu, x_uv, x_vv = quadratic[0, 0], quadratic[0, 1], quadratic[0, 2]
    y_uu, y_uv, y_vv = quadratic[1, 0], quadratic[1, 1], quadratic[1, 2]
    g_u, g_v, b_u, b_v = slopes[0], slopes[1], slopes[2], slopes[3]
    n00 = n10 = n11 = n20 = n21 = n22 = n30 = n31 = n32 = n33 = n40 = n41 = n42 = n43 = n44 = 0.0
    n50 = n51 = n52 = n53 = n54 = n55 = r0 = r1 = r2 = r3 = r4 = r5 = squares = 0.0
    for i in range(along.size):
        u, v = along[i], down[i]
        ax, ay = a00 * u + a01 * v, a10 * u + a11 * v
        mx = x + x_uu * u * u + x_uv * u * v + x_vv * v * v
        my = y + y_uu * u * u + y_uv * u * v + y_vv * v * v
        there, there_x, there_y = _spline(pixels, width, mx + ax, my + ay)
        here, here_x, here_y = _spline(pixels, width, mx - ax, my - ay)
        both = there + here
        j0, j1, j2, j3, j4, j5 = there_x - here_x, there_y - here_y, -u * both, -v * both, -u, -v
        r = there - here + g_u * j2 + g_v * j3 + b_u * j4 + b_v * j5
        n00, n10, n11 = n00 + j0 * j0, n10 + j1 * j0, n11 + j1 * j1
        n20, n21, n22 = n20 + j2 * j0, n21 + j2 * j1, n22 + j2 * j2
        n30, n31, n32, n33 = n30 + j3 * j0, n31 + j3 * j1, n32 + j3 * j2, n33 + j3 * j3
        n40, n41, n42, n43, n44 = n40 + j4 * j0, n41 + j4 * j1, n42 + j4 * j2, n43 + j4 * j3, n44 + j4 * j4
        n50, n51, n52, n53 = n50 + j5 * j0, n51 + j5 * j1, n52 + j5 * j2, n53 + j5 * j3
        n54, n55, squares = n54 + j5 * j4, n55 + j5 * j5, squares + r * r
        r0, r1, r2, r3, r4, r5 = r0 + j0 * r, r1 + j1 * r, r2 + j2 * r, r3 + j3 * r, r4 + j4 * r, r5 + j5 * r
    normal[0, 0], normal[1, 0], normal[1, 1] = n00, n10, n11
    normal[2, 0], normal[2, 1], normal[2, 2] = n20, n21, n22
    normal[3, 0], normal[3, 1], normal[3, 2], normal[3, 3] = n30, n31, n32, n33
    normal[4, 0], normal[4, 1], normal[4, 2], normal[4, 3], normal[4, 4] = n40, n41, n42, n43, n44
    normal[5, 0], normal[5, 1], normal[5, 2] = n50, n51, n52
    normal[5, 3], normal[5, 4], normal[5, 5] = n53, n54, n55
    right[0], right[1], right[2], right[3], right[4], right[5] = r0, r1, r2, r3, r4, r5
    for k in range(SYMMETRY_UNKNOWNS):
        for m in range(k):
            normal[m, k] = normal[k, m]
    return squares


@njit(cache=True, error_model="numpy")
def _sums_anywhere(
    pixels: Any,
    width: int,
    x: float,
    y: float,
    linear: Any,
    quadratic: Any,
    samples: Any,
    slopes: Any,
    rows: Any,
    normal: Any,
    right: Any,
) -> float:
    """Compute J^T J and J^T r in place; return the mean of r^2, nan if too few samples lie in the image.

    Residuals: Schöps et al. (2020), as in `normal_equations`.
    """
    n = 0
    for i in range(samples.shape[1]):
        u, v = samples[0, i], samples[1, i]
        uu, uv, vv = u * u, u * v, v * v
        ax, ay = linear[0, 0] * u + linear[0, 1] * v, linear[1, 0] * u + linear[1, 1] * v
        mx = x + quadratic[0, 0] * uu + quadratic[0, 1] * uv + quadratic[0, 2] * vv
        my = y + quadratic[1, 0] * uu + quadratic[1, 1] * uv + quadratic[1, 2] * vv
        there, there_x, there_y = _smooth_sample(pixels, width, mx + ax, my + ay)
        here, here_x, here_y = _smooth_sample(pixels, width, mx - ax, my - ay)
        if np.isnan(there) or np.isnan(here):
            continue
        both = there + here
        gx, gy = -u * both, -v * both
        rows[0, n], rows[1, n], rows[2, n], rows[3, n] = there_x - here_x, there_y - here_y, gx, gy
        rows[4, n], rows[5, n] = -u, -v
        rows[6, n] = there - here + slopes[0] * gx + slopes[1] * gy - slopes[2] * u - slopes[3] * v
        n += 1
    squares = _sum_products(rows, n, normal, right)
    return squares / n if samples.shape[1] > 0 and n >= MIN_COVERED * samples.shape[1] else np.nan


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
