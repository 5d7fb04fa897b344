"""Compiled loops over the stars of all views: residuals, and their robust cost with its derivatives.

One loop does what a chain of array operations would do: nothing but the results is written to memory. The shared
parameters are one vector, the state; `Places` says where each free parameter stands in it. This module is arithmetic
only; `calib.adjustment.bundle` says which parameters are free, and `calib.model.lens` has the same lenses in NumPy.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

#: Places in the state: fx, fy, cx, cy, then the lens coefficients in the order of their family, the skew, the centre
#: (x, y, r), and the aberrations.
LENS_AT = 4
SKEW_AT = 12
CENTRE_AT = 13
RADIUS_AT = 15
ABERRATIONS_AT = 16
#: Place of a parameter that moves no star.
NOWHERE = -1
#: Robust losses by number.
LOSSES = {"l2": 0, "huber": 1, "cauchy": 2}

_TINY = float(np.finfo(float).tiny)
_HUBER, _CAUCHY = LOSSES["huber"], LOSSES["cauchy"]


@njit(cache=True, error_model="numpy")
def plane_point(target: Any, displacements: Any, state: Any, k: int) -> tuple[float, float]:
    """Return where a star appears on the target: its position plus its displacement by the aberrations.

    Parameters
    ----------
    target, displacements, state
        As for `residuals_px`.
    k
        Index of the star.

    Returns
    -------
    tuple of float
        X and Y, mm.
    """
    x, y = target[0, k], target[1, k]
    for t in range(displacements.shape[2]):
        x += displacements[k, 0, t] * state[ABERRATIONS_AT + t]
        y += displacements[k, 1, t] * state[ABERRATIONS_AT + t]
    return x, y


@njit(cache=True, error_model="numpy")
def camera_point(rotation: Any, centre: Any, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return the point R (X - c) in the camera frame (arXiv:2512.16092, eq. 2).

    Parameters
    ----------
    rotation, centre
        (3, 3) rotation R, camera <- target, and (3,) centre c, mm.
    x, y, z
        The point X on the target, mm.

    Returns
    -------
    tuple of float
        Its coordinates, mm.
    """
    a, b, c = x - centre[0], y - centre[1], z - centre[2]
    return (
        rotation[0, 0] * a + rotation[0, 1] * b + rotation[0, 2] * c,
        rotation[1, 0] * a + rotation[1, 1] * b + rotation[1, 2] * c,
        rotation[2, 0] * a + rotation[2, 1] * b + rotation[2, 2] * c,
    )


@njit(cache=True, error_model="numpy")
def _distorted(x: float, y: float, state: Any, fisheye: bool) -> tuple[float, float]:
    """Return a distorted normalised point: Brown (1971) with OpenCV's denominator, or Kannala and Brandt (2006)."""
    k = state[LENS_AT:SKEW_AT]
    if fisheye:
        r = max(np.sqrt(x * x + y * y), 1e-12)
        theta = np.arctan(r)
        t2 = theta * theta
        scale = theta * (1.0 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3])))) / r
        return x * scale, y * scale
    r2 = x * x + y * y
    radial = (1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))) / (1.0 + r2 * (k[5] + r2 * (k[6] + r2 * k[7])))
    return (
        x * radial + 2.0 * k[2] * x * y + k[3] * (r2 + 2.0 * x * x),
        y * radial + k[2] * (r2 + 2.0 * y * y) + 2.0 * k[3] * x * y,
    )


