"""Compiled loops of the symmetry of a star: the image as a spline, and the normal equations of a star's unknowns.

`calib.stars.centring` says what the numbers mean. One loop without a branch and without a store adds up everything, so
that it runs over several samples at once. Samples outside of the image are left out before.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from calib.compiled import INNER, KERNEL

#: Number of unknowns: centre x, y; relative slope x, y; absolute slope x, y.
SYMMETRY_UNKNOWNS = 6
#: Least share of a cell's samples that must lie in the image.
MIN_COVERED = 0.8
#: Sums may be reordered, so that they run in parallel. Only for loops that meet no nan.
_IN_PARALLEL = {"reassoc", "contract", "nsz", "nnan", "ninf", "arcp"}
_ONE, _HALF, _SIXTH = np.float32(1.0), np.float32(0.5), np.float32(1.0 / 6.0)
_TWO, _THREE, _FOUR = np.float32(2.0), np.float32(3.0), np.float32(4.0)


@njit(**KERNEL, fastmath=_IN_PARALLEL, inline="always")
def _spline_weights(a: Any) -> tuple[Any, Any, Any, Any]:
    """Return the cubic B-spline at the four pixels around a point that lies ``a`` px beyond the second one.

    Cubic B-spline: Unser (1999). Single precision here and below: twice as many samples are computed at once.
    """
    b = _ONE - a
    return (
        b * b * b * _SIXTH,
        (_FOUR - _THREE * a * a * (_TWO - a)) * _SIXTH,
        (_FOUR - _THREE * b * b * (_TWO - b)) * _SIXTH,
        a * a * a * _SIXTH,
    )


@njit(**KERNEL, fastmath=_IN_PARALLEL, inline="always")
def _spline_slopes(a: Any) -> tuple[Any, Any, Any, Any]:
    """Return the derivatives of `_spline_weights`, 1/px.

    Derivative of the cubic B-spline of Unser (1999).
    """
    b = _ONE - a
    return (-_HALF * b * b, a * (_THREE * _HALF * a - _TWO), b * (_TWO - _THREE * _HALF * b), _HALF * a * a)


@njit(**KERNEL, fastmath=_IN_PARALLEL, inline="always")
def _along_row(pixels: Any, at: Any, weights: Any, slopes: Any) -> tuple[Any, Any]:
    """Return the spline along four pixels of a row, from number ``at`` on, and its derivative.

    Cubic B-spline: Unser (1999).
    """
    at, one = np.uint64(at), np.uint64(1)
    p, q, s, t = pixels[at], pixels[at + one], pixels[at + one + one], pixels[at + one + one + one]
    across = weights[0] * p + weights[1] * q + weights[2] * s + weights[3] * t
    slope = slopes[0] * p + slopes[1] * q + slopes[2] * s + slopes[3] * t
    return across, slope


@njit(**KERNEL, fastmath=_IN_PARALLEL, inline="always")
def _spline(pixels: Any, width: Any, at: Any, a: Any, b: Any) -> tuple[Any, Any, Any]:
    """Return an image, as a cubic B-spline of its pixels, and its derivatives along x and y, all float32.

    ``pixels`` are its rows, one after the other. The point lies ``a`` px to the right of and ``b`` px below pixel
    number ``at``; ``width`` and ``at`` are int32. The point must be more than a pixel inside of the image.

    The spline blurs a little more than bilinear interpolation, but it has no kinks at pixels. Bilinear values would
    pull edges that run along the pixel grid towards the grid. Cubic B-spline: Unser (1999), with the pixels as
    coefficients.
    """
    wx, sx, wy, sy = _spline_weights(a), _spline_slopes(a), _spline_weights(b), _spline_slopes(b)
    # Written out, row by row: loops over the weights would not run over several samples at once.
    first = at - width - np.int32(1)
    across_0, slope_0 = _along_row(pixels, first, wx, sx)
    across_1, slope_1 = _along_row(pixels, first + width, wx, sx)
    across_2, slope_2 = _along_row(pixels, first + width + width, wx, sx)
    across_3, slope_3 = _along_row(pixels, first + width + width + width, wx, sx)
    value = wy[0] * across_0 + wy[1] * across_1 + wy[2] * across_2 + wy[3] * across_3
    along_x = wy[0] * slope_0 + wy[1] * slope_1 + wy[2] * slope_2 + wy[3] * slope_3
    along_y = sy[0] * across_0 + sy[1] * across_1 + sy[2] * across_2 + sy[3] * across_3
    return value, along_x, along_y


@njit(**KERNEL)
def normal_equations(
    pixels: Any,
    width: int,
    centre: Any,
    linear: Any,
    quadratic: Any,
    samples: Any,
    slopes: Any,
    space: Any,
    normal: Any,
    right: Any,
) -> float:
    """Compute J^T J and J^T r of the symmetry residuals in place; return the mean of r^2, nan if too few are inside.

    Residuals: Schöps et al. (2020), with this project's own slopes and curvature; the head of `calib.stars.centring`
    gives the equations.

    pixels: (H W,) float32, rows of the smoothed image, one after the other.
    centre: (2,) float64, px, current centre.
    linear, quadratic: (2, 2) px per pitch and (2, 3) px per square pitch, local map of the star.
    samples: (2, M) float32, pitches, offsets along the columns and along the rows, one of each pair.
    slopes: (4,) float64, current relative slope g, 1/pitch, and absolute slope b, brightness/pitch.
    space: (2, M) float32, space for the samples that lie in the image.
    normal, right: (6, 6) and (6,) float64, filled in.
    Returns: Mean square of the residuals, brightness^2.
    """
    reach = np.abs(samples).max() if samples.size else 0.0
    inside, most = True, 0.0
    for k, last in ((0, width - 2), (1, pixels.size // width - 2)):
        far = np.abs(linear[k]).sum() * reach + np.abs(quadratic[k]).sum() * reach * reach + 1e-6
        inside &= centre[k] - far >= 1.0 and centre[k] + far < last
        most = max(most, far)
    along, down = samples[0], samples[1]
    if not inside:
        n = _copy_inside(width, pixels.size // width, centre, linear, quadratic, samples, space)
        along, down = space[0, :n], space[1, :n]
    if along.size < MIN_COVERED * samples.shape[1] or along.size == 0:
        return np.nan
    squares = _sums_inside(
        pixels, width, centre, int(most) + 2, linear, quadratic, along, down, slopes, normal, right
    )
    return squares / along.size


@njit(**INNER)
def _copy_inside(
    width: int, height: int, centre: Any, linear: Any, quadratic: Any, samples: Any, space: Any
) -> int:
    """Copy the samples whose two points lie more than a pixel inside of the image; return their number."""
    n = 0
    for i in range(samples.shape[1]):
        u, v = samples[0, i], samples[1, i]
        ax, ay = linear[0, 0] * u + linear[0, 1] * v, linear[1, 0] * u + linear[1, 1] * v
        mx = centre[0] + quadratic[0, 0] * u * u + quadratic[0, 1] * u * v + quadratic[0, 2] * v * v
        my = centre[1] + quadratic[1, 0] * u * u + quadratic[1, 1] * u * v + quadratic[1, 2] * v * v
        space[0, n], space[1, n] = u, v
        # To a thousandth of a pixel, since the sums are made in single precision. Added as 0 or 1, without a branch.
        in_columns = (mx - abs(ax) >= 1.001) & (mx + abs(ax) < width - 2.001)
        n += int(in_columns & (my - abs(ay) >= 1.001) & (my + abs(ay) < height - 2.001))
    return n


@njit(**INNER, fastmath=_IN_PARALLEL)
def _sums_inside(
    pixels: Any,
    width: int,
    centre: Any,
    far: int,
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
    number of the map: arrays could share memory, and the loop would not run over several samples at once. Places are
    relative to a pixel ``far`` px to the upper left of the centre: there, single precision is right to 1e-5 px.
    """
    left, top, row = int(centre[0]) - far, int(centre[1]) - far, np.int32(width)
    origin = np.int32(top * width + left)
    x, y = np.float32(centre[0] - left), np.float32(centre[1] - top)
    a00, a01 = np.float32(linear[0, 0]), np.float32(linear[0, 1])
    a10, a11 = np.float32(linear[1, 0]), np.float32(linear[1, 1])
    x_uu, x_uv, x_vv = np.float32(quadratic[0, 0]), np.float32(quadratic[0, 1]), np.float32(quadratic[0, 2])
    y_uu, y_uv, y_vv = np.float32(quadratic[1, 0]), np.float32(quadratic[1, 1]), np.float32(quadratic[1, 2])
    g_u, g_v, b_u, b_v = (
        np.float32(slopes[0]),
        np.float32(slopes[1]),
        np.float32(slopes[2]),
        np.float32(slopes[3]),
    )
    zero = np.float32(0.0)
    n00 = n10 = n11 = n20 = n21 = n22 = n30 = n31 = n32 = n33 = n40 = n41 = n42 = n43 = n44 = zero
    n50 = n51 = n52 = n53 = n54 = n55 = r0 = r1 = r2 = r3 = r4 = r5 = squares = zero
    for i in range(along.size):
        u, v = along[i], down[i]
        ax, ay = a00 * u + a01 * v, a10 * u + a11 * v
        mx = x + x_uu * u * u + x_uv * u * v + x_vv * v * v
        my = y + y_uu * u * u + y_uv * u * v + y_vv * v * v
        px, py, qx, qy = mx + ax, my + ay, mx - ax, my - ay
        c, r, e, f = np.int32(px), np.int32(py), np.int32(qx), np.int32(qy)
        there, there_x, there_y = _spline(
            pixels, row, origin + r * row + c, px - np.float32(c), py - np.float32(r)
        )
        here, here_x, here_y = _spline(
            pixels, row, origin + f * row + e, qx - np.float32(e), qy - np.float32(f)
        )
        both = there + here
        j0, j1, j2, j3, j4, j5 = there_x - here_x, there_y - here_y, -u * both, -v * both, -u, -v
        off = there - here + g_u * j2 + g_v * j3 + b_u * j4 + b_v * j5
        n00, n10, n11 = n00 + j0 * j0, n10 + j1 * j0, n11 + j1 * j1
        n20, n21, n22 = n20 + j2 * j0, n21 + j2 * j1, n22 + j2 * j2
        n30, n31, n32, n33 = n30 + j3 * j0, n31 + j3 * j1, n32 + j3 * j2, n33 + j3 * j3
        n40, n41, n42, n43, n44 = n40 + j4 * j0, n41 + j4 * j1, n42 + j4 * j2, n43 + j4 * j3, n44 + j4 * j4
        n50, n51, n52, n53 = n50 + j5 * j0, n51 + j5 * j1, n52 + j5 * j2, n53 + j5 * j3
        n54, n55, squares = n54 + j5 * j4, n55 + j5 * j5, squares + off * off
        r0, r1, r2 = r0 + j0 * off, r1 + j1 * off, r2 + j2 * off
        r3, r4, r5 = r3 + j3 * off, r4 + j4 * off, r5 + j5 * off
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
    return float(squares)
