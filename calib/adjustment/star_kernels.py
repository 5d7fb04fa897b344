"""Compiled loops over the stars of all views: residuals, and their robust cost with its derivatives.

One loop does what a chain of array operations would do: nothing but the results is written to memory. The shared
parameters are one vector, the state; `Places` says where each free parameter stands in it. This module is arithmetic
only; `calib.adjustment.bundle` says which parameters are free, and `calib.model.lens` has the same lenses in NumPy.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from calib.compiled import INNER, KERNEL

#: Places in the state: fx, fy, cx, cy, then the lens coefficients in the order of their family, the skew, and the
#: centre (x, y, r).
LENS_AT = 4
SKEW_AT = 12
CENTRE_AT = 13
RADIUS_AT = 15
#: Stars that are handled at a time: their derivatives by 12 parameters take 50 kilobytes.
CHUNK = 256
#: Robust losses by number.
LOSSES = {"l2": 0, "huber": 1, "cauchy": 2}

_TINY = float(np.finfo(float).tiny)
_HUBER, _CAUCHY = LOSSES["huber"], LOSSES["cauchy"]


@njit(**INNER)
def project(
    target: Any,
    rotation: Any,
    centre: Any,
    first: int,
    count: int,
    p: Any,
    plane: Any,
) -> None:
    """Write points in the camera frame, R (X - c) (arXiv:2512.16092, eq. 2), and their normalised coordinates.

    target: As for `residuals_px`.
    rotation, centre: (3, 3) rotation R, camera <- target, and (3,) centre c, mm.
    first, count: The first of M stars, and their number, at most `CHUNK`.
    p, plane: (3, `CHUNK`) float64 points, mm, and (2, `CHUNK`) float64 x / z and y / z; NaN for a point
      behind the camera.
    """
    # One loop writes few rows, so that the compiler can show that they do not overlap with those it reads.
    end = first + count
    tx, ty, tz = target[0, first:end], target[1, first:end], target[2, first:end]
    x, y, z, u, v = p[0, :count], p[1, :count], p[2, :count], plane[0, :count], plane[1, :count]
    cx, cy, cz = centre[0], centre[1], centre[2]
    for k in range(count):
        u[k] = tx[k] - cx
    for k in range(count):
        v[k] = ty[k] - cy
    a, b, c = rotation[0, 0], rotation[0, 1], rotation[0, 2]
    for k in range(count):
        x[k] = a * u[k] + b * v[k] + c * (tz[k] - cz)
    a, b, c = rotation[1, 0], rotation[1, 1], rotation[1, 2]
    for k in range(count):
        y[k] = a * u[k] + b * v[k] + c * (tz[k] - cz)
    a, b, c = rotation[2, 0], rotation[2, 1], rotation[2, 2]
    for k in range(count):
        z[k] = a * u[k] + b * v[k] + c * (tz[k] - cz)
    for k in range(count):
        inverse = 1.0 / z[k] if z[k] > 0.0 else np.nan
        u[k] = x[k] * inverse
        v[k] = y[k] * inverse


@njit(**INNER)
def _distort(x: Any, y: Any, state: Any, fisheye: bool) -> None:
    """Distort normalised points in place: Brown (1971) with OpenCV's denominator, or Kannala and Brandt (2006)."""
    k = state[LENS_AT:SKEW_AT]
    a, b, c, d, e, f, g, h = k[0], k[1], k[2], k[3], k[4], k[5], k[6], k[7]
    if fisheye:
        for i in range(len(x)):
            r = max(np.sqrt(x[i] * x[i] + y[i] * y[i]), 1e-12)
            theta = np.arctan(r)
            t2 = theta * theta
            scale = theta * (1.0 + t2 * (a + t2 * (b + t2 * (c + t2 * d)))) / r
            x[i], y[i] = x[i] * scale, y[i] * scale
        return
    for i in range(len(x)):
        u, v = x[i], y[i]
        r2 = u * u + v * v
        radial = (1.0 + r2 * (a + r2 * (b + r2 * e))) / (1.0 + r2 * (f + r2 * (g + r2 * h)))
        x[i] = u * radial + 2.0 * c * u * v + d * (r2 + 2.0 * u * u)
        y[i] = v * radial + c * (r2 + 2.0 * v * v) + 2.0 * d * u * v


