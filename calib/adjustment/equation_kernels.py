"""Compiled loops over the stars of all views: derivatives of the image points, and the normal equations of each view.

The derivatives of some hundred stars at a time are kept in rows, one for each parameter and image axis. This module is
arithmetic only; `calib.adjustment.linearisation` calls it, and `calib.adjustment.star_kernels` describes the state.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from calib.adjustment.product_kernels import add_columns, add_pinhole, gather
from calib.adjustment.star_kernels import CENTRE_AT, LENS_AT, RADIUS_AT, SKEW_AT, project
from calib.adjustment.star_kernels import CHUNK as _CHUNK
from calib.compiled import INNER, INNER_WITH_ARRAYS, KERNEL


@njit(**INNER)
def _bend(x: Any, y: Any, state: Any, fisheye: bool, bent: Any, by_normalised: Any, radial: Any) -> None:
    """Distort M normalised points (x, y): Brown (1971) with OpenCV's denominator, or Kannala and Brandt (2006).

    Own derivatives, as in `calib.model.lens`. Writes the distorted point (u, v) to ``bent`` (2, M), the derivatives
    du/dx, du/dy = dv/dx and dv/dy to ``by_normalised`` (3, M). The first radial coefficient moves the point by (x, y)
    times ``radial[0]``, a further one by ``radial[1]`` times more; ``radial[2]`` is minus the radial factor.
    """
    c = state[LENS_AT:SKEW_AT]
    if fisheye:
        for k in range(len(x)):
            r = max(np.sqrt(x[k] * x[k] + y[k] * y[k]), 1e-12)
            theta = np.arctan(r)
            t2 = theta * theta
            scale = theta * (1.0 + t2 * (c[0] + t2 * (c[1] + t2 * (c[2] + t2 * c[3])))) / r
            slope = 1.0 + t2 * (3.0 * c[0] + t2 * (5.0 * c[1] + t2 * (7.0 * c[2] + t2 * 9.0 * c[3])))
            more = slope / (1.0 + r * r) - scale
            ux, uy = x[k] / r, y[k] / r
            bent[0, k], bent[1, k] = x[k] * scale, y[k] * scale
            by_normalised[0, k], by_normalised[1, k] = scale + more * ux * ux, more * ux * uy
            by_normalised[2, k] = scale + more * uy * uy
            radial[0, k], radial[1, k], radial[2, k] = theta * t2 / r, t2, 0.0
        return
    p1, p2 = c[2], c[3]
    for k in range(len(x)):
        r2 = x[k] * x[k] + y[k] * y[k]
        inverse = 1.0 / (1.0 + r2 * (c[5] + r2 * (c[6] + r2 * c[7])))
        factor = (1.0 + r2 * (c[0] + r2 * (c[1] + r2 * c[4]))) * inverse
        slope = c[0] + r2 * (2.0 * c[1] + 3.0 * c[4] * r2)
        slope = 2.0 * (slope - factor * (c[5] + r2 * (2.0 * c[6] + 3.0 * c[7] * r2))) * inverse
        xx, xy, yy = x[k] * x[k], x[k] * y[k], y[k] * y[k]
        bent[0, k] = x[k] * factor + 2.0 * p1 * xy + p2 * (r2 + 2.0 * xx)
        bent[1, k] = y[k] * factor + p1 * (r2 + 2.0 * yy) + 2.0 * p2 * xy
        by_normalised[0, k] = factor + xx * slope + 2.0 * p1 * y[k] + 6.0 * p2 * x[k]
        by_normalised[1, k] = xy * slope + 2.0 * p1 * x[k] + 2.0 * p2 * y[k]
        by_normalised[2, k] = factor + yy * slope + 6.0 * p1 * y[k] + 2.0 * p2 * x[k]
        radial[0, k], radial[1, k], radial[2, k] = r2 * inverse, r2, -factor


@njit(**INNER)
def _write_lens(
    column: Any, at: int, x: Any, y: Any, state: Any, fisheye: bool, bent: Any, radial: Any
) -> None:
    """Write the derivatives (2, M) of M image points by a lens coefficient or the skew in place ``at``."""
    fx, fy, count = state[0], state[1], len(x)
    if at == SKEW_AT:
        for k in range(count):
            column[0, k], column[1, k] = bent[1, k], 0.0
        return
    at -= LENS_AT
    if not fisheye and 2 <= at < 4:
        for k in range(count):
            r2, xy = x[k] * x[k] + y[k] * y[k], 2.0 * x[k] * y[k]
            column[0, k] = fx * (xy if at == 2 else r2 + 2.0 * x[k] * x[k])
            column[1, k] = fy * (xy if at == 3 else r2 + 2.0 * y[k] * y[k])
        _skewed(column, state)
        return
    power, below = at, False
    if not fisheye:
        # k1 k2 and k3 of the numerator, k4 k5 k6 of the denominator.
        power, below = min(at, 2) if at < 5 else at - 5, at >= 5
    _write_radial(column[0, :count], power, below, radial)
    for k in range(count):
        column[1, k] = fy * column[0, k] * y[k]
        column[0, k] *= fx * x[k]
    _skewed(column, state)


@njit(**INNER)
def _write_radial(factor: Any, power: int, below: bool, radial: Any) -> None:
    """Write by how much of (x, y) a radial coefficient moves M points, as `_bend` says; ``below`` the fraction line."""
    for k in range(len(factor)):
        factor[k] = radial[0, k]
    for _ in range(power):
        for k in range(len(factor)):
            factor[k] *= radial[1, k]
    if below:
        for k in range(len(factor)):
            factor[k] *= radial[2, k]


@njit(**INNER)
def _skewed(column: Any, state: Any) -> None:
    """Add to derivatives (2, M) of the column u what the skew makes of those of the row v (own, by the chain rule)."""
    share = state[SKEW_AT] / state[1]
    if share != 0.0:
        for k in range(column.shape[1]):
            column[0, k] += share * column[1, k]


@njit(**INNER)
def _write_geometry(
    p: Any, x: Any, y: Any, by_normalised: Any, rotation: Any, state: Any, turned: Any, moved: Any
) -> None:
    """Write the derivatives of M image points by a rotation and a shift of the centre, (3, 2, M) each.

    Own derivation, by the chain rule: with P = R (X - c), a rotation t on the camera's side moves P by t x P, and a
    shift s of the centre moves it by -R s. ``p`` (3, M) is P.
    """
    a, b, c = rotation[0], rotation[1], rotation[2]
    ax, ay, az, bx, by, bz = a[0], a[1], a[2], b[0], b[1], b[2]
    cx, cy, cz = c[0], c[1], c[2]
    for axis in range(2):
        focal, first, second = state[axis], by_normalised[axis], by_normalised[axis + 1]
        for k in range(len(x)):
            scale = focal / p[2, k]
            u, v = first[k] * scale, second[k] * scale
            w = -(u * x[k] + v * y[k])
            turned[0, axis, k] = p[1, k] * w - p[2, k] * v
            turned[1, axis, k] = p[2, k] * u - p[0, k] * w
            turned[2, axis, k] = p[0, k] * v - p[1, k] * u
            moved[0, axis, k] = -(ax * u + bx * v + cx * w)
            moved[1, axis, k] = -(ay * u + by * v + cy * w)
            moved[2, axis, k] = -(az * u + bz * v + cz * w)


@njit(**INNER)
def _write_centre(column: Any, at: int, moved: Any, count: int) -> None:
    """Write the derivatives (2, M) by the shared centre, in place ``at`` of the state.

    ``moved`` (3, 2, M) are those by a shift of the centre.
    """
    sign = -1.0 if at == RADIUS_AT else 1.0
    for axis in range(2):
        along = moved[at - CENTRE_AT, axis]
        for k in range(count):
            column[axis, k] = sign * along[k]


@njit(**INNER_WITH_ARRAYS)
def _dense(places: Any, local: int) -> tuple[Any, int]:
    """Return which of the G shared and L local parameters need a row of derivatives, and how many are shared ones."""
    dense, count = np.empty(len(places) + local, np.int64), 0
    for g in range(len(places)):
        if places[g] >= LENS_AT:
            dense[count] = g
            count += 1
    for a in range(local):
        dense[count + a] = len(places) + a
    return dense[: count + local], count


@njit(**KERNEL)
def view_equations(
    target: Any,
    bounds: Any,
    state: Any,
    fisheye: bool,
    rotations: Any,
    offsets: Any,
    places: Any,
    gradient: Any,
    curvature: Any,
    normal: Any,
    right: Any,
) -> None:
    """Compute the normal matrix and the gradient of each view: J^T C J and J^T g.

    target, bounds, state, fisheye, rotations, offsets: As for
      `calib.adjustment.star_kernels.residuals_px`. All stars must be in front of the camera.
    places: (G,) int64 places of the free shared parameters in the state.
    gradient, curvature: (2, M) and (3, M) float64 from `calib.adjustment.star_kernels.robust_curvature`.
    normal, right: (n, G + L, G + L) and (n, G + L) float64 results; L is 3, or 6 with the centre of each
      view.
    """
    shared = len(places)
    dense, freed = _dense(places, right.shape[1] - shared)
    columns, weighted = np.empty((len(dense), 2, _CHUNK)), np.empty((len(dense), 2, _CHUNK))
    moved, p, plane = np.empty((3, 2, _CHUNK)), np.empty((3, _CHUNK)), np.empty((2, _CHUNK))
    bent, by_normalised, radial = np.empty((2, _CHUNK)), np.empty((3, _CHUNK)), np.empty((3, _CHUNK))
    pinhole, by_pinhole, own = np.empty((4, 4)), np.empty((len(dense), 4)), np.empty((len(dense), len(dense)))
    scores, centre, at = np.empty(LENS_AT + len(dense)), np.empty(3), int(np.int64(0))
    for i in range(len(rotations)):
        pinhole[:], by_pinhole[:], own[:], scores[:] = 0.0, 0.0, 0.0, 0.0
        centre[0] = state[CENTRE_AT] + offsets[i, 0]
        centre[1] = state[CENTRE_AT + 1] + offsets[i, 1]
        centre[2] = -state[RADIUS_AT] + offsets[i, 2]
        for first in range(bounds[i, 0], bounds[i, 1], _CHUNK):
            size = min(_CHUNK, bounds[i, 1] - first)
            project(target, rotations[i], centre, first, size, p, plane)
            u, v = plane[0, :size], plane[1, :size]
            _bend(u, v, state, fisheye, bent, by_normalised, radial)
            turned = columns[freed : freed + 3]
            _write_geometry(p, u, v, by_normalised, rotations[i], state, turned, moved)
            for axis in range(3):
                _skewed(turned[axis], state)
                _skewed(moved[axis], state)
            if len(dense) > freed + 3:
                for k in range(size):
                    for a in range(3):
                        columns[freed + 3 + a, 0, k] = moved[a, 0, k]
                        columns[freed + 3 + a, 1, k] = moved[a, 1, k]
            for d in range(freed):
                place = places[dense[d]]
                if place >= CENTRE_AT:
                    _write_centre(columns[d], place, moved, size)
                else:
                    _write_lens(columns[d], place, u, v, state, fisheye, bent, radial)
            add_columns(
                columns, bent, gradient, curvature, at, size, weighted, own, by_pinhole, scores[LENS_AT:]
            )
            if freed < shared:
                add_pinhole(bent, gradient, curvature, at, size, pinhole, scores)
            at += size
        gather(places, dense, pinhole, by_pinhole, own, scores, normal[i], right[i])
