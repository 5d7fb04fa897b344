"""Compiled loops of the symmetry of a star: the image as a spline, and the normal equations of a star's unknowns."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from calib.compiled import INNER, KERNEL
from calib.stars.grid_map import LocalMap

#: Number of unknowns: centre x, y; relative slope x, y; absolute slope x, y.
SYMMETRY_UNKNOWNS = 6
#: Least share of the used samples of a cell that must lie in the image: less of a star no longer fixes its centre well.
MIN_COVERED = 0.8
#: Sums may be reordered, so that they run in parallel. Only for loops that meet no nan.
_IN_PARALLEL = {"reassoc", "contract", "nsz", "nnan", "ninf", "arcp"}
#: In single precision, as all numbers of the loops: one double would make a whole sum double.
_ONE, _HALF, _SIXTH = np.float32(1.0), np.float32(0.5), np.float32(1.0 / 6.0)
_TWO, _THREE, _FOUR = np.float32(2.0), np.float32(3.0), np.float32(4.0)


@njit(**INNER, fastmath=_IN_PARALLEL, forceinline=True)
def _spline_weights(a: Any) -> tuple[Any, Any, Any, Any]:
    """Return the cubic B-spline (Unser, 1999) at four pixels around a point ``a`` px beyond the second one.

    Single precision here and below: twice as many samples are computed at once.
    """
    b = _ONE - a
    return (
        b * b * b * _SIXTH,
        (_FOUR - _THREE * a * a * (_TWO - a)) * _SIXTH,
        (_FOUR - _THREE * b * b * (_TWO - b)) * _SIXTH,
        a * a * a * _SIXTH,
    )


@njit(**INNER, fastmath=_IN_PARALLEL, forceinline=True)
def _spline_slopes(a: Any) -> tuple[Any, Any, Any, Any]:
    """Return the derivatives of `_spline_weights`, 1/px (Unser, 1999)."""
    b = _ONE - a
    return (-_HALF * b * b, a * (_THREE * _HALF * a - _TWO), b * (_TWO - _THREE * _HALF * b), _HALF * a * a)


@njit(**INNER, fastmath=_IN_PARALLEL, forceinline=True)
def _along_row(pixels: Any, at: Any, weights: Any, slopes: Any) -> tuple[Any, Any]:
    """Return the cubic B-spline (Unser, 1999) along four pixels of a row, from number ``at`` on, and its derivative."""
    at, step = np.uint64(at), np.uint64(1)
    p, q, s, t = pixels[at], pixels[at + step], pixels[at + step + step], pixels[at + step + step + step]
    across = weights[0] * p + weights[1] * q + weights[2] * s + weights[3] * t
    slope = slopes[0] * p + slopes[1] * q + slopes[2] * s + slopes[3] * t
    return across, slope


@njit(**INNER, fastmath=_IN_PARALLEL, forceinline=True)
def _spline(pixels: Any, width: Any, at: Any, a: Any, b: Any) -> tuple[Any, Any, Any]:
    """Return an image, as a cubic B-spline of its pixels, and its derivatives along x and y, all float32.

    ``pixels`` are its rows, one after the other. The point lies ``a`` px to the right of and ``b`` px below pixel
    number ``at``; ``width`` and ``at`` are int32. The point must be more than a pixel inside of the image. The spline
    blurs a little more than bilinear interpolation, but it has no kinks at pixels; bilinear values would pull edges
    that run along the pixel grid towards the grid. Unser (1999), with the pixels as coefficients.
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
    image: Any, centres: Any, local_map: LocalMap, samples: Any, used_to: Any, slopes: Any
) -> tuple[Any, Any, Any]:
    """Return J^T J, (N, 6, 6), J^T r, (N, 6), and the mean of r^2, (N,), of the symmetry residuals of N stars.

    Residuals: Schöps et al. (2020), with this project's own slopes and curvature; the head of `calib.stars.centring`
    gives the equations.
    If too few samples lie in the image, the mean is nan. The image is smoothed, (H, W) float32.
    local_map: at the centres, (N, 2) px; its arrays in the order of rows.
    samples: (2, M) float32, pitches, offsets along the columns and along the rows, one of each pair.
    used_to: (N, 2) float64, pitches, how far from its centre each star's cell is used.
    slopes: (N, 4) float64, current relative slope g, 1/pitch, and absolute slope b, brightness/pitch.
    """
    (height, width), pixels, reach, count = image.shape, image.ravel(), 0.0, len(centres)
    normal = np.zeros((count, SYMMETRY_UNKNOWNS, SYMMETRY_UNKNOWNS))
    right, mean_square = np.zeros((count, SYMMETRY_UNKNOWNS)), np.full(count, np.nan)
    space = np.empty_like(samples)  # for the samples that are used and lie in the image
    for i in range(samples.shape[1]):
        reach = max(reach, abs(samples[0, i]), abs(samples[1, i]))
    for star in range(count):
        a, b = local_map.linear[star], local_map.quadratic[star]
        far_x = (abs(a[0, 0]) + abs(a[0, 1])) * reach
        far_x += (abs(b[0, 0]) + abs(b[0, 1]) + abs(b[0, 2])) * reach * reach
        far_y = (abs(a[1, 0]) + abs(a[1, 1])) * reach
        far_y += (abs(b[1, 0]) + abs(b[1, 1]) + abs(b[1, 2])) * reach * reach
        x, y = centres[star]
        n, used, places = samples.shape[1], samples.shape[1], samples
        rim = max(far_x, far_y) + 1.01
        inside = rim <= x <= width - 1 - rim and rim <= y <= height - 1 - rim  # not if the centre is nan
        if not inside or min(used_to[star, 0], used_to[star, 1]) < reach:
            n, used = _copy_inside(width, height, centres[star], a, b, samples, used_to[star], space)
            places = space
        if n > 0 and n >= MIN_COVERED * used:
            far, sums = int(max(far_x, far_y)) + 2, (normal[star], right[star])
            squares = _sums_inside(pixels, width, centres[star], far, (a, b), places, n, slopes[star], sums)
            mean_square[star] = squares / n
    return normal, right, mean_square


