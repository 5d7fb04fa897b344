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

The scatter of neighbouring stars scales the covariances, which are known up to a factor: neighbours share no pixels but
lie on a smooth map, so the stencil

    e = c(0, 0) - (c(1, 0) + c(-1, 0) + c(0, 1) + c(0, -1)) / 2
        + (c(1, 1) + c(1, -1) + c(-1, 1) + c(-1, -1)) / 4

leaves noise. It is the mask of Immerkær (1996) for images; it cancels every map of degree three or less, x^4 and y^4.

The compiled loops have no branch and no store, so that they run over several samples at once. Samples outside of the
image are left out before.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import cv2
import numpy as np
from numba import njit

from calib.arrays import Array, Array32, Bools, Ints, selected
from calib.compiled import INNER, KERNEL
from calib.stars.grid_map import LocalMap

# Compiled loops of the symmetry of a star: the image as a spline, and the normal equations of a star's unknowns.

#: Number of unknowns: centre x, y; relative slope x, y; absolute slope x, y.
SYMMETRY_UNKNOWNS = 6
#: Least share of the used samples of a cell that must lie in the image.
MIN_COVERED = 0.8
#: Sums may be reordered, so that they run in parallel. Only for loops that meet no nan.
_IN_PARALLEL = {"reassoc", "contract", "nsz", "nnan", "ninf", "arcp"}
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
    at, one = np.uint64(at), np.uint64(1)
    p, q, s, t = pixels[at], pixels[at + one], pixels[at + one + one], pixels[at + one + one + one]
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


#: Half the side of the square in which symmetry is measured, pitches: the star's own cell and no more, so that
#: neighbours share no pixels.
SYMMETRY_REACH = 0.49
#: A step that is shorter is the last one, px. Each step is about a hundredth of the one before.
LAST_STEP_PX = 1e-3
_MAX_STEPS = 12
#: Normal equations of a larger condition determine no step.
_MAX_CONDITION = 1e12


class SymmetryFit(NamedTuple):
    """Centres of N stars by symmetry."""

    centres: Array  # (N, 2) float64, px
    # (N, 2, 2) float64, (brightness / px)^2, J^T J of the centre after elimination of the slopes.
    information: Array
    mean_square: Array  # (N,) float64, brightness^2, mean square of the residuals
    # (N,) float64, 1/pitch, length of g: relative slope of the light across the star.
    light_slope: Array
    converged: Bools  # (N,) bool, whether the last step was shorter than `LAST_STEP_PX`


def smooth(image: Array32, sigma_px: float) -> Array32:
    """Blur an image by a Gaussian, against the noise of single pixels and the effect of the pixel grid."""
    return np.ascontiguousarray(cv2.GaussianBlur(image, (0, 0), sigma_px), np.float32)


def symmetry_samples(pitch_px: float) -> Array:
    """Return (M, 2) offsets s from the centre, pitches, one of each pair (s, -s), about a pixel apart."""
    side = int(np.clip(np.ceil(2 * SYMMETRY_REACH * pitch_px), 16, 64))
    steps = (np.arange(side) + 0.5) / side * 2.0 - 1.0
    u, v = np.meshgrid(steps * SYMMETRY_REACH, steps * SYMMETRY_REACH)
    upper = (v > 0) | ((v == 0) & (u > 0))
    return np.column_stack([u[upper], v[upper]])


def solve_steps(normal: Array, right: Array) -> tuple[Bools, Array]:
    """Solve the (N, 6, 6) normal equations of each star by the eigenvalues of its matrix.

    Scaled to a unit diagonal first (van der Sluis, 1969), because the unit of some unknowns is the grey value. Returns
    whether the image determines every unknown, (N,), as a flat one does not; and the (N, 6) steps, 0 where it does not.
    """
    diagonal = np.diagonal(normal, axis1=1, axis2=2)
    lit = np.asarray(np.isfinite(normal).all(axis=(1, 2)) & (diagonal > 0.0).all(axis=1))
    scale = np.sqrt(np.where(lit[:, None], diagonal, 1.0))
    scaled = np.where(lit[:, None, None], normal, 0.0) / scale[:, :, None] / scale[:, None, :]
    values, vectors = np.linalg.eigh(scaled)
    regular = lit & (values[:, 0] * _MAX_CONDITION > values[:, -1])
    along = np.einsum("nki,nk->ni", vectors, right / scale)
    along = np.divide(along, values, out=np.zeros_like(along), where=regular[:, None])
    return regular, np.einsum("nki,ni->nk", vectors, along) / scale


def centre_information(normal: Array) -> Array:
    """Return the (N, 2, 2) information of centres, without the slopes, from regular (N, 6, 6) equations."""
    shares = np.linalg.solve(normal[:, 2:, 2:], normal[:, 2:, :2])
    return normal[:, :2, :2] - normal[:, :2, 2:] @ shares