@njit(**KERNEL)
def residuals_px(
    target: Any,
    points: Any,
    bounds: Any,
    state: Any,
    fisheye: bool,
    rotations: Any,
    offsets: Any,
    out: Any,
) -> None:
    """Write the residuals of all stars: image point found minus image point predicted (arXiv:2512.16092, eq. 6).

    target: (3, N) float64 positions on the target, mm.
    points: (2, N) float64 image points, px.
    bounds: (n, 2) int64 first star of each of n views, and the first behind it.
    state: (16,) float64 the shared parameters.
    fisheye: Whether the lens is a fisheye lens.
    rotations, offsets: (n, 3, 3) float64 rotations, and (n, 3) float64 centres of the views minus the shared
      one, mm.
    out: (2, M) float64 residuals of the views' stars, view after view, px; NaN for a star that cannot be
      projected.
    """
    centre, at = np.empty(3), 0
    p, plane = np.empty((3, CHUNK)), np.empty((2, CHUNK))
    fx, fy, cx, cy, skew = state[0], state[1], state[2], state[3], state[SKEW_AT]
    for i in range(len(rotations)):
        centre[0] = state[CENTRE_AT] + offsets[i, 0]
        centre[1] = state[CENTRE_AT + 1] + offsets[i, 1]
        centre[2] = -state[RADIUS_AT] + offsets[i, 2]
        for first in range(bounds[i, 0], bounds[i, 1], CHUNK):
            size = min(CHUNK, bounds[i, 1] - first)
            project(target, rotations[i], centre, first, size, p, plane)
            u, v, along_u, along_v = plane[0, :size], plane[1, :size], out[0, at:], out[1, at:]
            _distort(u, v, state, fisheye)
            found_u, found_v = points[0, first : first + size], points[1, first : first + size]
            for k in range(size):
                along_u[k] = found_u[k] - (u[k] * fx + v[k] * skew + cx)
            for k in range(size):
                along_v[k] = found_v[k] - (v[k] * fy + cy)
            at += size


@njit(**KERNEL)
def whiten(residuals: Any, factors: Any, bounds: Any) -> None:
    """Divide residuals by their standard deviations, in place (Aitken, 1936); infinite if a star was not projected.

    residuals: (2, M) float64 residuals of the views' stars, view after view, px.
    factors: (3, N) float64 elements 00, 10 and 11 of the whitening of each star, 1 / px.
    bounds: (n, 2) int64 first star of each view, and the first behind it.
    """
    at = 0
    for i in range(len(bounds)):
        for k in range(bounds[i, 0], bounds[i, 1]):
            x, y = residuals[0, at], residuals[1, at]
            x, y = factors[0, k] * x, factors[1, k] * x + factors[2, k] * y
            good = np.isfinite(x) and np.isfinite(y)
            residuals[0, at] = x if good else np.inf
            residuals[1, at] = y if good else np.inf
            at += 1


@njit(**KERNEL)
def robust_cost(residuals: Any, first: int, end: int, loss: int, limit: float) -> float:
    """Return the sum of the robust costs of some stars, as `Loss.cost` (Huber, 1964; Holland and Welsch, 1977).

    residuals: (2, M) float64 weighted residuals.
    first, end: The first of the stars, and the first behind them.
    loss: Number of the loss, see `LOSSES`.
    """
    total = 0.0
    for k in range(first, end):
        square = residuals[0, k] * residuals[0, k] + residuals[1, k] * residuals[1, k]
        if loss == _HUBER:
            length = np.sqrt(square)
            inside = min(length, limit)
            total += inside * (length - 0.5 * inside)
        elif loss == _CAUCHY:
            total += 0.5 * limit * limit * np.log1p(square / (limit * limit))
        else:
            total += 0.5 * square
    return total