@njit(**INNER)
def _copy_inside(
    width: int, height: int, centre: Any, linear: Any, quadratic: Any, samples: Any, used_to: Any, space: Any
) -> tuple[Any, Any]:
    """Copy used samples with both points over a pixel inside the image; return their number, and that of used ones."""
    n = used = np.int64(0)
    x, y, u_to, v_to = centre[0], centre[1], used_to[0], used_to[1]
    a00, a01, a10, a11 = linear[0, 0], linear[0, 1], linear[1, 0], linear[1, 1]
    x_uu, x_uv, x_vv = quadratic[0, 0], quadratic[0, 1], quadratic[0, 2]
    y_uu, y_uv, y_vv = quadratic[1, 0], quadratic[1, 1], quadratic[1, 2]
    for i in range(samples.shape[1]):
        u, v = samples[0, i], samples[1, i]
        ax, ay = abs(a00 * u + a01 * v), abs(a10 * u + a11 * v)
        mx = x + x_uu * u * u + x_uv * u * v + x_vv * v * v
        my = y + y_uu * u * u + y_uv * u * v + y_vv * v * v
        space[0, n], space[1, n] = u, v
        # To a thousandth of a pixel, since the sums are made in single precision. Added as 0 or 1, without a branch.
        in_cell = np.int64((abs(u) <= u_to) & (abs(v) <= v_to))
        in_columns = np.int64((mx - ax >= 1.001) & (mx + ax < width - 2.001))
        in_rows = np.int64((my - ay >= 1.001) & (my + ay < height - 2.001))
        used += in_cell
        n += in_cell & in_columns & in_rows
    return n, used


@njit(**INNER, fastmath=_IN_PARALLEL, forceinline=True)
def _sums_inside(
    pixels: Any,
    width: int,
    centre: Any,
    far: int,
    bent: Any,
    samples: Any,
    count: int,
    slopes: Any,
    sums: Any,
) -> float:
    """Compute J^T J and J^T r in place for the first samples, which all lie in the image; return the sum of r^2.

    Residuals: Schöps et al. (2020), as in `normal_equations`. Every sum is a variable of its own, and so is every
    number of the map: arrays could share memory, and the loop would not run over several samples at once. Places are
    relative to a pixel ``far`` px to the upper left of the centre: there, single precision is right to 1e-5 px.
    bent: A and B of the star's local map. sums: J^T J and J^T r.
    """
    (linear, quadratic), (normal, right) = bent, sums
    left, top, row = int(centre[0]) - far, int(centre[1]) - far, np.int32(width)
    origin = np.int32(top * width + left)
    x, y = np.float32(centre[0] - left), np.float32(centre[1] - top)
    a00, a01 = np.float32(linear[0, 0]), np.float32(linear[0, 1])
    a10, a11 = np.float32(linear[1, 0]), np.float32(linear[1, 1])
    x_uu, x_uv, x_vv = np.float32(quadratic[0, 0]), np.float32(quadratic[0, 1]), np.float32(quadratic[0, 2])
    y_uu, y_uv, y_vv = np.float32(quadratic[1, 0]), np.float32(quadratic[1, 1]), np.float32(quadratic[1, 2])
    g_u, g_v = np.float32(slopes[0]), np.float32(slopes[1])
    b_u, b_v = np.float32(slopes[2]), np.float32(slopes[3])
    zero = np.float32(0.0)
    n00 = n10 = n11 = n20 = n21 = n22 = n30 = n31 = n32 = n33 = n40 = n41 = n42 = n43 = n44 = zero
    n50 = n51 = n52 = n53 = n54 = n55 = r0 = r1 = r2 = r3 = r4 = r5 = squares = zero
    for i in range(count):
        u, v = samples[0, i], samples[1, i]
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