def refine_by_symmetry(
    image: Array32, guesses: Array, local_map: LocalMap, samples: Array, used_to: Array, reach_px: float
) -> SymmetryFit:
    """Find the centre of each star by symmetry, with Gauss-Newton steps of all stars at the same time.

    The cost is that of Schöps et al. (2020), arXiv:1912.02908, with this project's own additions; the head of the
    module gives the equations. The image is smoothed; ``used_to``, (N, 2) pitches, is how far each star's cell is used
    along columns and rows. A centre that moves further than ``reach_px`` from its guess, px, or whose cell lies too far
    outside of the image, is nan and not converged.
    """
    n, nan = len(guesses), np.full((len(guesses), 2, 2), np.nan)
    fit = SymmetryFit(nan[:, 0].copy(), nan, nan[:, 0, 0].copy(), nan[:, 0, 0].copy(), np.zeros(n, np.bool_))
    places = np.ascontiguousarray(samples.T, np.float32)
    maps = LocalMap(*map(np.ascontiguousarray, local_map))
    stars, centres, slopes = np.arange(n), guesses.astype(float), np.zeros((n, SYMMETRY_UNKNOWNS - 2))
    for _ in range(_MAX_STEPS):
        fixed = selected(maps, stars), places, used_to[stars]
        normal, right, mean_square = normal_equations(image, centres, *fixed, slopes)
        regular, step = solve_steps(normal, right)
        length = np.hypot(step[:, 0], step[:, 1])
        shorter = 1.5 / np.maximum(length, 1.5)
        centres -= shorter[:, None] * step[:, :2]
        slopes -= shorter[:, None] * step[:, 2:]
        kept = regular & (np.hypot(*(centres - guesses[stars]).T) <= reach_px)
        done = kept & (length < LAST_STEP_PX)
        found = stars[done]
        fit.converged[found], fit.centres[found] = True, centres[done]
        fit.information[found], fit.mean_square[found] = centre_information(normal[done]), mean_square[done]
        fit.light_slope[found] = np.hypot(slopes[done, 0], slopes[done, 1])
        going = kept & ~done
        stars, centres, slopes = stars[going], centres[going], slopes[going]
    return fit


#: Neighbours of a star in the stencil, and their weights.
_STENCIL = dict.fromkeys([(1, 0), (-1, 0), (0, 1), (0, -1)], -0.5)
_STENCIL |= dict.fromkeys([(1, 1), (1, -1), (-1, 1), (-1, -1)], 0.25)
#: Number of surrounded stars from which their scatter alone is used; below it, the typical factor is mixed in.
TRUSTED_FROM = 30
#: Largest normalised square that takes part: chi-square of two degrees of freedom exceeds it 1 in 22,000 times.
_MAX_SQUARE = 20.0


def stencil_residuals(nodes: Ints, points: Array, nominal: Array) -> tuple[Array, Array]:
    """Compare each star that has all eight neighbours with them: (M, 2) e, px, and (M, 2, 2) covariances, px^2.

    The stencil is the mask of Immerkær (1996). The covariance of e is the sum of w^2 V over the stars, with their
    weights w and covariances V (JCGM 100:2008, section 5.1), known up to a factor.
    """
    low = nodes.min(axis=0, initial=0) - 1
    size = nodes.max(axis=0, initial=0) - low + 2
    star_at = np.full(size, -1)
    star_at[tuple((nodes - low).T)] = np.arange(len(nodes))
    around = star_at[tuple(np.moveaxis((nodes - low)[:, None, :] + np.array(list(_STENCIL)), 2, 0))]
    whole = (around >= 0).all(axis=1)
    around, weights = around[whole], np.array(list(_STENCIL.values()))
    residuals = points[whole] + weights @ points[around]
    return residuals, nominal[whole] + np.einsum("k,mkij->mij", weights**2, nominal[around])


def variance_factor(nodes: Ints, points: Array, nominal: Array, *, typical: float) -> float:
    """Estimate the factor of the (N, 2, 2) covariances from the scatter of neighbouring stars.

    A first value is the median of the normalised squares over 2 ln 2, the median of chi-square with two degrees of
    freedom. The result is the mean of those squares that are not far above it. This estimator is this project's own.
    The ``typical`` factor is mixed in if fewer than `TRUSTED_FROM` stars have all eight neighbours.
    """
    residuals, covariances = stencil_residuals(nodes, points, nominal)
    count, total = 0.0, 0.0
    if len(residuals):
        squares = np.einsum("mi,mij,mj->m", residuals, np.linalg.inv(covariances), residuals)
        factor = float(np.median(squares)) / (2 * np.log(2))
        if factor > 0:
            near = squares < _MAX_SQUARE * factor
            count, total = float(np.count_nonzero(near)), float(squares[near].sum()) / 2.0
    borrowed = max(TRUSTED_FROM - count, 0.0)
    return (total + borrowed * typical) / (count + borrowed)
