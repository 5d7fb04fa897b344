"""Compiled products of derivatives: what the stars of a view add to its normal equations.

A focal length moves the stars along one image axis only, and the principal point moves all stars alike. Their products
with the other derivatives are therefore sums that need no rows of their own. This module is arithmetic only;
`calib.adjustment.equation_kernels` calls it.
"""

from __future__ import annotations

from typing import Any

from numba import njit

from calib.adjustment.star_kernels import LENS_AT
from calib.compiled import INNER

#: Sums may be reordered, so that they run in parallel.
_REORDERED = {"reassoc", "contract", "nsz"}


@njit(**INNER, fastmath=_REORDERED)
def add_pinhole(
    bent: Any, gradient: Any, curvature: Any, first: int, count: int, normal: Any, right: Any
) -> None:
    """Add the products of fx, fy, cx and cy among themselves, J^T C J and J^T g, for some stars.

    bent: (2, `CHUNK`) float64 distorted normalised points of these stars: the derivatives by fx and fy.
    gradient, curvature: (2, M) and (3, M) float64, as for `calib.adjustment.equation_kernels.view_equations`.
    first, count: The first of these stars in ``gradient``, and their number.
    normal, right: (4, 4) and (4,) or longer, float64 sums to add to; of ``normal`` the lower half.
    """
    end = first + count
    xx, xy, yy = curvature[0, first:end], curvature[1, first:end], curvature[2, first:end]
    u, v, gx, gy = bent[0], bent[1], gradient[0, first:end], gradient[1, first:end]
    a, b, c, d, e, f, g, h = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(count):
        a += u[k] * u[k] * xx[k]
        b += u[k] * v[k] * xy[k]
        c += v[k] * v[k] * yy[k]
        d += u[k] * xx[k]
        e += u[k] * xy[k]
        f += v[k] * xy[k]
        g += v[k] * yy[k]
        h += xx[k]
    normal[0, 0] += a
    normal[1, 0] += b
    normal[1, 1] += c
    normal[2, 0] += d
    normal[2, 1] += f
    normal[2, 2] += h
    normal[3, 0] += e
    normal[3, 1] += g
    a, b, c, d, e, f = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(count):
        a += xy[k]
        b += yy[k]
        c += u[k] * gx[k]
        d += v[k] * gy[k]
        e += gx[k]
        f += gy[k]
    normal[3, 2] += a
    normal[3, 3] += b
    right[0] += c
    right[1] += d
    right[2] += e
    right[3] += f


@njit(**INNER, fastmath=_REORDERED)
def add_columns(
    columns: Any,
    bent: Any,
    gradient: Any,
    curvature: Any,
    first: int,
    count: int,
    weighted: Any,
    normal: Any,
    by_pinhole: Any,
    right: Any,
) -> None:
    """Add the products of D further parameters with each other and with fx, fy, cx and cy, for some stars.

    columns: (D, 2, `CHUNK`) float64 derivatives J of these stars.
    bent, gradient, curvature, first, count: As for `add_pinhole`.
    weighted: (D, 2, `CHUNK`) float64 room for C J.
    normal, by_pinhole, right: (D, D), (D, 4) and (D,) float64 sums to add to; of ``normal`` the lower half.
    """
    end = first + count
    xx, xy, yy = curvature[0, first:end], curvature[1, first:end], curvature[2, first:end]
    u, v, gx, gy = bent[0], bent[1], gradient[0, first:end], gradient[1, first:end]
    for i in range(len(columns)):
        x, y, wx, wy = columns[i, 0], columns[i, 1], weighted[i, 0], weighted[i, 1]
        for k in range(count):
            wx[k] = xx[k] * x[k] + xy[k] * y[k]
        for k in range(count):
            wy[k] = xy[k] * x[k] + yy[k] * y[k]
        a, b, c, d, e = 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(count):
            a += wx[k] * u[k]
            b += wy[k] * v[k]
            c += wx[k]
            d += wy[k]
            e += gx[k] * x[k] + gy[k] * y[k]
        by_pinhole[i, 0] += a
        by_pinhole[i, 1] += b
        by_pinhole[i, 2] += c
        by_pinhole[i, 3] += d
        right[i] += e
    for i in range(0, len(columns), 2):
        _add_two(columns, weighted, count, i, normal)


@njit(**INNER, fastmath=_REORDERED)
def _add_two(columns: Any, weighted: Any, count: int, i: int, normal: Any) -> None:
    """Add the products of the rows ``i`` and ``i + 1`` with all columns up to them, two by two: fewer loads."""
    last = min(i + 1, len(columns) - 1)
    ax, ay, bx, by = weighted[i, 0], weighted[i, 1], weighted[last, 0], weighted[last, 1]
    for j in range(0, i + 1, 2):
        other = min(j + 1, last)
        cx, cy, dx, dy = columns[j, 0], columns[j, 1], columns[other, 0], columns[other, 1]
        p, q, r, s = 0.0, 0.0, 0.0, 0.0
        for k in range(count):
            p += ax[k] * cx[k] + ay[k] * cy[k]
            q += ax[k] * dx[k] + ay[k] * dy[k]
            r += bx[k] * cx[k] + by[k] * cy[k]
            s += bx[k] * dx[k] + by[k] * dy[k]
        normal[i, j] += p
        if other > j and other <= i:
            normal[i, other] += q
        if last > i:
            normal[last, j] += r
            if other > j:
                normal[last, other] += s


@njit(**INNER)
def gather(
    places: Any, dense: Any, pinhole: Any, by_pinhole: Any, own: Any, scores: Any, normal: Any, right: Any
) -> None:
    """Write the sums of a view to its normal equations.

    places: (G,) int64 places of the free shared parameters in the state.
    dense: (D,) int64 which of the view's parameters are those of `add_columns`.
    pinhole, by_pinhole, own: (4, 4), (D, 4) and (D, D) float64 products of `add_pinhole` and of
      `add_columns`.
    scores: (4 + D,) float64 gradients by fx, fy, cx and cy, and by the others.
    normal, right: (G + L, G + L) and (G + L,) float64 results.
    """
    normal[:] = 0.0
    right[:] = 0.0
    for g in range(len(places)):
        if not 0 <= places[g] < LENS_AT:
            continue
        right[g] = scores[places[g]]
        for h in range(len(places)):
            if 0 <= places[h] < LENS_AT:
                normal[g, h] = pinhole[max(places[g], places[h]), min(places[g], places[h])]
        for d in range(len(dense)):
            normal[g, dense[d]] = normal[dense[d], g] = by_pinhole[d, places[g]]
    for d in range(len(dense)):
        right[dense[d]] = scores[LENS_AT + d]
        for e in range(d + 1):
            normal[dense[d], dense[e]] = normal[dense[e], dense[d]] = own[d, e]