@njit(cache=True, error_model="numpy")
def residuals_px(
    target: Any,
    displacements: Any,
    points: Any,
    bounds: Any,
    state: Any,
    fisheye: bool,
    rotations: Any,
    offsets: Any,
    out: Any,
) -> None:
    """Write the residuals of all stars: image point found minus image point predicted (arXiv:2512.16092, eq. 6).

    Parameters
    ----------
    target
        (3, N) float64 positions on the target, mm.
    displacements
        (N, 2, T) float64 displacement of each star by a unit of each aberration, mm.
    points
        (2, N) float64 image points, px.
    bounds
        (n, 2) int64 first star of each of n views, and the first behind it.
    state
        (16 + T,) float64 the shared parameters.
    fisheye
        Whether the lens is a fisheye lens.
    rotations, offsets
        (n, 3, 3) float64 rotations, and (n, 3) float64 centres of the views minus the shared one, mm.
    out
        (2, M) float64 residuals of the views' stars, view after view, px; NaN for a star that cannot be projected.
    """
    centre, at = np.empty(3), 0
    for i in range(len(rotations)):
        centre[0] = state[CENTRE_AT] + offsets[i, 0]
        centre[1] = state[CENTRE_AT + 1] + offsets[i, 1]
        centre[2] = -state[RADIUS_AT] + offsets[i, 2]
        for k in range(bounds[i, 0], bounds[i, 1]):
            x, y = plane_point(target, displacements, state, k)
            x, y, z = camera_point(rotations[i], centre, x, y, target[2, k])
            inverse = 1.0 / z if z > 0.0 else np.nan
            u, v = _distorted(x * inverse, y * inverse, state, fisheye)
            out[0, at] = points[0, k] - (u * state[0] + v * state[SKEW_AT] + state[2])
            out[1, at] = points[1, k] - (v * state[1] + state[3])
            at += 1


@njit(cache=True, error_model="numpy")
def whiten(residuals: Any, factors: Any, bounds: Any) -> None:
    """Divide residuals by their standard deviations, in place (Aitken, 1936); infinite if a star was not projected.

    Parameters
    ----------
    residuals
        (2, M) float64 residuals of the views' stars, view after view, px.
    factors
        (3, N) float64 elements 00, 10 and 11 of the whitening of each star, 1 / px.
    bounds
        (n, 2) int64 first star of each view, and the first behind it.
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


@njit(cache=True, error_model="numpy")
def robust_cost(residuals: Any, first: int, end: int, loss: int, limit: float) -> float:
    """Return the sum of the robust costs of some stars, as `Loss.cost` (Huber, 1964; Holland and Welsch, 1977).

    Parameters
    ----------
    residuals
        (2, M) float64 weighted residuals.
    first, end
        The first of the stars, and the first behind them.
    loss
        Number of the loss, see `LOSSES`.
    limit
        Length at which the loss leaves the parabola.

    Returns
    -------
    float
        The cost.
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


@njit(cache=True, error_model="numpy")
def robust_curvature(
    residuals: Any, factors: Any, bounds: Any, loss: int, limit: float, gradient: Any, curvature: Any
) -> None:
    """Write the gradient and the curvature of the robust cost by the image points of all stars.

    The curvature is rho'' along the residual, zero where negative, and rho' / e across it, as in
    `Loss.curvature_root` (Triggs et al., 2000, section 4.3).

    Parameters
    ----------
    residuals
        (2, M) float64 weighted residuals of the views' stars, view after view.
    factors
        (3, N) float64 elements 00, 10 and 11 of the whitening of each star, 1 / px.
    bounds
        (n, 2) int64 first star of each view, and the first behind it.
    loss
        Number of the loss, see `LOSSES`.
    limit
        Length at which the loss leaves the parabola.
    gradient
        (2, M) float64 negative gradient, 1 / px.
    curvature
        (3, M) float64 elements xx, xy and yy of the curvature, 1 / px^2.
    """
    at = 0
    for i in range(len(bounds)):
        for k in range(bounds[i, 0], bounds[i, 1]):
            x, y = residuals[0, at], residuals[1, at]
            a, b, c = factors[0, k], factors[1, k], factors[2, k]
            length = np.sqrt(x * x + y * y)
            across, along = 1.0, 1.0
            if loss == _HUBER and length > limit:
                across, along = limit / length, 0.0
            elif loss == _CAUCHY:
                square = (length / limit) ** 2
                across = 1.0 / (1.0 + square)
                along = max((1.0 - square) * across * across, 0.0)
            gradient[0, at] = across * (a * x + b * y)
            gradient[1, at] = across * (c * y)
            length = max(length, _TINY)
            ux, uy = x / length, y / length
            excess = along - across
            xx, xy, yy = across + excess * ux * ux, excess * ux * uy, across + excess * uy * uy
            curvature[0, at] = a * a * xx + 2.0 * a * b * xy + b * b * yy
            curvature[1, at] = c * (a * xy + b * yy)
            curvature[2, at] = c * c * yy
            at += 1