@njit(**KERNEL)
def robust_curvature(
    residuals: Any, factors: Any, bounds: Any, loss: int, limit: float, gradient: Any, curvature: Any
) -> None:
    """Write the gradient and the curvature of the robust cost by the image points of all stars.

    The curvature is rho'' along the residual, zero where negative, and rho' / e across it, as in
    `Loss.curvature_root` (Triggs et al., 2000, section 4.3).

    residuals: (2, M) float64 weighted residuals of the views' stars, view after view.
    factors: (3, N) float64 elements 00, 10 and 11 of the whitening of each star, 1 / px.
    bounds: (n, 2) int64 first star of each view, and the first behind it.
    loss: Number of the loss, see `LOSSES`.
    gradient: (2, M) float64 negative gradient, 1 / px.
    curvature: (3, M) float64 elements xx, xy and yy of the curvature, 1 / px^2.
    """
    # A plain 0 is a type of its own: numba would compile all that is called once more, for it.
    at, across, excess = int(np.int64(0)), np.empty(CHUNK), np.empty(CHUNK)
    for i in range(len(bounds)):
        for first in range(bounds[i, 0], bounds[i, 1], CHUNK):
            size = min(CHUNK, bounds[i, 1] - first)
            _slopes(residuals[0, at : at + size], residuals[1, at : at + size], loss, limit, across, excess)
            _pulled(residuals, factors, first, across, excess, at, size, gradient, curvature)
            at += size


@njit(**INNER)
def _slopes(rx: Any, ry: Any, loss: int, limit: float, across: Any, excess: Any) -> None:
    """Write the curvatures across M residuals e, and what the curvatures along them exceed these by, over e^2."""
    count = len(rx)
    if loss == _HUBER:
        for k in range(count):
            square = max(rx[k] * rx[k] + ry[k] * ry[k], _TINY)
            outside = square > limit * limit
            across[k] = limit / np.sqrt(square) if outside else 1.0
            excess[k] = -limit / np.sqrt(square) / square if outside else 0.0
    elif loss == _CAUCHY:
        for k in range(count):
            square = max(rx[k] * rx[k] + ry[k] * ry[k], _TINY)
            share = square / (limit * limit)
            across[k] = 1.0 / (1.0 + share)
            excess[k] = (max((1.0 - share) * across[k] * across[k], 0.0) - across[k]) / square
    else:
        across[:count] = 1.0
        excess[:count] = 0.0


@njit(**INNER)
def _pulled(
    residuals: Any,
    factors: Any,
    first: int,
    across: Any,
    excess: Any,
    at: int,
    count: int,
    gradient: Any,
    curvature: Any,
) -> None:
    """Write gradient and curvature by the image points of some stars, from those of `_slopes` by the residuals."""
    rows, end = first + count, at + count
    rx, ry = residuals[0, at:end], residuals[1, at:end]
    a, b, c = factors[0, first:rows], factors[1, first:rows], factors[2, first:rows]
    # One loop writes one row, so that the compiler can show that it does not overlap with those it reads.
    gx, gy = gradient[0, at:end], gradient[1, at:end]
    xx, xy, yy = curvature[0, at:end], curvature[1, at:end], curvature[2, at:end]
    for k in range(count):
        along = a[k] * rx[k] + b[k] * ry[k]
        xx[k] = across[k] * (a[k] * a[k] + b[k] * b[k]) + excess[k] * along * along
    for k in range(count):
        along = a[k] * rx[k] + b[k] * ry[k]
        xy[k] = c[k] * (across[k] * b[k] + excess[k] * along * ry[k])
    for k in range(count):
        yy[k] = c[k] * c[k] * (across[k] + excess[k] * ry[k] * ry[k])
    for k in range(count):
        gx[k] = across[k] * (a[k] * rx[k] + b[k] * ry[k])
    for k in range(count):
        gy[k] = across[k] * c[k] * ry[k]
